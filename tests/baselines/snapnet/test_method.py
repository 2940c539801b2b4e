"""SnapNet from query to prediction, with untrained networks."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from baselines.catalog import all_methods
from baselines.snapnet.config import POSITION as POSITION_PRESETS
from baselines.snapnet.config import Cells, PositionConfig, RotationConfig, Source
from baselines.snapnet.method import APART, REACH, RISE, YAWS, SnapNet, best_cells, likely_starts, wide_window
from baselines.snapnet.position import COARSEST, PositionNet
from baselines.snapnet.query_volumes import QueryVolumes, grid_about
from baselines.snapnet.rotation import RotationNet
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.networks.weight_files import save_weights
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor
from kit1000.rng import stream
from kit1000.testing import check_predictor

POSITION = PositionConfig(4e-3, (16, 16, 16), (32, 32, 32), (9, 9, 9), (2, 2, 4, 4, 4), features=2)
ROTATION = RotationConfig(4e-3, (16, 16, 16), (24, 24, 24), "surface", 32, 64, 0.1, (8, 4), (0.1, 0.1))


def untrained(data: Dataset, source: Source) -> SnapNet:
    torch.manual_seed(0)
    return SnapNet(data, source, PositionNet(POSITION), RotationNet(ROTATION))


@pytest.mark.parametrize("source", ["truth", "depth"])
def test_it_conforms(data: Dataset, source: Source) -> None:
    """Except in the moved world, which is rotated: the networks work along the world's axes."""
    queries = [query for query in data.split("val").queries() if query.track in ("snap", "snap-tilt")][:4]
    geometries = [data.geometry.true_geometry(data.truth_of(query)) for query in queries]
    check_predictor(untrained(data, source), queries, geometries if source == "truth" else None, moves=False)


def test_a_second_pass_starts_from_the_first_prediction(data: Dataset) -> None:
    one_pass, two_passes = untrained(data, "depth"), untrained(data, "depth")
    two_passes.passes = 2
    query = next(data.split("val").queries("snap"))
    first = one_pass(query).goal_from_now
    expected, second = one_pass(replace(query, guess=first)), two_passes(query)
    assert np.array_equal(second.goal_from_now.matrix(), expected.goal_from_now.matrix())
    assert not np.allclose(second.goal_from_now.matrix(), first.matrix())


