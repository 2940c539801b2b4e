"""Kits keep their plates, clearances and bounds, also for dense meshes of files."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from manifold3d import CrossSection, Manifold

from kit1000.errors import Redraw
from kit1000.kits.cavity import MIN_PROTRUSION, SAGITTA, grown_sweep, insertion_depth
from kit1000.kits.clearance import measure_clearance
from kit1000.kits.kit import (
    CLEARANCE,
    MAX_EXCESS_CLEARANCE,
    MIN_FLOOR,
    MIN_RIM,
    UNIT_PLATE,
    KitDesign,
    Plate,
    design_kit,
    make_kit,
)
from kit1000.kits.patches import EXACT, MERGED_FILE, Detail
from kit1000.kits.shadows import PartShadows, shadow_below
from kit1000.mesh import Mesh, body_count, defect_float32, solid_from_mesh
from kit1000.parts.family import FILE, make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.pose import Pose, random_quaternions
from kit1000.rng import stream
from kit1000.symmetry import Symmetry
from kit1000.values import Part
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import MM, X, Z, as_part, box, cylinder, ell, gaps, outline_points, random_solid, standing

# draws whose plates once opened when equal vertices were merged (walls that touched or folded by nanometres)
ONCE_OPEN = [("wedge", 0), ("cam", 0), ("yoke", 0), ("knob", 2), ("hook", 2), ("flange", 1)]


@pytest.fixture(scope="module")
def design() -> KitDesign:
    return design_kit(as_part(ell(), name="ell"))


def assert_printable(part: Part, kit_mesh: Mesh) -> None:
    assert defect_float32(kit_mesh) is None, part.id
    assert body_count(kit_mesh) == 1
    assert np.array_equal(kit_mesh.vertices, kit_mesh.vertices.astype(np.float32))


@pytest.mark.parametrize("family", QUICK)
def test_plates_are_closed_bodies_of_the_unit_size(family: str) -> None:
    kit = sample_kit(family)
    assert_printable(sample_part(family), kit.mesh)
    assert np.allclose(kit.mesh.bounds, [[-0.0495, -0.0495, -0.022], [0.0495, 0.0495, 0]], atol=1e-6)
    assert np.allclose(kit.extent, [0.099, 0.099, 0.022])


@pytest.mark.parametrize(("family", "number"), ONCE_OPEN)
def test_plates_that_once_opened_are_closed(family: str, number: int) -> None:
    rng = stream(7, "p", family, number)
    part = make_part(family, family, FAMILIES[family].draw(rng), rng.uniform(35e-3, 50e-3))
    assert_printable(part, make_kit(part).mesh)


@pytest.mark.parametrize("family", QUICK)
@pytest.mark.parametrize("form", ["stl", "glb"])
def test_other_packages_read_plates_as_watertight(family: str, form: str) -> None:
    mesh = sample_kit(family).mesh
    data: Any = trimesh.Trimesh(mesh.vertices * 1e3, mesh.faces, process=False).export(file_type=form)
    read = trimesh.load_mesh(io.BytesIO(data), file_type=form)
    read = read if isinstance(read, trimesh.Trimesh) else read.to_mesh()
    read.merge_vertices()
    assert read.is_watertight
    assert read.is_winding_consistent
    assert read.volume == pytest.approx(mesh.volume * 1e9, rel=1e-4)


@pytest.mark.parametrize("clearance_mm", [0.5, 2.5, 10.0])
def test_the_finished_plate_keeps_the_clearance_it_reports(clearance_mm: float) -> None:
    """Walls of the float32 mesh against the seated part's own shadow, by brute force."""
    part = as_part(ell())
    made = design_kit(part, clearance_mm * MM)
    slot = made.kit.slot
    seated = solid_from_mesh(part.mesh.moved(slot.kit_from_part)).translate((0, 0, slot.depth))
    gap = []
    for share in (0.1, 0.5, 0.9):
        loops = solid_from_mesh(made.kit.mesh).slice((share - 1) * slot.depth).to_polygons()
        inner = [loop for loop in loops if np.abs(loop).max() < 0.049]
        gap.append(gaps(outline_points(inner), shadow_below(seated, share * slot.depth)))
    found = np.concatenate(gap)
    assert clearance_mm * MM - 0.02e-3 <= found.min()
    assert found.max() <= clearance_mm * MM + 0.1e-3
    assert made.measured_clearance.smallest == pytest.approx(found.min(), abs=0.02e-3)
    assert made.measured_clearance.largest == pytest.approx(found.max(), abs=0.02e-3)


