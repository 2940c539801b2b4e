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


def standing_on_a_table(solid: Manifold, place: tuple[float, float, float]) -> StandingShape:
    shape = KnownShape.of("part", mesh_from_solid(solid))
    return StandingShape(shape, shape.levels[0], np.array(place), table_frame(SUPPORT))


L_SHAPE = Manifold.cube((0.04, 0.03, 0.02)) - Manifold.cube((0.03, 0.02, 0.03)).translate((0.02, 0.01, -0.005))


@settings(max_examples=10)
@given(st.floats(-3.1, 3.1), st.integers(0, 1000))
def test_the_spread_of_a_surface_is_that_of_sampled_places(yaw: float, seed: int) -> None:
    """Points of the surface are moved by errors of the place that have the covariance."""
    rng = np.random.default_rng(seed)
    standing = standing_on_a_table(L_SHAPE, (0.05, -0.08, yaw))
    factor = rng.normal(size=(3, 3)) * np.array([1e-5, 1e-5, 1e-3])[:, None]
    mesh, before = standing.shape.mesh, standing.camera_from_body()
    faces = rng.choice(len(mesh.faces), 400, p=mesh.areas / mesh.area)
    corners = rng.dirichlet((1, 1, 1), 400)
    points = np.einsum("nc,ncd->nd", corners, mesh.triangles[faces])
    moved = [standing.at(standing.place + factor @ rng.normal(size=3)).camera_from_body() for _ in range(400)]
    along = [((now.apply(points) - before.apply(points)) * before.rotate(mesh.normals[faces])).sum(1) for now in moved]
    assert standing.surface_spread(factor @ factor.T) == pytest.approx(np.sqrt(np.mean(np.square(along))), rel=0.2)


def test_the_yaw_of_a_round_shape_moves_no_surface() -> None:
    unseen = np.diag((1e-12, 1e-12, 1e4))
    disc = standing_on_a_table(Manifold.cylinder(0.01, 0.02, circular_segments=256, center=True), (0.1, 0.0, 0.5))
    assert disc.surface_spread(unseen) < 0.2e-3
    assert standing_on_a_table(L_SHAPE, (0.1, 0.0, 0.5)).surface_spread(unseen) > 5e-3
