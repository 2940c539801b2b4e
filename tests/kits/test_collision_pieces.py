"""Collision pieces are convex, contain the solid, exceed it by a tolerance and leave the cavity open."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from manifold3d import Manifold

from kit1000.kits.collision_pieces import clearance_left, kit_pieces, missing_and_extra, part_pieces, union_of
from kit1000.kits.convex_pieces import TOLERANCE, convex_prisms
from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh, surface_points
from tests.samples.kits import sample_kit, sample_part

FAMILIES = ["tee", "cover", "bracket", "stepped_shaft"]
WITHIN = 0.25e-3  # [m]


@cache
def pieces(family: str) -> tuple[list[Mesh], list[Mesh]]:
    return part_pieces(sample_part(family).mesh, WITHIN), kit_pieces(sample_kit(family))


@pytest.mark.parametrize("family", FAMILIES)
def test_pieces_are_convex(family: str) -> None:
    for piece in map(solid_from_mesh, [*pieces(family)[0], *pieces(family)[1]]):
        assert abs(piece.hull().volume() - piece.volume()) < 1e-5 * piece.volume()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_kit_has_no_more_pieces_than_prisms(family: str) -> None:
    assert len(pieces(family)[1]) <= len(convex_prisms(sample_kit(family)))


@pytest.mark.parametrize("family", FAMILIES)
def test_pieces_miss_and_add_little(family: str) -> None:
    for mesh, own in zip((sample_part(family).mesh, sample_kit(family).mesh), pieces(family), strict=True):
        missing, extra = missing_and_extra(mesh, own)
        assert missing < 2e-3 * mesh.volume
        assert extra < TOLERANCE * mesh.area


@pytest.mark.parametrize("family", FAMILIES)
def test_a_part_is_exceeded_within_the_tolerance(family: str) -> None:
    part = sample_part(family).mesh
    union = union_of(pieces(family)[0])
    ball = Manifold.sphere(2.5 * WITHIN, 16)  # the samples of an excess miss some of its depth
    points = surface_points(mesh_from_solid(union), 300, np.random.default_rng(0))
    solid = solid_from_mesh(part)
    assert all(not (ball.translate(point) ^ solid).is_empty() for point in points)


@pytest.mark.parametrize("family", FAMILIES)
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
