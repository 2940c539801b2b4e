"""SnapNet from a query to its answer, with networks that know nothing yet."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.snapnet.config import PositionConfig, RotationConfig
from baselines.snapnet.method import SnapNet
from baselines.snapnet.position import PositionNet
from baselines.snapnet.rotation import RotationNet
from baselines.training.checkpoint import save_weights
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.testing import check_predictor

POSITION = PositionConfig(4e-3, (16, 16, 16), (32, 32, 32), (9, 9, 9), (2, 2, 4, 4, 4), features=2)
ROTATION = RotationConfig(4e-3, (16, 16, 16), (24, 24, 24), "surface", 32, 64, 0.1, (8, 4), (0.1, 0.1))


@pytest.fixture(scope="module")
def data(mini: Path) -> Dataset:
    return Dataset(mini)


def untrained(data: Dataset, kind: str) -> SnapNet:
    torch.manual_seed(0)
    return SnapNet(data, kind, PositionNet(POSITION), RotationNet(ROTATION))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("kind", ["truth", "partial"])
def test_it_conforms(data: Dataset, kind: str) -> None:
    """Also in a moved world where the volumes are exact: axes are the world's, so worlds are moved without turning."""
    asked = [(q, scene.truths[q.id]) for scene in data.split("val", truth=True) for q in scene.queries]
    asked = [(query, truth) for query, truth in asked if query.track in ("snap", "snap-tilt")][:4]
    queries, truths = zip(*asked, strict=True)
    check_predictor(untrained(data, kind), queries, truths if kind == "truth" else None, moves=False)


def test_a_second_pass_takes_the_first_answer_for_the_guess(data: Dataset) -> None:
    once, twice = untrained(data, "partial"), untrained(data, "partial")
    twice.passes = 2
    query = next(q for scene in data.split("val") for q in scene.queries if q.track == "snap")
    first = once(query).goal_from_now
    wanted, found = once(replace(query, guess=first)), twice(query)
    assert np.array_equal(found.goal_from_now.matrix(), wanted.goal_from_now.matrix())
    assert not np.allclose(found.goal_from_now.matrix(), first.matrix())


def test_weights_come_back_with_their_sizes(data: Dataset, tmp_path: Path) -> None:
    method = untrained(data, "partial")
    for name, net in (("position", method.position), ("rotation", method.rotation)):
        save_weights(tmp_path / name, net, {"about": {"network": asdict(net.config)}})
    again = SnapNet(data, "partial", tmp_path / "position", tmp_path / "rotation")
    query = next(q for scene in data.split("val") for q in scene.queries if q.track == "snap")
    one, other = method(query).goal_from_now, again(query).goal_from_now
    np.testing.assert_allclose((one @ other.inverse()).xyz, 0, atol=1e-6)
    assert float((one @ other.inverse()).angle()) < 1e-6


def test_weights_of_the_other_network_are_refused(data: Dataset, tmp_path: Path) -> None:
    method = untrained(data, "partial")
    save_weights(tmp_path / "rotation", method.rotation, {"about": {"network": asdict(ROTATION)}})
    with pytest.raises(InputError, match="the sizes of a PositionNet differ in"):
        SnapNet(data, "partial", tmp_path / "rotation", tmp_path / "rotation")
