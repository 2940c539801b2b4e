"""The trials every part and its kit must pass: it seats where it should, and nowhere near where it should not.

All verdicts come from the exact contact of `seating`. A pair that fails is drawn anew; the reason is counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kit1000.errors import Redraw
from kit1000.kits.contact import Ridges, feelers, ridges
from kit1000.kits.face import resting_faces
from kit1000.kits.goals import nearest_turn
from kit1000.kits.loose_fits import Stray, Well, loose_fit
from kit1000.kits.seating import SEATED, Plug, Verdict, contact_raise, verdict
from kit1000.mesh import Mesh
from kit1000.pose import Pose, quaternion_angle
from kit1000.values import Kit, Part

DIRECTIONS = np.radians(np.arange(0, 360, 30.0))  # in-plane directions of shifts and tilt axes
TILT = np.radians(20)
BEYOND = np.radians(5)  # a turn this far beyond keyedness does not seat either
TURN_STEP = np.radians(1)


@dataclass(frozen=True)
class Trial:
    """What the trials found out."""

    keyedness: float | None
    """[rad] smallest turn about the insertion axis that does not seat; None when every turn does (a free axis)."""
    loose: bool
    """Whether the cavity accepts the part in a pose that is no goal."""


class Seat:
    """A part above its kit, ready to be tried in many poses (kit frame)."""

    def __init__(self, mesh: Mesh, kit: Kit) -> None:
        self.slot, self.edges = kit.slot, ridges(kit.mesh)
        self.above = feelers(self.edges, np.eye(3), np.zeros(3), 1.0)
        self.body: Ridges = ridges(mesh)

    def try_pose(self, pose: Pose, goal: Pose) -> Verdict:
        """The verdict on a pose that aims at a goal: the part is inserted along the axis that goal carries."""
        plug = Plug(self.body, goal.inverse().rotate(np.array([0.0, 0.0, 1.0])))
        return verdict(contact_raise(plug, self.edges, pose, self.above), plug, pose, goal, self.slot.depth)

    def seats(self, pose: Pose, goal: Pose) -> bool:
        """Whether a pose that aims at a goal is seated."""
        return self.try_pose(pose, goal).seated


def try_pair(part: Part, kit: Kit) -> Trial:
    """Put a part and its kit through all trials. Raises Redraw with the reason of the first one failed.

    A loose fit is no failure here: it is reported, and whoever draws the pair decides.
    """
    seat, design = Seat(part.mesh, kit), kit.slot.goals[0]
    for goal in kit.slot.goals:
        if not seat.try_pose(goal, goal).strict:
            raise Redraw("does not seat at a goal")
    for name, pose in wrong_poses(kit):
        if not at_a_goal(pose, kit) and seat.seats(pose, design):
            raise Redraw(f"seats when {name}")
    turn = keyedness(seat)
    for pose in over_turned(kit, turn):
        if not at_a_goal(pose, kit, turn) and seat.seats(pose, design):
            raise Redraw("seats when turned past its keyedness")
    loose = loose_fit(Stray(part.mesh, resting_faces(part.mesh)), Well(kit)) is not None
    return Trial(turn, loose)


def wrong_poses(kit: Kit) -> Iterator[tuple[str, Pose]]:
    """The design pose moved, lifted and tilted by amounts that no seated part may be off."""
    design = kit.slot.goals[0]
    across = kit.slot.clearance + SEATED
    yield "lifted 3 mm", Pose.from_translation(np.array([0, 0, SEATED])) @ design
    for angle in DIRECTIONS:
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
        yield "moved clearance + 3 mm across", Pose.from_translation(across * direction) @ design
        yield "tilted 20 degrees", about_anchor(design, TILT * direction)


def about_anchor(pose: Pose, rotvec: np.ndarray) -> Pose:
    """The pose turned about the part's own origin by a rotation vector (3,) [rad] in the kit frame."""
    return Pose((Pose.from_rotvec(rotvec) @ Pose(pose.wxyz, np.zeros(3))).wxyz, pose.xyz)


def keyedness(seat: Seat) -> float | None:
    """The smallest turn from the design pose at which the part seats neither this way round nor the other."""
    design = seat.slot.goals[0]
    for turn in np.arange(TURN_STEP, np.pi, TURN_STEP):
        if not any(seat.seats(about_anchor(design, np.array([0, 0, s * turn])), design) for s in (1, -1)):
            return float(turn)
    return None


def over_turned(kit: Kit, turn: float | None) -> Iterator[Pose]:
    """The design pose turned a little more than its keyedness [rad], both ways; nothing for a free axis."""
    for side in (1, -1) if turn is not None else ():
        yield about_anchor(kit.slot.goals[0], np.array([0, 0, side * ((turn or 0.0) + BEYOND)]))


def at_a_goal(pose: Pose, kit: Kit, within: float | None = None) -> bool:
    """Whether a pose is, up to the free axis, a goal: TURN_STEP or `within` [rad] and a millimetre from it at most."""
    reach = max(TURN_STEP, within or 0.0)
    for goal in kit.slot.goals:
        turned = goal if kit.slot.free_axis is None else nearest_turn(pose, goal, kit.slot.free_axis)
        if quaternion_angle(pose.wxyz, turned.wxyz) < reach and np.linalg.norm(pose.xyz - turned.xyz) < SEATED / 3:
            return True
    return False