def test_the_design_pose_stands_on_the_floor_and_touches_nothing(design: KitDesign) -> None:
    slot = design.kit.slot
    part = as_part(ell()).mesh.moved(slot.kit_from_part)
    assert part.bounds[0, 2] == pytest.approx(-slot.depth, abs=1e-9)
    assert (solid_from_mesh(part).translate((0, 0, 2e-6)) ^ solid_from_mesh(design.kit.mesh)).volume() < 1e-15
    assert part.bounds[1, 2] >= MIN_PROTRUSION
    assert slot.depth + MIN_FLOOR <= UNIT_PLATE.thickness + 1e-9


def test_the_report_states_the_properties_of_the_kit(design: KitDesign) -> None:
    report, slot = design.report, design.kit.slot
    assert report["clearance_asked_mm"] == pytest.approx(2.5)
    assert 2.48 <= report["clearance_smallest_mm"] <= report["clearance_largest_mm"] <= 2.6
    assert report["depth_mm"] == pytest.approx(0.6 * 14)
    assert report["proud_mm"] == pytest.approx(0.4 * 14)
    assert report["goals"] == len(slot.goals) == 1
    assert report["free_axis"] is False
    assert report["walls_removed"] == 0
    assert report["undercut_lost_mm3"] == pytest.approx(0, abs=0.1)
    assert 0 < report["face_probability"] <= 1
    assert report["kit_faces"] == len(design.kit.mesh.faces)


def test_rotated_part_axes_give_the_same_cavity() -> None:
    rotation = Pose(random_quaternions(np.random.default_rng(1), 1)[0], np.zeros(3))
    part = as_part(ell())
    other = Part("q", "test", part.mesh.moved(rotation), Symmetry.none(), {}, part.mass)
    a, b = design_kit(part), design_kit(other)
    assert a.kit.mesh.volume == pytest.approx(b.kit.mesh.volume, abs=2e-11)
    assert a.kit.slot.depth == pytest.approx(b.kit.slot.depth)
    assert len(a.kit.slot.goals) == len(b.kit.slot.goals)


def test_the_shadow_is_centred_and_parallel_to_the_plate() -> None:
    askew = as_part(box(38, 20, 16).rotate((0, 0, 33)), Symmetry.dihedral(2, Z, X))
    slot = design_kit(Part("p", "t", askew.mesh, Symmetry.none(), {}, 0.01)).kit.slot
    placed = askew.mesh.moved(slot.kit_from_part)
    assert np.allclose(placed.bounds[:, :2].mean(0), 0, atol=1e-7)
    assert np.allclose(np.sort(placed.extents), [16e-3, 20e-3, 38e-3], atol=1e-6)
    assert placed.extents[0] > placed.extents[1]


def test_a_fitted_plate_is_as_small_as_its_rim_allows() -> None:
    part = as_part(box(160, 90, 40))
    kit = make_kit(part, plate=None)
    shadow = part.mesh.moved(kit.slot.kit_from_part).extents[:2]
    assert np.allclose(kit.extent[:2], shadow + 2 * (CLEARANCE + MIN_RIM), atol=1.01e-3)
    assert kit.extent[2] == pytest.approx(kit.slot.depth + MIN_FLOOR)
    assert_printable(part, kit.mesh)


