"""ICP: it converges where the nearest fit is correct, conforms as a method, and its shell of a part is closed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from baselines import icp
from baselines.icp import Icp, fitted, shell_of
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.testing import check_predictor
from kit1000.values import Query


@pytest.fixture(scope="module", autouse=True)
def _needs_open3d() -> None:
    try:
        icp.load_open3d()
    except InputError as error:
        pytest.skip(f"Open3D cannot be loaded on this machine: {error}")


@pytest.fixture(scope="module")
def queries(data: Dataset) -> list[Query]:
    return list(data.split("train").queries("snap"))


def test_icp_conforms(data: Dataset, queries: list[Query]) -> None:
    check_predictor(Icp(data), queries[:3], name="icp")


def test_without_a_guess_it_refuses(data: Dataset) -> None:
    query = next(data.split("train").queries("place"))
    with pytest.raises(InputError, match=f"{query.id}: ICP begins at a guess"):
        Icp(data)(query, None)


def test_far_from_all_kits_the_guess_stays(data: Dataset, queries: list[Query]) -> None:
    far = Pose.from_translation((0.0, 0.0, 3.0))
    assert Icp(data)(replace(queries[0], guess=far), None) == (far, 0.0)


def test_predictions_stay_within_the_error_of_a_guess(data: Dataset, queries: list[Query]) -> None:
    for query in queries:
        assert query.guess is not None
        motion, confidence = Icp(data)(query, None)
        step = motion @ query.guess.inverse()
        guessed = query.guess.apply(query.pivot)
        assert np.linalg.norm(step.apply(guessed) - guessed) <= icp.FARTHEST + 1e-6
        assert step.angle() <= icp.MAX_ANGLE + 1e-6
        assert 0 <= confidence <= 1


def test_a_shell_reaches_from_the_observed_surface_to_the_table(queries: list[Query]) -> None:
    for query in queries:
        shell = shell_of(query)
        height = shell[:, 2].max()
        assert 5e-3 < height < 60e-3
        assert shell[:, 2].min() > -1e-3  # the table
        assert (shell.min(0) < query.pivot)[:2].all()
        assert (shell.max(0) > query.pivot)[:2].all()
        walls = shell[(shell[:, 2] > 0.2 * height) & (shell[:, 2] < 0.8 * height)]
        assert len(walls) > 100


def test_a_peg_without_clearance_converges_into_its_pit() -> None:
    """A truncated wedge in a pit of its own shape: here the nearest fit is the correct one."""
    rng = np.random.default_rng(0)
    pit = _pit(rng.uniform(-0.04, 0.04, (20_000, 2)))
    peg = _pit(rng.uniform(-0.015, 0.015, (4000, 2)))
    error = Pose.from_rotvec(np.radians((4.0, -3.0, 5.0)), (2e-3, -2e-3, 3e-3))
    step, fitness = fitted(error.apply(peg), pit, np.array((0.0, 0.0, 0.5)))
    left = step @ error
    assert np.linalg.norm(left.xyz) < 0.3e-3
    assert np.degrees(left.angle()) < 1
    assert fitness > 0.9


def _pit(xy: np.ndarray) -> np.ndarray:
    """(n, 3) [m]: the surface of a plate with a lopsided pyramid pressed into it."""
    x, y = np.transpose(xy)
    depth = np.minimum.reduce([0.015 - x, (0.015 + x) / 2, 0.012 - y, (0.015 + y) / 1.5, np.full(len(xy), 6e-3)])
    return np.column_stack([xy, -np.maximum(depth, 0)])
