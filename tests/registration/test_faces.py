"""Faces that right angles add to seen ones, and planes that are no plates."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.perception.image_kinds import IDEAL
from kit1000.perception.observed.plates import Plane, without_nested
from kit1000.pose import Pose
from kit1000.registration.geometry.faces import right_angled, squared
from tests.samples.strategies import poses

UP = np.array([0.0, 0.0, 1.0])
ANGLE = np.radians(6)


@given(pose=poses(), shown=st.sampled_from(list(combinations(range(3), 2))))
def test_two_faces_of_a_box_tell_all_six(pose: Pose, shown: tuple[int, int]) -> None:
    axes = pose.rotation_matrix().T
    normals = right_angled([axes[i] for i in shown], np.radians(4))
    assert len(normals) == 6
    for normal in [*axes, *-axes]:
        assert max(float(normal @ other) for other in normals) == pytest.approx(1, abs=1e-9)
    np.testing.assert_array_equal(normals[:2], axes[list(shown)])  # those that are shown come first, as they are


@given(tilt=st.floats(0, np.pi), turn=st.floats(-3, 3))
def test_a_face_is_put_upright_or_level_only_within_the_angle(tilt: float, turn: float) -> None:
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    put = squared(normal, ANGLE)
    off = min(tilt, np.pi - tilt, abs(tilt - np.pi / 2))
    moved = np.arccos(np.clip(normal @ put, -1, 1))
    assert moved == pytest.approx(off if off < ANGLE else 0, abs=1e-6)
    np.testing.assert_allclose(squared(put, ANGLE), put, atol=1e-15)
    assert squared(normal, 0.0) is normal


def square(pose: Pose, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of a level square of a pose, one every 2 mm, and their normals."""
    along = np.arange(-half, half, 2e-3)
    x, y = (each.ravel() for each in np.meshgrid(along, along))
    return pose.apply(np.column_stack([x, y, 0 * x])), np.tile(pose.rotate(UP), (len(x), 1))


@given(pose=poses(), tilt=st.floats(0.2, 0.6), turn=st.floats(-3, 3))
@settings(max_examples=8)
def test_a_slope_within_a_plate_is_none_and_one_beside_it_is(pose: Pose, tilt: float, turn: float) -> None:
    slope = Pose.from_rotvec(tilt * np.array([np.cos(turn), np.sin(turn), 0]))
    places = [Pose.identity(), Pose.from_translation((0, 0, -0.012)) @ slope]
    places += [Pose.from_translation((0.11, 0, -0.012)) @ slope.inverse()]
    patches = [square(pose @ place, half) for place, half in zip(places, (0.04, 0.015, 0.03), strict=True)]
    points, normals = (np.concatenate(both) for both in zip(*patches, strict=True))
    planes = [Plane((pose @ place).rotate(UP), (pose @ place).xyz, 1.0) for place in places]
    assert without_nested(planes, points, normals, IDEAL.noise) == [planes[0], planes[2]]