def test_without_a_guess_the_best_start_is_corrected(data: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it were the guess, but among the rotations near it; the start with the highest score is taken."""
    method = untrained(data, "depth")
    query = next(data.split("train").queries("place"))
    middle = QueryVolumes(query, "depth").initial_guess()
    starts = [Pose.from_translation(shift) @ middle for shift in np.eye(3) * 0.01]
    monkeypatch.setattr("baselines.snapnet.method.likely_starts", lambda *_: starts)
    volumes = QueryVolumes(query, "depth")
    with torch.inference_mode():
        corrected = [method.corrected(volumes, start, near=True) for start in starts]
        best = max(corrected, key=lambda each: each.score)
        expected = method.corrected(volumes, best.motion, near=True)
    predicted = method(query)
    np.testing.assert_allclose(predicted.goal_from_now.matrix(), expected.motion.matrix(), atol=1e-6)
    assert 0 < predicted.confidence <= expected.confidence


def test_the_whole_search_conforms_without_a_guess(data: Dataset) -> None:
    queries = list(data.split("train").queries("place"))[:1]
    check_predictor(untrained(data, "depth"), queries, moves=False)


def test_weights_of_the_other_network_are_refused(data: Dataset, tmp_path: Path) -> None:
    method = untrained(data, "depth")
    save_weights(tmp_path / "rotation", method.rotation, {"about": {"network": asdict(ROTATION)}})
    with pytest.raises(InputError, match="no config of a PositionNet: it differs in"):
        SnapNet(data, "depth", tmp_path / "rotation", tmp_path / "rotation")


@pytest.mark.parametrize("name", ["snapnet", "snapnet-gtvol", "snapnet-partialvol"])
def test_shipped_weights_fit_their_networks(data: Dataset, name: str) -> None:
    assert isinstance(make_predictor(all_methods()[name], data, 0), SnapNet)


# the search without a guess: its window, its choice of starts, and that it finds a known shape at a known pose

SMALL = POSITION_PRESETS["small"]
PIVOT = np.array([0.3, -0.2, 0.02])


@pytest.mark.parametrize("preset", ["small", "paper"])
def test_the_window_covers_its_reach_and_its_middle_is_the_volumes(preset: str) -> None:
    config = POSITION_PRESETS[preset]
    cells, window = wide_window(config)
    for kit, part, count, reach in zip(cells, config.part_cells, window, REACH, strict=True):
        assert kit % COARSEST == 0
        assert count == (kit - part) // 2 + 1
        assert count // 2 == kit // 4 - part // 4  # at cell w // 2 the middles of both volumes coincide
        assert count // 2 * 2 * config.voxel >= reach - COARSEST * config.voxel


def test_starts_are_the_best_cells_and_no_two_are_in_one_place() -> None:
    scores = stream(0, "scores").normal(size=(YAWS, 30, 30, 6)).astype(np.float32)
    found = best_cells(scores, 5)
    values = scores[tuple(found.T)]
    assert values[0] == scores.max()
    assert (np.diff(values) <= 0).all()
    for i, (k, a, b, _) in enumerate(found):
        for other, c, d, _ in found[:i]:
            assert min((k - other) % YAWS, (other - k) % YAWS) > 1 or max(abs(a - c), abs(b - d)) > APART


class Pooled(torch.nn.Module):
    """Features that are the solid alone, at half the resolution."""

    def __init__(self) -> None:
        super().__init__()
        self.unused = torch.nn.Parameter(torch.zeros(1))  # tells the device

    def forward(self, volume: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.avg_pool3d((volume < 0).float()[:, None], 2) - 0.2


class Shapes:
    """Volumes of an L and of the same L at a goal: kits that are solid where the part belongs."""

    def __init__(self, goal: Pose, source: Source) -> None:
        self.goal, self.source, self.query = goal, source, SimpleNamespace(pivot=PIVOT)

    def initial_guess(self) -> Pose:
        return Pose.from_translation(np.array([0.05, 0.31, 0.03]) - PIVOT)

    def part_volume(self, guess: Pose, work: Pose, cells: Cells, voxel: float) -> np.ndarray:
        return self._solid(Pose(work.wxyz, guess.apply(PIVOT)), guess, cells, voxel)

    def kit_volume(self, work: Pose, cells: Cells, voxel: float) -> np.ndarray:
        return self._solid(work, self.goal, cells, voxel)

    def _solid(self, middle: Pose, motion: Pose, cells: Cells, voxel: float) -> np.ndarray:
        world = grid_about(middle, cells, voxel).world_from_grid.apply(np.moveaxis(np.indices(cells), 0, -1) * voxel)
        x, y, z = np.moveaxis(motion.inverse().apply(world) - PIVOT, -1, 0)
        inside = (np.abs(x) < 0.022) & (np.abs(y) < 0.016) & (np.abs(z) < 0.012) & ((x < -0.008) | (y < -0.004))
        return np.where(inside, -1, 1).astype(np.float32)


@pytest.mark.parametrize("source", ["truth", "depth"])
@pytest.mark.parametrize("yaw", [0, 4])
def test_a_shape_is_found_where_it_belongs(yaw: int, source: Source) -> None:
    turn, place = Pose.from_rotvec((0, 0, 2 * np.pi * yaw / YAWS)), np.array([0.12, 0.26, 0.03 + RISE - 0.01])
    goal = Pose(turn.wxyz, place - turn.rotate(PIVOT))
    net: Any = PositionNet(SMALL)
    net.part = net.kit = Pooled()
    with torch.inference_mode():
        first, *_ = likely_starts(net, Shapes(goal, source), 2)  # pyright: ignore[reportArgumentType]
    assert float((first.inverse() @ goal).angle()) < 1e-6
    assert np.abs(first.apply(PIVOT) - place).max() <= 2 * SMALL.voxel
