"""The choice of a kit for a part: the first of its insertion faces whose kit passes all trials.

A face passes when its kit tells rotations apart: the part seats at its goals, at no wrong pose, and there is no loose
fit. That bounds the keyedness: a rotation by `rotation_limit` that still seats would be a loose fit, unless it is near
another goal, as for a free axis or a gear with many teeth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kit1000.errors import Redraw
from kit1000.kits.acceptance import PairCheck, check_pair
from kit1000.kits.early_refusal import sure_refusal
from kit1000.kits.kit import CLEARANCE, UNIT_PLATE, KitDesign, Plate, SlotDesign, cut_kit, design_slot, insertion_faces
from kit1000.kits.loose_fits import accepts_most_parts
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.parts.family import FILE
from kit1000.values import Part

ANY_FACE = 0.01  # least probability of a face on which a part might be put in: more than it is laid on


@dataclass(frozen=True, eq=False)
class Attempt:
    """The kit of a part on one of its faces."""

    design: KitDesign | None
    """None when there is no kit."""
    trial: PairCheck | None
    """None when a trial fails."""
    refusal: str | None
    """Why the kit is refused; None if it passes all trials."""


def accepted_kit(part: Part, clearance: float = CLEARANCE, plate: Plate = UNIT_PLATE) -> tuple[KitDesign, PairCheck]:
    """The kit of a part on the first insertion face that passes all trials, in a plate of datasets; and their result.

    Raises Redraw with the reason of the first face when none passes.
    """
    refusals = []
    for attempt in attempts(part, clearance, plate):
        if attempt.design is not None and attempt.trial is not None and attempt.refusal is None:
            return attempt.design, attempt.trial
        refusals.append(attempt.refusal)
    raise Redraw(refusals[0])


def attempts(part: Part, clearance: float, plate: Plate | None, early_refusal: bool = True) -> Iterator[Attempt]:
    """The kit on each insertion face in turn, designed and tried when the iterator gets there.

    plate: None for one fitted to the part.
    early_refusal: the kit of a part of a file is not designed on faces where it surely fails a trial.

    Raises Redraw if there is no insertion face.
    """
    prepared = PreparedPart(part.mesh, ANY_FACE)
    for face in insertion_faces(part, clearance, fitted_plate=plate is None):
        design = design_slot(part, clearance, face)
        refusal = sure_refusal(prepared, design.slot) if part.family == FILE and early_refusal else None
        yield _attempt(design, prepared, plate) if refusal is None else Attempt(None, None, refusal)


def _attempt(slot: SlotDesign, part: PreparedPart, plate: Plate | None) -> Attempt:
    design = trial = refusal = None
    try:
        design = cut_kit(slot, plate)
        kit = PreparedKit(design.kit)
        if plate is not None:
            _check_for_dataset(design, kit)
        trial = check_pair(part, kit)
        if trial.has_loose_fit:
            raise Redraw("loose fit")
    except Redraw as error:
        refusal = error.reason
    return Attempt(design, trial, refusal)


def _check_for_dataset(design: KitDesign, kit: PreparedKit) -> None:
    """Raise Redraw for a kit that is no good for a dataset, though a user may want it for a part of their own."""
    if not design.clearance_in_bounds:
        raise Redraw("clearance out of bounds")
    if accepts_most_parts(kit):
        raise Redraw("slot takes nearly any part")  # every assembly with it would have one kit
