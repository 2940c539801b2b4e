"""CAD functions compared with closed forms: volumes, bounding boxes, holes counted by the genus."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import CrossSection, Manifold

from kit1000.mesh import defect, mesh_from_solid
from kit1000.parts import cad

ROUND = 4e-3
"""Relative loss of an area or volume when inscribed polygons stand for circles."""
LENGTHS = st.floats(4.0, 40.0)


def _closed(solid: Manifold) -> Manifold:
    """The solid itself, after making sure that its mesh is closed."""
    assert defect(mesh_from_solid(solid)) is None
    return solid


def _box(solid: Manifold) -> np.ndarray:
    return np.asarray(solid.bounding_box())


@pytest.mark.parametrize(
    ("drawn", "area"),
    [
        (lambda: cad.circle(20), np.pi * 100),
        (lambda: cad.ring(20, 10), np.pi * 75),
        (lambda: cad.rectangle(10, 20), 200),
        (lambda: cad.rectangle(10, 20, 3), 200 - (4 - np.pi) * 9),
        (lambda: cad.ngon(6, 10), 50 * np.sqrt(3)),
        (lambda: cad.slot(30, 10), 200 + np.pi * 25),
        (lambda: cad.sector(20, 30, 120), np.pi * 25),
        (lambda: cad.polygon([(0, 0), (0, 4), (3, 0)]), 6),
        (lambda: cad.bore(10, key_width=2, key_depth=1), np.pi * 25 + 2),
        (lambda: cad.rounded(cad.rectangle(20, 10), 2), 200 - (4 - np.pi) * 4),
    ],
)
def test_profile_has_the_area_of_the_formula(drawn: Callable[[], CrossSection], area: float) -> None:
    assert drawn().area() == pytest.approx(area, rel=ROUND)


@given(radius=st.floats(0.2, 60.0))
def test_circle_is_fine_enough_and_evenly_divided(radius: float) -> None:
    n = cad.circle_segments(radius)
    assert n % 4 == 0
    assert radius * (1 - np.cos(np.pi / n)) <= 0.02


@pytest.mark.parametrize("teeth", [12, 17, 30])
def test_gear_repeats_and_lies_between_root_and_tip(teeth: int) -> None:
    wheel = cad.gear(teeth, 1.5)
    loop = wheel.to_polygons()[0]
    radii = np.linalg.norm(loop, axis=1)
    assert radii.max() == pytest.approx((teeth + 2) * 0.75)
    assert radii.min() == pytest.approx((teeth - 2.5) * 0.75)
    turned = wheel.rotate(360 / teeth)
    assert (wheel - turned).area() < 1e-6
    mirrored = wheel.mirror((0, 1))
    assert (wheel - mirrored).area() < 1e-6


@given(x=LENGTHS, y=LENGTHS, z=LENGTHS)
def test_box_stands_on_the_floor(x: float, y: float, z: float) -> None:
    block = _closed(cad.box(x, y, z))
    assert block.volume() == pytest.approx(x * y * z)
    assert _box(block) == pytest.approx([-x / 2, -y / 2, 0, x / 2, y / 2, z])


@given(d=LENGTHS, h=LENGTHS)
def test_solids_of_revolution_have_the_volume_of_the_formula(d: float, h: float) -> None:
    full = np.pi * d**2 / 4 * h
    assert _closed(cad.cylinder(d, h)).volume() == pytest.approx(full, rel=3 * ROUND)
    assert _closed(cad.cone(d, 0, h)).volume() == pytest.approx(full / 3, rel=3 * ROUND)
    assert _closed(cad.tube(d, d / 2, h)).volume() == pytest.approx(0.75 * full, rel=3 * ROUND)
    assert _closed(cad.revolved([(0, 0), (d / 2, 0), (0, h)])).volume() == pytest.approx(full / 3, rel=3 * ROUND)


def test_chamfer_of_a_box_removes_the_volume_of_the_formula() -> None:
    x, y, z, c = 20.0, 30.0, 10.0, 2.0
    frustum = sum((x - 2 * t) * (y - 2 * t) for t in (0.0, c)) + 4 * (x - c) * (y - c)  # Simpson's rule is exact
    assert _closed(cad.box(x, y, z, c)).volume() == pytest.approx(x * y * (z - 2 * c) + 2 * c / 6 * frustum)


@given(wanted=st.floats(0.1, 30.0))
def test_a_chamfer_too_large_for_the_profile_is_reduced(wanted: float) -> None:
    bar = _closed(cad.prism(cad.ring(30, 24) - cad.rectangle(50, 4), 10, chamfer=wanted))
    assert len(bar.decompose()) == 2
    assert _box(bar)[[1, 2, 4, 5]] == pytest.approx([-15, 0, 15, 10], abs=0.02)


@pytest.mark.parametrize(
    ("axis", "tip"),
    [("x", (1, 0, 0)), ("-x", (-1, 0, 0)), ("y", (0, 1, 0)), ("-y", (0, -1, 0)), ("z", (0, 0, 1)), ("-z", (0, 0, -1))],
)
def test_laid_solid_points_along_its_axis_with_its_y_up(axis: cad.Axis, tip: tuple[int, int, int]) -> None:
    laid = cad.along(cad.at(cad.box(0.1, 0.1, 10), y=5), axis)
    far = _box(laid).reshape(2, 3)
    assert far.mean(0) @ np.array(tip) == pytest.approx(5)
    if axis[-1] != "z":
        assert far.mean(0)[2] == pytest.approx(5)


@given(nx=st.integers(1, 4), ny=st.integers(1, 3))
def test_each_drilled_hole_adds_one_to_the_genus(nx: int, ny: int) -> None:
    plate = _closed(cad.drill(cad.box(50, 50, 5), 6, cad.grid(nx, ny, 10, 10)))
    assert plate.genus() == nx * ny
    assert plate.volume() == pytest.approx(12500 - nx * ny * np.pi * 9 * 5, rel=1e-3)


@pytest.mark.parametrize("axis", ["x", "-x", "y", "-y", "z", "-z"])
def test_a_blind_hole_has_the_given_depth_from_the_given_side(axis: cad.Axis) -> None:
    sign, row = (-1 if axis[0] == "-" else 1), "xyz".index(axis[-1])
    mouth = np.zeros(3)
    mouth[row] = sign * 10
    block = _closed(cad.drill(cad.at(cad.box(20, 20, 20), z=-10), 6, mouth, axis, depth=4))
    assert block.genus() == 0
    assert block.volume() == pytest.approx(8000 - np.pi * 9 * 4, rel=1e-3)
    centroid = mesh_from_solid(block).centroid
    assert np.sign(centroid[row]) == -sign


def test_countersink_and_counterbore_take_their_cones_and_seats() -> None:
    plate = cad.box(30, 30, 10)
    sunk = cad.drill(plate, 4, (0, 0, 10), countersink=8)
    ring_cone = np.pi / 3 * (4**3 - 2**3) - np.pi * 2**2 * 2
    assert _closed(sunk).volume() == pytest.approx(9000 - np.pi * 4 * 10 - ring_cone, rel=1e-3)
    seated = cad.drill(plate, 4, (0, 0, 10), counterbore=(8, 3))
    assert _closed(seated).volume() == pytest.approx(9000 - np.pi * 4 * 10 - np.pi * (16 - 4) * 3, rel=1e-3)


def test_pocket_and_slot_are_milled_from_the_given_side() -> None:
    block = cad.box(40, 30, 20)
    assert _closed(cad.pocket(block, cad.rectangle(20, 10), 8, (0, 0, 20))).volume() == pytest.approx(24000 - 1600)
    through = _closed(cad.pocket(block, cad.slot(20, 6), None, (0, 0, 10), "-y"))
    assert through.genus() == 1
    assert _box(block - through) == pytest.approx([-10, -15, 7, 10, 15, 13], abs=0.01)
