"""Tests of coarsely cut cavities: a disc of fewer corners, and the clearance within its bounds all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from manifold3d import CrossSection, Manifold

from kit1000.kits import kit
from kit1000.kits.clearance import measure_clearance
from kit1000.kits.kit import MAX_EXCESS_CLEARANCE, design_kit
from kit1000.kits.patches import COARSE
from kit1000.kits.sweep import SAGITTA, disc_polygon
from kit1000.parts.family import FILE
from tests.samples.shapes import as_part


def filleted(segments: int = 64) -> Manifold:
    """A block with a concave fillet of many facets all round its foot, and a hole off its centre."""
    angles = np.linspace(0, np.pi / 2, segments // 4)
    fillet = np.column_stack([16 - 6 * np.sin(angles), 6 - 6 * np.cos(angles)])
    profile = np.vstack([[(0, 0), (16, 0)], fillet[1:], [(10, 20), (0, 20)]])
    body = Manifold.revolve(CrossSection([profile]), segments)
    return body.rotate((180, 0, 0)).translate((0, 0, 20)) - Manifold.cylinder(40, 2, 2, 48, True).translate((4, 1, 0))


@pytest.mark.parametrize("clearance", [2.5e-3, 0.5e-3])
def test_a_coarse_cavity_keeps_the_bounds_of_the_clearance(clearance: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kit, "DENSE_FACES", 0)
    part = replace(as_part(filleted()), family=FILE)
    design = design_kit(part, clearance, None)
    measured = measure_clearance(design.kit.mesh, design.cavity, heights=25)
    assert clearance - SAGITTA <= measured.smallest
    assert measured.largest <= clearance + MAX_EXCESS_CLEARANCE


def test_the_disc_of_a_coarse_cavity_has_fewer_corners_and_contains_the_clearance() -> None:
    coarse, fine = disc_polygon(2.5e-3, COARSE.disc), disc_polygon(2.5e-3)
    assert len(coarse) < len(fine)
    middle = (coarse + np.roll(coarse, -1, axis=0)) / 2
    assert np.linalg.norm(middle, axis=1).min() >= 2.5e-3 - SAGITTA


def test_a_procedural_part_is_never_cut_coarsely(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kit, "DENSE_FACES", 0)
    part = as_part(filleted())
    before = design_kit(part).kit.mesh
    monkeypatch.setattr(kit, "COARSE", None)
    assert np.array_equal(design_kit(part).kit.mesh.vertices, before.vertices)
