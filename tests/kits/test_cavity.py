"""The cavity is the shadow grown by the clearance, at every height and for every clearance, and nothing more."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from manifold3d import CrossSection, Manifold

from kit1000.kits.cavity import Cavity, insertion_depth
from kit1000.kits.patches import EXACT, merged_underside
from kit1000.kits.shadows import WALL_COSINE
from kit1000.mesh import mesh_from_solid
from tests.samples.shapes import (
    box,
    cavity_of,
    cylinder,
    ell,
    gaps,
    leaning_prism,
    lying_cylinder,
    outline_points,
    plug,
    prism,
    random_solid,
    ring_plate,
    slice_union,
    standing,
    upturned_tee,
)

SHORT, LONG = 0.02e-3, 0.1e-3  # [m] by which the clearance may be below and above its nominal value
AREA_TOLERANCE = 1e-9  # [m^2] sections snap to a grid of nanometres
SHAPES: dict[str, Callable[[], Manifold]] = {
    "box": lambda: box(30, 20, 20),
    "ell": lambda: ell(),
    "hex": lambda: prism(6, 30, 20),
    "cone": lambda: cylinder(12, 24, top=36),
    "cone upside down": lambda: cylinder(36, 24, top=12),
    "lying cylinder": lambda: lying_cylinder(20, 34),
    "leaning": lambda: leaning_prism(),
    "tee": lambda: upturned_tee(),
    "with hole": lambda: ring_plate(26, size=44),
    "plug": lambda: plug(),
}


Cut = Callable[..., tuple[Manifold, Cavity]]


@pytest.fixture(scope="module")
def cut() -> Cut:
    """The solid of a name and its cavity with a clearance in mm (2.5), made once."""

    @cache
    def made(name: str, clearance_mm: float = 2.5) -> tuple[Manifold, Cavity]:
        solid = SHAPES[name]()
        depth = insertion_depth(solid.bounding_box()[5] * 1e-3)
        return standing(solid), cavity_of(solid, depth, clearance_mm * 1e-3)

    return made


def heights(cavity: Cavity) -> np.ndarray:
    """Heights between floor and rim, none of them a ledge."""
    return cavity.depth * np.array([0.013, 0.31, 0.57, 0.83, 0.987])


def assert_keeps_clearance(solid: Manifold, cavity: Cavity, clearance: float, z: float, loose: float = LONG) -> None:
    """Every wall point except those of removed walls is at the clearance from the shadow, and the shadow is open."""
    shadow, opening = slice_union(solid, z), cavity.solid.slice(z)
    walls = outline_points(opening.to_polygons())
    distance = gaps(walls, shadow)
    assert distance.min() >= clearance - SHORT
    opened = cavity.probes[-1].removed_walls
    kept = distance if opened.is_empty() else distance[gaps(walls, opened) > 0.1e-3]
    assert kept.max(initial=0) <= clearance + loose
    assert (shadow - opening).area() < AREA_TOLERANCE


@pytest.mark.parametrize("clearance_mm", [0.5, 1.0, 2.5, 10.0])
@pytest.mark.parametrize("name", SHAPES)
def test_walls_keep_the_clearance_at_every_height(name: str, clearance_mm: float, cut: Cut) -> None:
    solid, cavity = cut(name, clearance_mm)
    for z in heights(cavity)[[0, 2, 4]]:
        assert_keeps_clearance(solid, cavity, clearance_mm * 1e-3, z)


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=5)
def test_walls_keep_the_clearance_of_any_solid(seed: int, joined: bool) -> None:
    """Merged patches may widen the slot a little more, never narrow it."""
    drawn = random_solid(seed)
    depth = insertion_depth(drawn.bounding_box()[5] * 1e-3)
    cavity = cavity_of(drawn, depth, joined=joined)
    for z in depth * np.array([0.237, 0.691]):
        assert_keeps_clearance(standing(drawn), cavity, 2.5e-3, z, loose=2 * LONG if joined else LONG)


@pytest.mark.parametrize("name", ["cone", "leaning", "lying cylinder"])
def test_slopes_stay_slopes(name: str, cut: Cut) -> None:
    _, cavity = cut(name)
    mesh = mesh_from_solid(cavity.solid)
    z = mesh.triangles[..., 2]
    steps = (np.abs(mesh.normals[:, 2]) > 0.999) & (z.min(1) > 0.5e-3) & (z.max(1) < cavity.depth)
    slopes = (mesh.normals[:, 2] < -0.05) & (mesh.normals[:, 2] > -0.95)
    areas = np.linalg.norm(np.cross(*np.moveaxis(mesh.triangles[:, 1:] - mesh.triangles[:, :1], 1, 0)), axis=1) / 2
    assert areas[steps].sum() < 1e-3 * areas[slopes].sum()


@pytest.mark.parametrize(("hole_mm", "posts"), [(7.9, 0), (8.4, 1)])
def test_posts_thinner_than_3_mm_are_removed(hole_mm: float, posts: int) -> None:
    """The post in a hole is thinner than the hole by twice the clearance, 5 mm."""
    cavity = cavity_of(ring_plate(hole_mm), 7.2e-3)
    outer = CrossSection.square((60e-3, 60e-3), center=True)
    walls = (outer - cavity.solid.slice(7e-3)).decompose()
    assert len(walls) == 1 + posts
    assert cavity.removed_wall_count == 1 - posts
    assert (cavity.removed_wall_volume > 0) == (posts == 0)


@pytest.mark.parametrize(("gap_mm", "kept"), [(7.8, False), (8.2, True)])
def test_walls_between_two_legs_are_kept_from_3_mm(gap_mm: float, kept: bool) -> None:
    legs = (
        box(36, 24, 8, (0, 0, 12)) + box(10, 24, 20, (gap_mm / 2 + 5, 0, 0)) + box(10, 24, 20, (-gap_mm / 2 - 5, 0, 0))
    )
    cavity = cavity_of(legs, 11.5e-3)
    middle = np.array([[0.0, 0.0]])
    assert (gaps(middle, cavity.solid.slice(6e-3))[0] > 0) == kept
    assert cavity.removed_wall_count == (0 if kept else 1)


def test_a_wall_that_gets_too_thin_is_removed_from_there_on_alone() -> None:
    """Between two legs it is 7 mm thick up to a ledge at 4 mm, and above it, where they come nearer, 2.8 mm."""
    feet = box(8, 24, 4, (10, 0, 0)) + box(8, 24, 4, (-10, 0, 0))
    legs = box(10.1, 24, 8.1, (8.95, 0, 3.9)) + box(10.1, 24, 8.1, (-8.95, 0, 3.9))
    cavity = cavity_of(feet + legs + box(36, 24, 8, (0, 0, 11.9)), 11.5e-3)
    middle = np.array([[0.0, 0.0]])
    free = [gaps(middle, cavity.solid.slice(z))[0] for z in (1e-3, 3.8e-3, 4.2e-3, 11e-3)]
    assert free[:2] == pytest.approx([3.5e-3] * 2, abs=LONG)
    assert max(free[2:]) < 0
    assert cavity.removed_wall_count == 1
    assert cavity.removed_wall_volume == pytest.approx(2.8e-3 * 24e-3 * 7.5e-3, rel=0.2)


def test_right_angles_of_walls_stay_sharp_where_another_wall_is_removed() -> None:
    """The wall in the inner corner of the L comes to a point; the post in its hole is too thin and goes."""
    holed = ell() - cylinder(5.6, 99).translate((14, -8, -9))
    cavity = cavity_of(holed, 8e-3)
    assert cavity.removed_wall_count == 1
    corner = np.array([-20 + 12 + 2.5, -14 + 12 + 2.5]) * 1e-3
    inside_wall = corner + 0.03e-3
    assert gaps(inside_wall[None], cavity.solid.slice(6e-3))[0] > 0


@pytest.mark.parametrize("name", SHAPES)
def test_the_part_leaves_along_z_without_collision(name: str, cut: Cut) -> None:
    solid, cavity = cut(name)
    block = Manifold.cube((0.1, 0.1, cavity.depth + 2e-3), center=True)
    plate = block.translate((0, 0, cavity.depth - (cavity.depth + 2e-3) / 2)) - cavity.solid
    assert not plate.is_empty()
    for share in (0.0, 0.2, 0.45, 0.7, 0.95):
        assert (solid.translate((0, 0, 1e-7 + share * cavity.depth)) ^ plate).volume() < 1e-15


def test_undercut_of_a_tee_is_the_volume_beside_its_stem(cut: Cut) -> None:
    _, cavity = cut("tee")
    assert cavity.undercut_volume == pytest.approx(20e-3 * 20e-3 * (cavity.depth - 4e-3), rel=0.01)


@pytest.mark.parametrize("name", ["leaning", "lying cylinder", "cone"])
def test_patches_sweep_what_their_triangles_sweep(name: str) -> None:
    assert_same_sweep(downward(name))


@given(st.integers(0, 10_000))
@example(3857)  # where joined patches are one more
@settings(max_examples=5)
def test_patches_of_any_solid_sweep_what_their_triangles_sweep(seed: int) -> None:
    mesh = mesh_from_solid(standing(random_solid(seed)))
    assert_same_sweep(mesh.triangles[mesh.normals[:, 2] < -0.02])


def assert_same_sweep(triangles: np.ndarray) -> None:
    """Prisms over the patches and over the single triangles fill the same space; joined ones fill a little more.

    Patches grow greedily, so that a wider tolerance need not leave fewer: one solid of some hundreds has one more.
    """
    joined, patches = merged_underside(triangles).patches, merged_underside(triangles, EXACT).patches
    assert max(len(joined), len(patches)) <= len(triangles)
    top = float(triangles[..., 2].max()) + 1e-3
    wide, fused, single = (union_of_prisms(pieces, top) for pieces in (joined, patches, list(triangles)))
    surface = sum(np.linalg.norm(np.cross(t[1] - t[0], t[2] - t[0])) for t in triangles) * 1e6 / 2
    assert (single - fused).volume() < 5e-3 * surface  # [mm^3] hulls may err by 3 um, to the open side
    assert (fused - single).volume() < 5e-3 * surface
    assert (single - wide).volume() < 5e-3 * surface
    assert (wide - single).volume() < 0.1 * surface


def union_of_prisms(pieces: list[np.ndarray], top: float) -> Manifold:
    prisms = []
    for corners in pieces:
        high = corners.copy()
        high[:, 2] = top
        prisms.append(Manifold.hull_points(np.concatenate([corners, high]) * 1e3))
    return sum(prisms[1:], prisms[0])


def downward(name: str) -> np.ndarray:
    mesh = mesh_from_solid(standing(SHAPES[name]()))
    return mesh.triangles[mesh.normals[:, 2] < -WALL_COSINE]


def test_a_lying_cylinder_is_few_patches() -> None:
    assert len(merged_underside(downward("lying cylinder")).patches) <= 3


def test_depth_is_sixty_percent_but_at_most_20_mm() -> None:
    assert insertion_depth(10e-3) == pytest.approx(6e-3)
    assert insertion_depth(80e-3) == pytest.approx(20e-3)
    assert insertion_depth(7e-3) == pytest.approx(4e-3)
    assert insertion_depth(5e-3) == pytest.approx(3e-3)
