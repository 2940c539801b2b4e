"""Standing shapes and their poses, and the distance of poses by surface: a metric up to symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold

from kit1000.known_shapes.shapes import KnownShape, ShapeDistance, StandingShape, stable_normals, table_frame
from kit1000.known_shapes.support import Support
from kit1000.mesh import mesh_from_solid
from kit1000.pose import Pose

CUBOID = mesh_from_solid(Manifold.cube((0.05, 0.03, 0.01), center=True))
BOX = ShapeDistance(CUBOID)
SUPPORT = Support(np.array([0.0, -0.6, -0.8]), -0.6, 1e-3, 1e-4)
HERE = Pose.from_rotvec((0.3, -0.4, 1.0), (0.1, 0.2, 0.7))


@pytest.mark.parametrize("axis", np.eye(3))
def test_a_half_turn_of_a_box_is_no_distance(axis: np.ndarray) -> None:
    assert BOX.between(HERE, HERE @ Pose.from_rotvec(np.pi * axis)) < 0.3e-3


@settings(max_examples=20)
@given(st.floats(2e-3, 2e-2))
def test_a_shift_along_the_thin_side_is_its_distance(shift: float) -> None:
    moved = HERE @ Pose.from_translation((0.0, 0.0, shift))
    assert abs(BOX.between(HERE, moved) - shift) < 1e-3
    assert abs(BOX.between(moved, HERE) - shift) < 1e-3


def test_a_quarter_turn_is_a_distance() -> None:
    assert BOX.between(HERE, HERE @ Pose.from_rotvec((0.0, 0.0, np.pi / 2))) > 5e-3


def test_a_box_stands_on_its_six_sides_the_largest_first() -> None:
    normals = stable_normals(CUBOID)
    assert len(normals) == 6
    assert np.allclose(np.abs(normals[:2]), [[0, 0, 1], [0, 0, 1]])


@given(st.integers(0, 5), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-3.1, 3.1), st.floats(0.99, 1.01))
def test_a_standing_shape_is_found_again_by_its_pose(face: int, x: float, y: float, yaw: float, scale: float) -> None:
    shape = KnownShape.of("box", CUBOID)
    standing = StandingShape(shape, shape.levels[face], np.array([x, y, yaw]), table_frame(SUPPORT))
    pose = standing.camera_from_body(scale)
    again = StandingShape.by_pose(shape, SUPPORT, pose, scale)
    assert np.allclose(again.place, standing.place, atol=1e-9)
    heights = pose.apply(CUBOID.vertices) @ SUPPORT.normal - SUPPORT.offset / scale
    assert heights.min() == pytest.approx(0.0, abs=1e-9)  # it stands on the table, in true lengths
