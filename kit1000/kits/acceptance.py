"""Acceptance tests of a part and its kit: the part seats at every goal and at no pose that is clearly wrong.

All of them use the closed-form contact of `seating`, at whatever rotation: what matters is where the part goes in, not
whether a score would count it. A pair that fails is drawn again; the reason is counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from kit1000.errors import Redraw
from kit1000.kits.contact import ConvexEdges, contact_features, convex_edges
from kit1000.kits.face import resting_faces
from kit1000.kits.goals import nearest_about_axis
from kit1000.kits.loose_fits import PreparedKit, PreparedPart, find_loose_fit, turns_freely
from kit1000.kits.seating import SEATED_LIMIT, InsertedPart, SeatingResult, contact_offset, seating_result
from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import length
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose, quaternion_angle
from kit1000.values import Kit, Part, Slot

DIRECTIONS = np.radians(np.arange(0, 360, 30.0))  # in the plate's plane: of shifts and tilt axes
WRONG_TILT = np.radians(20)
BEYOND_KEYEDNESS = np.radians(5)  # at a yaw this far beyond the keyedness the part does not seat either
ANGLE_STEP = np.radians(1)
ANY_FACE = 0.01  # least probability of a face on which a part might be put in: more than it is laid on
NOT_SEATED = "does not seat at a goal"


@dataclass(frozen=True)
class PairCheck:
    """Properties of an accepted pair."""

    keyedness: float | None
    """[rad] smallest yaw error (rotation about the insertion axis) at which the part does not seat; None when it seats
    at every yaw (a free axis)."""
    has_loose_fit: bool
    """Whether the part also seats in a pose that is no goal."""


class SeatingTest:
    """The seating test of one part in its own kit, prepared for many poses (kit frame)."""

    def __init__(self, mesh: Mesh, kit: Kit) -> None:
        self.slot, self.kit_edges = kit.slot, convex_edges(kit.mesh)
        self.kit_features = contact_features(self.kit_edges, np.eye(3), np.zeros(3), 1.0)
        self.part_edges: ConvexEdges = convex_edges(mesh)

    def result(self, pose: Pose, goal: Pose) -> SeatingResult:
        """The result for a pose meant for a goal: +z of the kit at the goal is the part's insertion axis."""
        part = InsertedPart(self.part_edges, goal.inverse().rotate(np.array([0.0, 0.0, 1.0])))
        offset = contact_offset(part, self.kit_edges, pose, self.kit_features)
        return seating_result(offset, part, pose, goal, self.slot.depth, self.slot.clearance)

    def fits(self, pose: Pose, goal: Pose) -> bool:
        """Whether contact alone seats a pose meant for a goal, at whatever rotation."""
        return self.result(pose, goal).fits


def check_pair(part: Part, kit: Kit) -> PairCheck:
    """Run all acceptance tests on a part and its kit. Raises Redraw with the reason of the first one that fails.

    A loose fit is no failure here: it is reported, and the caller decides.
    """
    test, design = SeatingTest(part.mesh, kit), kit.slot.goals[0]
    for goal in kit.slot.goals:
        if not test.result(goal, goal).strict:
            raise Redraw(NOT_SEATED)
    for name, pose in wrong_poses(kit):
        if not is_goal(pose, kit.slot) and test.fits(pose, design):
            raise Redraw(f"seats when {name}")
    yaw = keyedness(test)
    for pose in poses_beyond_keyedness(kit, yaw):
        if not is_goal(pose, kit.slot, yaw) and test.fits(pose, design):
            raise Redraw("seats when turned past its keyedness")
    return PairCheck(yaw, find_loose_fit(prepared_part(part.mesh), PreparedKit(kit)) is not None)


@lru_cache(maxsize=2)  # asked for again at every face that a kit is tried on
def prepared_part(mesh: Mesh) -> PreparedPart:
    """A part prepared for the search for loose fits, on every face that it might be put in on."""
    return PreparedPart(mesh, resting_faces(mesh, ANY_FACE))


def wrong_poses(kit: Kit) -> Iterator[tuple[str, Pose]]:
    """(description, pose): the design pose lifted, shifted and tilted by errors at which no part may seat."""
    return wrong_poses_about(kit.slot.goals[0], kit.slot.clearance)


def wrong_poses_about(design: Pose, clearance: float) -> Iterator[tuple[str, Pose]]:
    """`wrong_poses` of a design pose in a slot with a clearance [m]."""
    shift = clearance + SEATED_LIMIT
    yield "lifted 3 mm", Pose.from_translation(np.array([0, 0, SEATED_LIMIT])) @ design
    for angle in DIRECTIONS:
        direction = np.array([cosine(angle), sine(angle), 0.0])
        yield "moved clearance + 3 mm across", Pose.from_translation(shift * direction) @ design
        yield "tilted 20 degrees", rotated_about_centroid(design, WRONG_TILT * direction)


def rotated_about_centroid(pose: Pose, rotvec: np.ndarray) -> Pose:
    """The pose rotated about the part's origin, its centroid, by a rotation vector (3,) [rad] in the kit frame."""
    return Pose((Pose.from_rotvec(rotvec) @ Pose(pose.wxyz, np.zeros(3))).wxyz, pose.xyz)


def keyedness(test: SeatingTest) -> float | None:
    """[rad] the smallest yaw from the design pose at which the part seats in neither sense; None if there is none."""
    if turns_freely(test.slot):
        return None
    design = test.slot.goals[0]
    for yaw in np.arange(ANGLE_STEP, np.pi, ANGLE_STEP):
        if not any(test.fits(rotated_about_centroid(design, np.array([0, 0, s * yaw])), design) for s in (1, -1)):
            return float(yaw)
    return None


def poses_beyond_keyedness(kit: Kit, yaw: float | None) -> Iterator[Pose]:
    """The design pose at yaws of +- (keyedness `yaw` [rad] + BEYOND_KEYEDNESS); none for a free axis."""
    for sign in (1, -1) if yaw is not None else ():
        yield rotated_about_centroid(kit.slot.goals[0], np.array([0, 0, sign * ((yaw or 0.0) + BEYOND_KEYEDNESS)]))


def is_goal(pose: Pose, slot: Slot, max_angle: float | None = None) -> bool:
    """Whether a pose is a goal up to the free axis, within 1 mm and ANGLE_STEP (or a larger `max_angle` [rad])."""
    limit = max(ANGLE_STEP, max_angle or 0.0)
    for goal in slot.goals:
        nearest = goal if slot.free_axis is None else nearest_about_axis(pose, goal, slot.free_axis)
        shift = length(pose.xyz - nearest.xyz)
        if quaternion_angle(pose.wxyz, nearest.wxyz) < limit and shift < SEATED_LIMIT / 3:
            return True
    return False
