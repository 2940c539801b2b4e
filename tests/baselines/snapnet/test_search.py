"""The search without a guess: its window, its choice of starts, and that it finds a known shape at a known pose."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from baselines.snapnet.config import POSITION, Cells, Source
from baselines.snapnet.method import APART, REACH, RISE, YAWS, best_cells, likely_starts, wide_window
from baselines.snapnet.position import COARSEST, PositionNet
from baselines.snapnet.query_volumes import grid_about
from kit1000.pose import Pose
from kit1000.rng import stream

CONFIG = POSITION["small"]
PIVOT = np.array([0.3, -0.2, 0.02])


@pytest.mark.parametrize("preset", ["small", "paper"])
def test_the_window_covers_its_reach_and_its_middle_is_the_volumes(preset: str) -> None:
    config = POSITION[preset]
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
    net: Any = PositionNet(CONFIG)
    net.part = net.kit = Pooled()
    with torch.inference_mode():
        first, *_ = likely_starts(net, Shapes(goal, source), 2)  # pyright: ignore[reportArgumentType]
    assert float((first.inverse() @ goal).angle()) < 1e-6
    assert np.abs(first.apply(PIVOT) - place).max() <= 2 * CONFIG.voxel
