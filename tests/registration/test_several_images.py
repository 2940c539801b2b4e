"""Fits by several images: what mean and median obey, which fits find company, and how sure the median is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from kit1000.pose import Pose, random_quaternions
from kit1000.registration.rank import COMPANY, DISAGREEMENT, NEAR, Fit, agreed, difference, mean_motion, median_motion
from kit1000.registration.search import Candidate

MIDDLE = np.array([0.05, -0.17, 0.02])
DOWN = np.array([0.0, 0.0, -1.0])


def about(motion: Pose, place: ArrayLike, rotvec: ArrayLike = (0.0, 0.0, 0.0)) -> Pose:
    """A motion whose goal is moved by `place` [m] and rotated by `rotvec` [rad] about where the part's middle goes."""
    goal = motion.apply(MIDDLE)
    moved = Pose.from_translation(goal + np.asarray(place)) @ Pose.from_rotvec(rotvec) @ Pose.from_translation(-goal)
    return moved @ motion


RIGHT = Pose.from_rotvec((0.3, 0.1, 1.2), (0.1, 0.4, 0.06))
WRONG = about(RIGHT, (0, 0, 0), (0, 0, np.pi))
ELSEWHERE = about(RIGHT, (0.09, 0, 0))


def fit(motion: Pose, score: float = 1.0) -> Fit:
    """One in a plate at the origin, of a part without a symmetry."""
    cavity: Any = SimpleNamespace(world_from_plate=Pose.identity())
    shape: Any = SimpleNamespace(gap=lambda one, other: difference(one, other, MIDDLE))
    return Fit(motion, score, Candidate(cavity, motion, DOWN, 0.1), shape, cast(Any, None))


def test_the_mean_halves_what_two_fits_are_off() -> None:
    true = Pose(random_quaternions(np.random.default_rng(0), 1)[0], np.array([0.1, 0.3, 0.05]))
    off = [about(true, (2e-3, 0, 0), (0, 0, 0.06)), about(true, (0, 2e-3, 0), (0, 0, -0.02))]
    mean = mean_motion(off, [1.0, 1.0], MIDDLE)
    np.testing.assert_allclose(mean.apply(MIDDLE) - true.apply(MIDDLE), (1e-3, 1e-3, 0), atol=1e-12)
    np.testing.assert_allclose((mean @ true.inverse()).rotvec(), (0, 0, 0.02), atol=1e-6)
    nearer = mean_motion(off, [3.0, 1.0], MIDDLE)
    np.testing.assert_allclose(nearer.apply(MIDDLE) - true.apply(MIDDLE), (1.5e-3, 0.5e-3, 0), atol=1e-12)


@given(away=st.floats(4e-3, 11e-3), direction=st.sampled_from(np.eye(3).tolist()))
def test_one_motion_that_is_far_off_moves_the_median_little(away: float, direction: list[float]) -> None:
    near = [about(RIGHT, step) for step in ((1e-4, 0, 0), (0, 1e-4, 0), (0, 0, 1e-4))]
    motions = [*near, about(RIGHT, away * np.array(direction))]
    weights = [1.0] * len(motions)
    median, mean = (combine(motions, weights, MIDDLE) for combine in (median_motion, mean_motion))
    assert difference(median, RIGHT, MIDDLE) < 0.5 * difference(mean, RIGHT, MIDDLE)


def test_the_surer_fit_weighs_more() -> None:
    other = about(RIGHT, (4e-3, 0, 0))
    best, *_ = agreed([[fit(RIGHT, 2.0)], [fit(other, -1.0)]], MIDDLE)
    assert 0 < difference(best.goal_from_now, RIGHT, MIDDLE) < 1.8e-3


def test_fits_in_company_win_over_better_ones_alone() -> None:
    slightly = about(RIGHT, (2e-3, 0, 0))
    images = [[fit(WRONG, 2.0), fit(RIGHT, 1.0)], [fit(ELSEWHERE, 2.0), fit(slightly, 1.0)]]
    best, *others = agreed(images, MIDDLE)
    assert difference(best.goal_from_now, RIGHT, MIDDLE) == pytest.approx(1e-3, abs=1e-9)
    assert best.score == pytest.approx(1.0 - 1e-3 * DISAGREEMENT + COMPANY * np.log(2))
    assert {round(other.score, 9) for other in others} == {2.0}
    assert len(others) == 2


def test_fits_too_far_apart_are_none_of_a_pose() -> None:
    far = about(RIGHT, (1.01 * NEAR, 0, 0))
    found = agreed([[fit(RIGHT)], [fit(far, 0.5)]], MIDDLE)
    assert [each.goal_from_now for each in found] != []
    assert difference(found[0].goal_from_now, RIGHT, MIDDLE) == 0
    assert len(found) == 2


def test_the_more_images_agree_the_surer() -> None:
    scores = [agreed([[fit(RIGHT)]] * count + [[fit(ELSEWHERE, -3.0)]], MIDDLE)[0].score for count in (1, 2, 3, 4)]
    np.testing.assert_allclose(scores, 1.0 + COMPANY * np.log([1, 2, 3, 4]), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_images_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    images = [
        [fit(about(base, rng.normal(0, 1e-3, 3), rng.normal(0, 0.02, 3)), float(rng.uniform(0, 2)))
         for base in (RIGHT, WRONG, ELSEWHERE)]
        for _ in range(3)
    ]  # fmt: skip
    one, other = (agreed(some, MIDDLE)[0] for some in (images, images[::-1]))
    assert difference(one.goal_from_now, other.goal_from_now, MIDDLE) < 1e-9
    assert one.score == pytest.approx(other.score)
