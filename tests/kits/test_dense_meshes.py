"""Kits of parts that are read from files: patches of dense meshes merge within the bounds of the clearance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from manifold3d import CrossSection, Manifold

from kit1000.kits.cavity import SAGITTA, grown_sweep, insertion_depth
from kit1000.kits.clearance import measure_clearance
from kit1000.kits.kit import MAX_EXCESS_CLEARANCE, design_kit
from kit1000.kits.patches import EXACT, MERGED_FILE, Detail
from kit1000.kits.shadows import PartShadows
from kit1000.parts.family import FILE
from tests.samples.shapes import MM, as_part, box, standing

CLEARANCE = 2.5e-3
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
