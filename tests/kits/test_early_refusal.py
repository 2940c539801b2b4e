"""Early refusals: if a face is refused early, the exact trials of its kit refuse it too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from kit1000.errors import Redraw
from kit1000.kits import early_refusal
from kit1000.kits.early_refusal import sure_refusal, surface_points
from kit1000.kits.face import RestingFace
from kit1000.kits.kit import cut_kit, design_slot, insertion_faces
from kit1000.kits.kit_trials import ANY_FACE, accepted_kit, attempts, check_pair
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.values import Kit, Part
from tests.samples.kits import sample_part
from tests.samples.shapes import as_part, box, ell, random_solid, ring_plate, upturned_tee

CLEARANCE = 2.5e-3
SOLIDS = {
    "ell": ell(),
    "ring": ring_plate(12),
    "tee": upturned_tee(),
    "bar": box(60, 8, 7),
    "cube": box(10, 10, 10),
    "plate": box(50, 40, 1.5),
    **{f"random {seed}": random_solid(seed) for seed in range(4)},
}


LOOSE = {"loose fit", "seats when tilted 20 degrees"}  # of a loose fit; wrong poses are tried before


@pytest.fixture(autouse=True)
def _any_part_is_dense(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_refusal, "DENSE_FACES", 0)


def exact_refusal(part: Part, kit: Kit) -> str | None:
    try:
        return "loose fit" if check_pair(PreparedPart(part.mesh, ANY_FACE), PreparedKit(kit)).has_loose_fit else None
    except Redraw as refusal:
        return refusal.reason


def first_refusal(part: Part, face: RestingFace) -> str | None:
    return sure_refusal(PreparedPart(part.mesh, ANY_FACE), design_slot(part, CLEARANCE, face).slot)


@pytest.mark.parametrize("name", SOLIDS)
@pytest.mark.parametrize("clearance", [CLEARANCE, pytest.param(0.5e-3, marks=pytest.mark.slow)])
def test_a_face_refused_early_is_refused_by_the_exact_trials(name: str, clearance: float) -> None:
    part = as_part(SOLIDS[name])
    for face in insertion_faces(part, clearance, fitted_plate=True):
        slot = design_slot(part, clearance, face)
        reason = sure_refusal(PreparedPart(part.mesh, ANY_FACE), slot.slot)
        if reason is not None:
            assert exact_refusal(part, cut_kit(slot, None).kit) in ({reason} if reason != "loose fit" else LOOSE)


def test_most_faces_of_a_small_cube_and_of_a_bar_are_refused_early() -> None:
    for name in ("cube", "bar"):
        part = as_part(SOLIDS[name])
        reasons = [first_refusal(part, face) for face in insertion_faces(part, CLEARANCE, True)]
        assert "seats when tilted 20 degrees" in reasons


def test_a_face_whose_kit_passes_is_not_refused() -> None:
    part = as_part(ell())
    assert first_refusal(part, insertion_faces(part)[0]) is None


@pytest.mark.parametrize("long", [30, 40])
def test_a_part_that_also_fits_upside_down_is_refused_early(long: float) -> None:
    """Not quite symmetric: a chamfer on one end leaves another shadow, by less than the clearance."""
    solid = box(long, 18, 14) - box(2, 18, 14, (long / 2, 0, 12))
    assert first_refusal(as_part(solid), insertion_faces(as_part(solid), CLEARANCE, True)[0]) == "loose fit"


def test_a_refused_face_is_designed_only_if_asked_for() -> None:
    part = as_part(box(10, 10, 10))
    early, exact = (next(iter(attempts(part, CLEARANCE, None, early_refusal))) for early_refusal in (True, False))
    assert (early.design, early.trial) == (None, None)
    assert exact.design is not None
    assert exact.refusal == early.refusal == "seats when tilted 20 degrees"


def test_parts_with_few_faces_are_not_refused_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    assert not any(attempt.early for attempt in attempts(as_part(box(10, 10, 10)), CLEARANCE, None))


def test_the_choice_and_the_reason_are_those_without_early_refusals(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = [sample_part("knob"), as_part(box(10, 10, 10)), as_part(ell())]
    early = [choice(part) for part in parts]
    monkeypatch.undo()
    assert early == [choice(part) for part in parts]


def choice(part: Part) -> list[float] | str:
    """The design pose of the accepted kit, or why there is none."""
    try:
        return accepted_kit(part)[0].kit.slot.kit_from_part.matrix().ravel().tolist()
    except Redraw as refusal:
        return refusal.reason


def test_every_point_of_a_surface_is_within_a_step_of_a_sample_point() -> None:
    mesh, rng = as_part(random_solid(3)).mesh, np.random.default_rng(5)
    step = 1e-3
    points = surface_points(mesh.triangles, step)
    shares = rng.dirichlet((1, 1, 1), (len(mesh.faces), 20))
    surface = np.einsum("fkc,fci->fki", shares, mesh.triangles).reshape(-1, 3)
    assert KDTree(points).query(surface)[0].max() <= step
