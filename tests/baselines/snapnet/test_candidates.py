"""The candidate rotations: counts, range, spacing, error floor, and the nearest candidate."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.snapnet.candidate_rotations import (
    COARSE,
    MOST_NEAR,
    NEAR,
    angles_between,
    candidates,
    coarse_candidates,
    near_candidates,
    nearest_candidate,
)
from kit1000.errors import InputError
from kit1000.pose import Pose, quaternion_angle, quaternion_from_rotvec, unit_vector
from kit1000.queries.guesses import MAX_ANGLE
from kit1000.rng import stream


def random_rotations(count: int, seed: int = 0) -> Pose:
    rng = stream(seed, "turns")
    return Pose(rng.standard_normal((count, 4)), np.zeros(3))


def smallest_angle(rotations: Pose) -> float:
    """[rad] between any two."""
    cosines = np.abs(rotations.wxyz @ rotations.wxyz.T)
    np.fill_diagonal(cosines, 0)
    return float(2 * np.arccos(cosines.max()))


@pytest.mark.parametrize("name", ["ball", "tilt"])
def test_candidates_lie_in_the_ball_of_guesses_with_their_inverses_and_the_identity(name):
    rotations = candidates(name)
    angles = rotations.angle()
    assert len(rotations) == 391
    assert smallest_angle(rotations) > np.radians(0.4)
    assert angles.max() <= MAX_ANGLE + 1e-4  # the release says 0.48 rad
    assert (angles == 0).sum() == 1
    assert angles_between(rotations, rotations.inverse()).min(1).max() < 1e-7


@pytest.mark.parametrize("name", ["ball", "tilt"])
def test_from_coarse_to_fine_every_candidate_can_be_found(name):
    coarse = coarse_candidates(name)
    assert len(coarse) == COARSE
    steps = angles_between(candidates(name), coarse)
    assert steps.min(1).max() < NEAR  # each is near a coarse one
    assert smallest_angle(coarse) > np.radians(5)
    for rotation in (Pose.identity(), candidates(name)[int(stream(0, name).integers(391))]):
        near = near_candidates(name, rotation)
        angles = (rotation.inverse() @ near).angle()
        assert 1 < len(near) <= MOST_NEAR
        assert angles.max() <= NEAR
        assert angles.min() < 1e-6


def test_tilts_are_rings_about_horizontal_axes():
    vectors = candidates("tilt").rotvec()
    np.testing.assert_allclose(vectors[:, 2], 0, atol=1e-12)
    rings, sizes = np.unique(np.round(np.linalg.norm(vectors, axis=1), 9), return_counts=True)
    np.testing.assert_allclose(rings, np.linspace(0, 0.48, 6), atol=1e-8)
    assert sizes.tolist() == [1, 78, 78, 78, 78, 78]


def test_the_nearest_candidate_is_that_of_brute_force():
    rotations, correct = candidates("tilt"), random_rotations(3)
    index, angles = nearest_candidate(rotations, correct)
    brute = quaternion_angle(rotations.wxyz[:, None], correct.wxyz[None]).min(1)
    np.testing.assert_allclose(angles, brute, atol=1e-9)
    assert index == brute.argmin()


def test_the_nearest_about_a_free_axis_is_the_minimum_of_a_dense_sweep():
    rotations, correct = random_rotations(20, 1), random_rotations(2, 2)
    axis = unit_vector(np.array([0.3, -0.5, 0.9]))
    sweep = quaternion_from_rotvec(np.linspace(0, 2 * np.pi, 3601)[:, None] * axis)
    rotated = Pose(sweep, np.zeros(3))[:, None] @ correct
    brute = quaternion_angle(rotations.wxyz[:, None], rotated.wxyz.reshape(-1, 4)[None]).min(1)
    angles = nearest_candidate(rotations, correct, axis)[1]
    assert np.all(angles <= brute + 1e-9)
    np.testing.assert_allclose(angles, brute, atol=2e-3)


def test_an_unknown_set_is_refused():
    with pytest.raises(InputError, match=r"candidates: .*ball"):
        candidates("bal")  # type: ignore[arg-type]
