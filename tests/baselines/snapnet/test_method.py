"""SnapNet from query to prediction, with untrained networks."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.catalog import all_methods
from baselines.snapnet.config import PositionConfig, RotationConfig, Source
from baselines.snapnet.method import SnapNet
from baselines.snapnet.position import PositionNet
from baselines.snapnet.query_volumes import QueryVolumes
from baselines.snapnet.rotation import RotationNet
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.perception.networks.weight_files import save_weights
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor
from kit1000.testing import check_predictor

POSITION = PositionConfig(4e-3, (16, 16, 16), (32, 32, 32), (9, 9, 9), (2, 2, 4, 4, 4), features=2)
ROTATION = RotationConfig(4e-3, (16, 16, 16), (24, 24, 24), "surface", 32, 64, 0.1, (8, 4), (0.1, 0.1))


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    return Dataset(mini)


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


def test_weights_are_read_back_with_their_config(data: Dataset, tmp_path: Path) -> None:
    method = untrained(data, "depth")
    for name, net in (("position", method.position), ("rotation", method.rotation)):
        save_weights(tmp_path / name, net, {"about": {"network": asdict(net.config)}})
    again = SnapNet(data, "depth", tmp_path / "position", tmp_path / "rotation")
    query = next(data.split("val").queries("snap"))
    one, other = method(query).goal_from_now, again(query).goal_from_now
    np.testing.assert_allclose((one @ other.inverse()).xyz, 0, atol=1e-6)
    assert float((one @ other.inverse()).angle()) < 1e-6


def test_weights_of_the_other_network_are_refused(data: Dataset, tmp_path: Path) -> None:
    method = untrained(data, "depth")
    save_weights(tmp_path / "rotation", method.rotation, {"about": {"network": asdict(ROTATION)}})
    with pytest.raises(InputError, match="no config of a PositionNet: it differs in"):
        SnapNet(data, "depth", tmp_path / "rotation", tmp_path / "rotation")


@pytest.mark.parametrize("name", ["snapnet", "snapnet-gtvol", "snapnet-partialvol"])
def test_shipped_weights_fit_their_networks(data: Dataset, name: str) -> None:
    assert isinstance(make_predictor(all_methods()[name], data, 0), SnapNet)
