"""Acceptance tests of a part and its kit: the part seats at every goal and at no pose that is clearly wrong.

All of them use the closed-form contact of `seating`, at whatever rotation: what matters is where the part goes in, not
whether a score would count it. A pair that fails is drawn again; the reason is counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kit1000.errors import Redraw
from kit1000.kits.goals import nearest_about_axis
from kit1000.kits.loose_fits import find_loose_fit, turns_freely
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.kits.seating import SEATED_LIMIT, InsertedPart, SeatingResult, contact_offset, seating_result
from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import length
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose, quaternion_angle
from kit1000.values import Slot

DIRECTIONS = np.radians(np.arange(0, 360, 30.0))  # in the plate's plane: of shifts and tilt axes
WRONG_TILT = np.radians(20)
BEYOND_KEYEDNESS = np.radians(5)  # at a yaw this far beyond the keyedness the part does not seat either
ANGLE_STEP = np.radians(1)
NOT_SEATED = "does not seat at a goal"


@dataclass(frozen=True)
class PairCheck:
    """Properties of an accepted pair."""

    keyedness: float | None
    """[rad] smallest yaw error (rotation about the insertion axis) at which the part does not seat; None when it seats
    at every yaw (a free axis)."""
    has_loose_fit: bool
    """Whether the part also seats in a pose that is no goal."""


def check_pair(part: PreparedPart, kit: PreparedKit) -> PairCheck:
    """Run all acceptance tests on a part and its kit. Raises Redraw with the reason of the first one that fails.

    A loose fit is no failure here: it is reported, and the caller decides.
    """
    mesh, slot = part.mesh, kit.slot
    for goal in slot.goals:
        if not seating_at(mesh, kit, goal, goal).strict:
            raise Redraw(NOT_SEATED)
    for name, pose in wrong_poses(slot):
        if not is_goal(pose, slot) and fits_at(mesh, kit, pose):
            raise Redraw(f"seats when {name}")
    yaw = keyedness(mesh, kit)
    for pose in poses_beyond_keyedness(slot, yaw):
        if not is_goal(pose, slot, yaw) and fits_at(mesh, kit, pose):
            raise Redraw("seats when turned past its keyedness")
    return PairCheck(yaw, find_loose_fit(part, kit) is not None)


def seating_at(mesh: Mesh, kit: PreparedKit, pose: Pose, goal: Pose, enough: float = np.inf) -> SeatingResult:
    """The seating test of a part in its kit for a pose meant for a goal: the insertion axis is +z at the goal.

    enough: as for `contact_offset`.
    """
    part = InsertedPart.of(mesh, goal)
    offset = contact_offset(part, kit.mesh, pose, kit.features, enough)
    return seating_result(offset, part, pose, goal, kit.slot.depth, kit.slot.clearance)


def fits_at(mesh: Mesh, kit: PreparedKit, pose: Pose) -> bool:
    """Whether contact alone seats a part in a pose that is meant for the design pose, at whatever rotation."""
    return seating_at(mesh, kit, pose, kit.slot.goals[0], enough=SEATED_LIMIT).fits


def wrong_poses(slot: Slot) -> Iterator[tuple[str, Pose]]:
    """(description, pose): the design pose lifted, shifted and tilted by errors at which no part may seat."""
    design, shift = slot.goals[0], slot.clearance + SEATED_LIMIT
    yield "lifted 3 mm", Pose.from_translation(np.array([0, 0, SEATED_LIMIT])) @ design
    for angle in DIRECTIONS:
        direction = np.array([cosine(angle), sine(angle), 0.0])
        yield "moved clearance + 3 mm across", Pose.from_translation(shift * direction) @ design
        yield "tilted 20 degrees", rotated_about_centroid(design, WRONG_TILT * direction)


def rotated_about_centroid(pose: Pose, rotvec: np.ndarray) -> Pose:
    """The pose rotated about the part's origin, its centroid, by a rotation vector (3,) [rad] in the kit frame."""
    return Pose((Pose.from_rotvec(rotvec) @ Pose(pose.wxyz, np.zeros(3))).wxyz, pose.xyz)


def keyedness(mesh: Mesh, kit: PreparedKit) -> float | None:
    """The smallest yaw from the design pose at which the part seats in neither sense [rad]; None if there is none."""
    if turns_freely(kit.slot):
        return None
    design = kit.slot.goals[0]
    for yaw in np.arange(ANGLE_STEP, np.pi, ANGLE_STEP):
        if not any(fits_at(mesh, kit, rotated_about_centroid(design, np.array([0, 0, s * yaw]))) for s in (1, -1)):
            return float(yaw)
    return None


def poses_beyond_keyedness(slot: Slot, yaw: float | None) -> Iterator[Pose]:
    """The design pose at yaws of +- (keyedness `yaw` [rad] + BEYOND_KEYEDNESS); none for a free axis."""
    for sign in (1, -1) if yaw is not None else ():
        yield rotated_about_centroid(slot.goals[0], np.array([0, 0, sign * ((yaw or 0.0) + BEYOND_KEYEDNESS)]))


def is_goal(pose: Pose, slot: Slot, max_angle: float | None = None) -> bool:
    """Whether a pose is a goal up to the free axis, within 1 mm and ANGLE_STEP (or a larger `max_angle` [rad])."""
    limit = max(ANGLE_STEP, max_angle or 0.0)
    for goal in slot.goals:
        nearest = goal if slot.free_axis is None else nearest_about_axis(pose, goal, slot.free_axis)
        shift = length(pose.xyz - nearest.xyz)
        if quaternion_angle(pose.wxyz, nearest.wxyz) < limit and shift < SEATED_LIMIT / 3:
            return True
    return False
