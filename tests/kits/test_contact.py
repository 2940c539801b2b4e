"""First contact: closed forms, booleans, and every pair tried alone agree with it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold
from scipy.ndimage import maximum_filter

from kit1000.kits.contact import contact_features, highest_edge_contact, highest_vertex_contact, vertical_contact_offset
from kit1000.kits.height_fields import grown, lower_envelope
from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh
from kit1000.pose import Pose, random_quaternions
from tests.samples.shapes import MM, as_part, box, random_solid, standing

UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])
IDENTITY = Pose.identity()
SEEDS = st.integers(0, 10_000)


@cache
def body(seed: int) -> Mesh:
    return as_part(random_solid(seed)).mesh


def drawn(seed: int) -> tuple[Mesh, Mesh, Pose]:
    """Two bodies and a pose of the first over the second that makes them meet."""
    rng = np.random.default_rng(seed)
    a, b = (body(int(rng.integers(6)) + k) for k in (0, 6))
    return a, b, Pose(random_quaternions(rng, 1)[0], np.array([*rng.uniform(-6e-3, 6e-3, 2), 0.05]))


def offset_of(moving: Mesh, fixed: Mesh, pose: Pose, base: Pose = IDENTITY) -> float:
    return vertical_contact_offset(
        contact_features(moving, pose.rotation_matrix(), pose.xyz, -1.0),
        contact_features(fixed, base.rotation_matrix(), base.xyz, 1.0),
    )


def overlap(moving: Mesh, fixed: Mesh, pose: Pose, offset: float) -> float:
    """[m^3]"""
    lifted = Pose(pose.wxyz, pose.xyz + [0, 0, offset])
    return (solid_from_mesh(moving.moved(lifted)) ^ solid_from_mesh(fixed)).volume()


@given(SEEDS)
def test_just_above_contact_bodies_are_apart_and_just_below_they_are_not(seed: int) -> None:
    moving, fixed, pose = drawn(seed)
    offset = offset_of(moving, fixed, pose)
    assert np.isfinite(offset)
    assert overlap(moving, fixed, pose, offset + 1e-6) < 1e-18
    assert overlap(moving, fixed, pose, offset - 20e-6) > 0


@given(SEEDS)
def test_the_envelope_of_a_grid_is_the_lowest_of_plain_vertical_rays(seed: int) -> None:
    mesh = body(seed % 12)
    heights, corner = lower_envelope(mesh, 0.7e-3)
    rng = np.random.default_rng(seed)
    for i, j in zip(*(rng.integers(0, n, 12) for n in heights.shape), strict=True):
        assert heights[i, j] == pytest.approx(ray_bottom(mesh, corner + np.array([i, j]) * 0.7e-3), abs=1e-9)


def ray_bottom(mesh: Mesh, xy: np.ndarray) -> float:
    """The lowest crossing of a vertical line with any face, by Cramer's rule."""
    a, b, c = np.moveaxis(mesh.triangles - [*xy, 0], 1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        area = cross2(b - a, c - a)
        u, v = cross2(b, c) / area, cross2(c, a) / area
        hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
        z = u * a[:, 2] + v * b[:, 2] + (1 - u - v) * c[:, 2]
    return float(z[hit].min(initial=np.inf))


def cross2(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def solid(drawing: Manifold) -> Mesh:
    return mesh_from_solid(standing(drawing))


def test_a_block_over_a_ramp_meets_it_with_its_edge() -> None:
    ramp = Manifold.hull_points(np.array([[x, y, z] for y in (-9, 9) for x, z in ((0, 0), (30, 0), (30, 15))], float))
    pose = Pose.from_translation(np.array([12e-3, 1e-3, 0]))
    assert offset_of(solid(box(6, 4, 5)), solid(ramp), pose) == pytest.approx((12 + 3) / 2 * MM)


def test_two_crossed_knife_edges_touch_between_their_ends() -> None:
    roof = np.array([[x, y, 0] for x in (-20, 20) for y in (-5, 5)] + [[-20, 0, 5], [20, 0, 5]], float)
    blade = solid(Manifold.hull_points(roof))
    over = Pose.from_rotvec(np.array([0, 0, 1.0])) @ Pose.from_rotation_matrix(UPSIDE_DOWN)
    assert offset_of(blade, blade, over) == pytest.approx(10 * MM)


def test_past_the_edge_there_is_no_contact() -> None:
    block = solid(box(10, 10, 10))
    assert offset_of(block, block, Pose.from_translation(np.array([10.01e-3, 0, 0]))) == -np.inf
    assert offset_of(block, block, Pose.from_translation(np.array([9.99e-3, 0, 0]))) == pytest.approx(10e-3)


def test_inner_edges_of_an_l_are_not_convex() -> None:
    found = solid(box(20, 10, 10) + box(10, 10, 20, (-5, 0, 0)))
    inner = [10e-3, 0.0]
    middles = found.vertices[found.convex_edges[0]].mean(1)
    assert not (np.abs(middles[:, [2, 0]] - inner).max(1) < 1e-6).any()


FULL = (-np.inf, np.inf)  # a search for the highest contact from nothing to its end


@pytest.mark.parametrize("cells", [0, 1, 2, 3, 5, 12, 21])
@pytest.mark.parametrize("shape", [(1, 1), (3, 40), (60, 45)])
def test_a_relief_grows_by_the_maximum_over_a_disc(cells: int, shape: tuple[int, int]) -> None:
    depths = np.maximum(np.random.default_rng(cells).normal(size=shape), 0)
    across = np.arange(-cells, cells + 1)
    disc = np.hypot(*np.meshgrid(across, across)) <= cells + 0.5
    assert np.array_equal(grown(depths, cells + 0.5), maximum_filter(depths, footprint=disc, mode="constant"))


@pytest.mark.parametrize(("count", "size"), [(1, 0.1), (7, 0.05), (60, 0.01), (60, 0.002)])
@pytest.mark.parametrize("rounded", [False, True])
def test_contacts_are_those_of_every_pair_tried_alone(count: int, size: float, rounded: bool) -> None:
    rng = np.random.default_rng(count)

    def shapes(corners: int) -> np.ndarray:
        found = rng.normal(size=(count, 1, 3)) * 0.02 + rng.normal(size=(count, corners, 3)) * size
        return np.round(found, 2) if rounded else found  # many coordinates are then equal

    moving, fixed, faces = shapes(2), shapes(2), shapes(3)
    alone = max(highest_edge_contact(a[None], b[None], *FULL) for a in moving for b in fixed)
    assert highest_edge_contact(moving, fixed, *FULL) == alone
    points = np.concatenate([moving.reshape(-1, 3), faces.reshape(-1, 3)])
    for sign in (1.0, -1.0):
        alone = max(highest_vertex_contact(point[None], face[None], sign, *FULL) for point in points for face in faces)
        assert highest_vertex_contact(points, faces, sign, *FULL) == alone
        assert highest_vertex_contact(points, faces, sign, alone - 1e-3, alone - 2e-3) == alone - 1e-3
        assert highest_vertex_contact(points, faces, sign, -np.inf, alone - 1e-3) > alone - 1e-3


def test_nothing_touches_nothing() -> None:
    none, one = np.zeros((0, 2, 3)), np.zeros((1, 2, 3))
    assert highest_edge_contact(none, one, *FULL) == highest_edge_contact(one, none, *FULL) == -np.inf
    assert highest_vertex_contact(np.zeros((0, 3)), np.zeros((1, 3, 3)), 1.0, *FULL) == -np.inf
