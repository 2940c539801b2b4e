"""Convex pieces of kits and parts: they fill the body, add little, and leave the clearance open."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import CrossSection, FillRule, Manifold, triangulate

from kit1000.kits.collision_pieces import clearance_left, kit_pieces, missing_and_extra, part_pieces, union_of
from kit1000.kits.convex_pieces import TOLERANCE, convex_polygons, convex_prisms
from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh, surface_points
from kit1000.values import Kit
from tests.samples.kits import sample_kit, sample_part

FAMILIES = ["tee", "cover", "hinge", "stepped_shaft", "clevis"]  # upright walls, ledges, round and sloping bottoms
MAX_PIECES = 400
VOLUME_TOLERANCE = 1e-12  # [m^3]
ROUNDING = 60e-9  # [m] rounding of the plate's vertices moves its floor by no more


@cache
def pieces_of(family: str) -> tuple[Mesh, ...]:
    return tuple(convex_prisms(sample_kit(family)))


def cavity_of(kit: Kit) -> Manifold:
    low, high = kit.mesh.bounds
    return Manifold.cube(high - low).translate(low) - solid_from_mesh(kit.mesh)


@pytest.mark.parametrize("family", FAMILIES)
def test_pieces_are_convex_and_disjoint(family: str) -> None:
    pieces = [solid_from_mesh(piece) for piece in pieces_of(family)]
    assert len(pieces) <= MAX_PIECES
    assert all(abs(piece.hull().volume() - piece.volume()) < 1e-6 * piece.volume() for piece in pieces)
    neighbours = [(a, b) for a, b in combinations(pieces, 2) if boxes_meet(a, b)]
    assert all((a ^ b).volume() < 1e-15 for a, b in neighbours)


def boxes_meet(a: Manifold, b: Manifold) -> bool:
    first, second = np.reshape(a.bounding_box(), (2, 3)), np.reshape(b.bounding_box(), (2, 3))
    return bool((first[0] < second[1]).all() and (second[0] < first[1]).all())


@pytest.mark.parametrize("family", FAMILIES)
def test_pieces_fill_the_kit_and_nothing_else(family: str) -> None:
    kit = solid_from_mesh(sample_kit(family).mesh)
    pieces = [solid_from_mesh(piece) for piece in pieces_of(family)]
    assert sum((piece - kit).volume() for piece in pieces) < VOLUME_TOLERANCE
    assert sum(piece.volume() for piece in pieces) >= 0.97 * kit.volume()


@pytest.mark.parametrize("family", FAMILIES)
def test_the_cavity_stays_open_at_every_height(family: str) -> None:
    kit, pieces = sample_kit(family), pieces_of(family)
    cavity = cavity_of(kit)
    edges = np.unique([piece.bounds[:, 2] for piece in pieces[1:]])  # the first is the floor slab
    for z in (edges[1:] + edges[:-1]) / 2:
        contours = cavity.slice(z).to_polygons()
        corners = np.concatenate(contours)[triangulate(contours)]
        points = np.column_stack([corners.mean(1), np.full(len(corners), z)])
        inside = [((points[:, None] - p.triangles[:, 0]) * p.normals).sum(2).max(1) < -1e-7 for p in pieces]
        assert len(points)
        assert not np.any(inside)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_seated_part_overlaps_no_piece(family: str) -> None:
    part = solid_from_mesh(sample_part(family).mesh.moved(sample_kit(family).slot.kit_from_part))
    assert sum((part ^ solid_from_mesh(piece)).volume() for piece in pieces_of(family)) < ROUNDING * part.surface_area()


@given(st.integers(0, 2**32), st.integers(3, 40), st.integers(0, 3))
def test_polygons_are_convex_and_add_up_to_the_section(seed: int, corners: int, holes: int) -> None:
    rng = np.random.default_rng(seed)
    section = star(rng, corners)
    for _ in range(holes):
        section -= star(rng, 9).scale((0.2, 0.2)).translate(rng.uniform(-0.4, 0.4, 2))
    polygons = convex_polygons(section)
    assert abs(sum(CrossSection.hull_points(p).area() for p in polygons) - section.area()) < 1e-6
    for polygon in polygons:
        along = np.roll(polygon, -1, axis=0) - polygon
        after = np.roll(along, -1, axis=0)
        assert (along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0]).min() >= 0


def star(rng: np.random.Generator, corners: int) -> CrossSection:
    """A polygon about the origin with corners at any distance."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
    radii = rng.uniform(0.2, 1, corners)
    return CrossSection([np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])], FillRule.Positive)


def test_a_square_with_a_square_hole_takes_four_pieces() -> None:
    ring = CrossSection.square((4, 4), center=True) - CrossSection.square((2, 2), center=True)
    assert len(convex_polygons(ring)) == 4


SOLIDS = ["tee", "cover", "bracket", pytest.param("stepped_shaft", marks=pytest.mark.slow)]
WITHIN = 0.25e-3  # [m]


@cache
def pieces(family: str) -> tuple[list[Mesh], list[Mesh]]:
    return part_pieces(sample_part(family).mesh, WITHIN), kit_pieces(sample_kit(family))


@pytest.mark.parametrize("family", SOLIDS)
def test_pieces_are_convex(family: str) -> None:
    for piece in map(solid_from_mesh, [*pieces(family)[0], *pieces(family)[1]]):
        assert abs(piece.hull().volume() - piece.volume()) < 1e-5 * piece.volume()


@pytest.mark.parametrize("family", SOLIDS)
def test_pieces_miss_and_add_little(family: str) -> None:
    for mesh, own in zip((sample_part(family).mesh, sample_kit(family).mesh), pieces(family), strict=True):
        missing, extra = missing_and_extra(mesh, own)
        assert missing < 2e-3 * mesh.volume
        assert extra < TOLERANCE * mesh.area


@pytest.mark.parametrize("family", SOLIDS)
def test_a_part_is_exceeded_within_the_tolerance(family: str) -> None:
    part = sample_part(family).mesh
    union = union_of(pieces(family)[0])
    ball = Manifold.sphere(2.5 * WITHIN, 16)  # the samples of an excess miss some of its depth
    points = surface_points(mesh_from_solid(union), 300, np.random.default_rng(0))
    solid = solid_from_mesh(part)
    assert all(not (ball.translate(point) ^ solid).is_empty() for point in points)


@pytest.mark.parametrize("family", SOLIDS)
def test_the_clearance_stays_open(family: str) -> None:
    slot, (part, kit) = sample_kit(family).slot, pieces(family)
    true = clearance_left(slot, [sample_part(family).mesh], [sample_kit(family).mesh])
    assert true == pytest.approx(slot.clearance, abs=0.02e-3)
    assert true - 1.5 * (WITHIN + TOLERANCE) < clearance_left(slot, part, kit) <= true + 1e-6


def test_a_convex_part_is_one_piece_and_two_boxes_are_two() -> None:
    box = Manifold.cube((0.04, 0.02, 0.01))
    assert len(part_pieces(mesh_from_solid(box), WITHIN)) == 1
    angle = mesh_from_solid(box + Manifold.cube((0.01, 0.02, 0.03)))
    assert len(part_pieces(angle, WITHIN)) == 2
    assert missing_and_extra(angle, part_pieces(angle, WITHIN)) == pytest.approx((0, 0), abs=1e-12)