def test_a_flat_part_fits_a_fitted_plate_and_no_unit_plate() -> None:
    flat = as_part(cylinder(60, 3))
    assert make_kit(flat, plate=None).slot.depth == pytest.approx(1.8e-3)
    with pytest.raises(Redraw, match="no stable face with 7 mm of seated height"):
        make_kit(flat)


def test_a_part_wider_than_the_plate_is_refused() -> None:
    with pytest.raises(Redraw, match="wider than the plate"):
        make_kit(as_part(box(93, 40, 30)))
    with pytest.raises(Redraw, match="wider than the plate"):
        make_kit(as_part(box(40, 20, 14)), plate=Plate((0.05, 0.05), 0.022))


@pytest.mark.parametrize("seed", [3, 29, 41])
def test_kits_of_odd_solids_keep_the_clearance(seed: int) -> None:
    """However the cavity was grown, the finished plate is 0.02 mm too tight at most, and 0.1 mm too wide."""
    part = as_part(random_solid(seed) + box(24, 22, 12))
    made = design_kit(part)
    assert_printable(part, made.kit.mesh)
    assert made.measured_clearance.smallest >= 2.48e-3
    assert made.measured_clearance.largest <= 2.6e-3


CUBIC_MM = MM**3


def filleted(segments: int = 64) -> Manifold:
    """A block with a concave fillet of many facets all round its foot, and a hole off its centre."""
    angles = np.linspace(0, np.pi / 2, segments // 4)
    fillet = np.column_stack([16 - 6 * np.sin(angles), 6 - 6 * np.cos(angles)])
    profile = np.vstack([[(0, 0), (16, 0)], fillet[1:], [(10, 20), (0, 20)]])
    body = Manifold.revolve(CrossSection([profile]), segments)
    return body.rotate((180, 0, 0)).translate((0, 0, 20)) - Manifold.cylinder(40, 2, 2, 48, True).translate((4, 1, 0))


def arched() -> Manifold:
    """A bar with an arch through it, whose sides lean outwards by a degree: slivers seen from above."""
    bar = box(50, 12, 24).warp_batch(leaned)
    return bar - Manifold.cylinder(60, 8, 8, 48, True).rotate((90, 0, 0))


def leaned(points: np.ndarray) -> np.ndarray:
    """Points (n, 3) [mm] of a bar, farther from its middle the higher they are."""
    return np.column_stack([points[:, 0], points[:, 1] + np.sign(points[:, 1]) * 0.0175 * points[:, 2], points[:, 2]])


def swept(solid: Manifold, detail: Detail) -> Manifold:
    """The grown sweep of a solid [mm] below its rim."""
    stood = standing(solid)
    depth = insertion_depth(stood.bounding_box()[5])
    return grown_sweep(PartShadows.of(stood, depth), CLEARANCE, detail).trim_by_plane((0, 0, -1), -depth)


@pytest.mark.parametrize("make", [filleted, arched])
@pytest.mark.parametrize("clearance", [CLEARANCE, 0.5e-3])
def test_the_cavity_of_a_file_keeps_the_bounds_of_the_clearance(make, clearance: float) -> None:
    design = design_kit(replace(as_part(make()), family=FILE), clearance, None)
    measured = measure_clearance(design.kit.mesh, design.cavity, heights=25)
    assert clearance - SAGITTA <= measured.smallest
    assert measured.largest <= clearance + MAX_EXCESS_CLEARANCE


def test_merged_patches_of_a_file_do_not_fill_an_arch() -> None:
    merged, exact = swept(arched(), MERGED_FILE), swept(arched(), EXACT)
    assert (merged - exact).volume() < 0.1 * MM * exact.surface_area() / 10
    assert swept(arched(), Detail(0.07 * MM, 1e-6)).volume() > exact.volume() + 100 * CUBIC_MM  # by its area alone
