"""The trials of a kit, and the choice of a kit for a part: the first insertion face whose kit passes all trials.

A kit passes if the part seats at every goal, at no pose that is clearly wrong, and has no loose fit. This bounds the
keyedness: a rotation by `rotation_limit` that still seats would be a loose fit, unless it is near another goal, as with
a free axis or a gear with many teeth. The trials use the closed-form contact of `seating` and ignore the limit on
rotation: they find out if the part goes in, not if a score would count it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kit1000.errors import Redraw
from kit1000.kits.face import RestingFace
from kit1000.kits.goals import is_goal
from kit1000.kits.kit import CLEARANCE, UNIT_PLATE, KitDesign, Plate, design_kit, insertion_faces
from kit1000.kits.loose_fits import accepts_most_parts, find_loose_fit, turns_freely
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.kits.seating import (
    SEATED_LIMIT,
    InsertedPart,
    SeatingResult,
    contact_offset,
    rotated_about_centroid,
    seating_result,
    wrong_poses,
)
from kit1000.pose import Pose
from kit1000.values import Part, Slot

ANY_FACE = 0.01  # least probability of a face on which a part might be put in: more than it is laid on
BEYOND_KEYEDNESS = np.radians(5)  # at a yaw this far beyond the keyedness the part does not seat either
YAW_STEP = np.radians(1)  # of the keyedness
NOT_SEATED = "does not seat at a goal"


@dataclass(frozen=True)
class PairCheck:
    """Properties of an accepted pair."""

    keyedness: float | None
    """Smallest yaw error (rotation about the insertion axis) at which the part does not seat [rad]; None if it seats at
    every yaw, because of a free axis."""
    has_loose_fit: bool
    """Whether the part also seats in a pose that is no goal."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """The kit of a part on one of its faces."""

    design: KitDesign | None
    """None if there is no kit."""
    trial: PairCheck | None
    """None if a trial fails."""
    refusal: str | None
    """Why the kit is refused; None if it passes all trials."""

    @property
    def passed(self) -> tuple[KitDesign, PairCheck] | None:
        """The kit with its trial if it passes, else None."""
        return None if self.refusal or self.design is None or self.trial is None else (self.design, self.trial)


def accepted_kit(part: Part, clearance: float = CLEARANCE, plate: Plate = UNIT_PLATE) -> tuple[KitDesign, PairCheck]:
    """The kit of a part on the first insertion face that passes all trials, in a plate of datasets; and their result.

    Raises Redraw with the reason of the first face if none passes.
    """
    reason = ""
    for attempt in attempts(part, clearance, plate):
        if attempt.passed:
            return attempt.passed
        reason = reason or str(attempt.refusal)
    raise Redraw(reason)


def attempts(part: Part, clearance: float, plate: Plate | None) -> Iterator[Attempt]:
    """The kit on each insertion face in turn, designed and tried when the iterator gets there.

    plate: None for one fitted to the part. Raises Redraw if there is no insertion face.
    """
    prepared = PreparedPart(part.mesh, ANY_FACE)
    for face in insertion_faces(part, clearance, fitted_plate=plate is None):
        yield _attempt(part, clearance, plate, face, prepared)


def _attempt(part: Part, clearance: float, plate: Plate | None, face: RestingFace, prepared: PreparedPart) -> Attempt:
    design = trial = refusal = None
    try:
        design = design_kit(part, clearance, plate, face, prepared.all_faces)
        kit = PreparedKit(design.kit)
        if plate is not None:
            _check_for_dataset(design, kit)
        trial = check_pair(prepared, kit)
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


def check_pair(part: PreparedPart, kit: PreparedKit) -> PairCheck:
    """Run all acceptance tests on a part and its kit. Raises Redraw with the reason of the first one that fails.

    A loose fit is no failure here: it is reported, and the caller decides.
    """
    slot, inserted = kit.slot, InsertedPart.of(part.mesh, kit.design)
    for goal in slot.goals:
        if not seating_at(InsertedPart.of(part.mesh, goal), kit, goal, goal).strict:
            raise Redraw(NOT_SEATED)
    for name, pose in wrong_poses(slot):
        if not is_goal(pose, slot) and fits_at(inserted, kit, pose):
            raise Redraw(f"seats when {name}")
    yaw = keyedness(inserted, kit)
    for pose in poses_beyond_keyedness(slot, yaw):
        if not is_goal(pose, slot, yaw) and fits_at(inserted, kit, pose):
            raise Redraw("seats when turned past its keyedness")
    return PairCheck(yaw, find_loose_fit(part, kit) is not None)


def seating_at(part: InsertedPart, kit: PreparedKit, pose: Pose, goal: Pose, enough: float = np.inf) -> SeatingResult:
    """The seating test of a part, inserted as at a goal, for a pose that is meant for this goal.

    enough: as for `contact_offset`.
    """
    offset = contact_offset(part, kit.mesh, pose, kit.features, enough)
    return seating_result(offset, part, pose, goal, kit.slot.depth, kit.slot.clearance)


def fits_at(part: InsertedPart, kit: PreparedKit, pose: Pose) -> bool:
    """Whether contact alone seats a part in a pose that is meant for the design pose, at whatever rotation."""
    return seating_at(part, kit, pose, kit.design, enough=SEATED_LIMIT).fits


def keyedness(part: InsertedPart, kit: PreparedKit) -> float | None:
    """The smallest yaw from the design pose at which the part seats in neither sense [rad]; None if there is none."""
    if turns_freely(kit.slot):
        return None
    for yaw in np.arange(YAW_STEP, np.pi, YAW_STEP):
        turned = rotated_about_centroid(kit.design, np.array([[0, 0, yaw], [0, 0, -yaw]]))
        if not (fits_at(part, kit, turned[0]) or fits_at(part, kit, turned[1])):
            return float(yaw)
    return None


def poses_beyond_keyedness(slot: Slot, yaw: float | None) -> Iterator[Pose]:
    """The design pose at yaws of +- (keyedness `yaw` [rad] + BEYOND_KEYEDNESS); none for a free axis."""
    for sign in (1, -1) if yaw is not None else ():
        yield rotated_about_centroid(slot.goals[0], np.array([0, 0, sign * ((yaw or 0.0) + BEYOND_KEYEDNESS)]))
