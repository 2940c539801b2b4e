"""The seating test: does a predicted pose put the part into its cavity?

The part keeps the predicted orientation, starts HOVER out along the carried axis (the insertion axis, rotated with the
part by the prediction), and moves along it to first contact with the fixed bodies around it. It is seated if all of
these hold:

- contact leaves it at goal height, within min(3 mm, depth/3) along the slot's axis;
- the predicted pose lies within 3 mm of the contact pose;
- it is rotated by at most 10 degrees from its goal. In a slot with more than 4.2 mm of clearance a part that lies on
  the floor can turn farther; there `rotation_limit` limits the rotation, and 10 degrees limit the tilt;
- the slot is the true one.

The strict test has 1 mm instead of 3. The motion to contact does not rotate the part, so its rotation is the predicted
one; without the limit on rotation, jammed parts 17 degrees off would count. `contact_offset` computes the contact in
closed form on faces and edges. Tests compare it, within BISECTION_STEP, with an independent computation by exact
booleans, `tests/samples/exact_offset.py`. All lengths are metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kit1000.kits.contact import ContactFeatures, contact_features, vertical_contact_offset
from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import matmul
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose, quaternion_angle, quaternion_between, quaternion_conjugate, quaternion_multiply
from kit1000.values import Slot

HOVER = 0.1  # [m] the approach begins so far out (paper, section III-E)
SEATED_LIMIT = 3e-3  # [m] of a seated prediction from contact, and of contact from goal height
STRICT_LIMIT = 1e-3  # [m] the same for the strict test
ROTATION_LIMIT = np.radians(10)  # [rad] of a seated prediction from its goal, in both tests
# The same in wide slots, for each metre of clearance: 24 degrees at 10 mm. A part 42 mm long turns by about 7 degrees
# in a slot with 2.5 mm (2.5 mm / 21 mm), one 70 mm long by 16 degrees with 10 mm: the limits are half more.
ROTATION_PER_CLEARANCE = np.radians(2400)
BISECTION_STEP = 0.02e-3  # [m] resolution of the bisection; both limits are tightened by it
PARALLEL_TOLERANCE = 1e-15  # 1 - cos of an angle (45 nrad) that moves no point by a nanometre
WALL_COSINE = 1e-6  # faces whose unit normal has a smaller -z are walls: what they sweep has no volume
UP = np.array([0.0, 0.0, 1.0])
DIRECTIONS = np.radians(np.arange(0, 360, 30.0))  # in the plate's plane: of the shifts and tilt axes of wrong poses
WRONG_TILT = np.radians(20)  # of wrong poses


@dataclass(frozen=True, eq=False)
class InsertedPart:
    """A part with its insertion axis."""

    mesh: Mesh
    axis: np.ndarray  # (3,) unit, part frame: the direction out of the cavity

    @staticmethod
    def of(mesh: Mesh, kit_from_part: Pose) -> InsertedPart:
        """The part in its slot: +z of the kit points out of the cavity."""
        return InsertedPart(mesh, kit_from_part.inverse().rotate(UP))


@dataclass(frozen=True)
class SeatingResult:
    """Result of the seating test for one pose."""

    contact_offset: float  # [m] from the predicted pose to contact along the carried axis; -inf when nothing is below
    contact_height: float  # [m] of the part at contact above its goal, along the slot's axis
    fits: bool  # whether contact alone passes the test, at whatever rotation
    seated: bool
    strict: bool

    @property
    def penetration(self) -> float:
        """[m] of the predicted pose below contact; 0 above it."""
        return max(self.contact_offset, 0.0)


def contact_offset(
    part: InsertedPart,
    fixed: Mesh,
    fixed_from_part: Pose,
    fixed_features: ContactFeatures | None = None,
    enough: float = np.inf,
) -> float:
    """Distance along the carried axis that takes the part to first contact with the fixed bodies [m]; closed form.

    Negative if the part hangs free, -inf if nothing is below it.

    Args:
        fixed_features: the contact features of the fixed bodies from +z of their frame. Callers that test many poses
            pass them once, for the poses whose carried axis is z.
        enough: an offset above it [m] is not searched to its end: the result is then some number above `enough`.
    """
    rotation, axis = fixed_from_part.rotation_matrix(), fixed_from_part.rotate(part.axis)
    if fixed_features is not None and axis[2] > 1 - PARALLEL_TOLERANCE:
        moving = contact_features(part.mesh, rotation, fixed_from_part.xyz, -1.0)
        return vertical_contact_offset(moving, fixed_features, enough)
    axis_to_z = Pose(quaternion_between(axis, UP), np.zeros(3)).rotation_matrix()
    moving = contact_features(part.mesh, matmul(axis_to_z, rotation), matmul(axis_to_z, fixed_from_part.xyz), -1.0)
    return vertical_contact_offset(moving, contact_features(fixed, axis_to_z, np.zeros(3), 1.0), enough)


def seating_result(
    offset: float, part: InsertedPart, kit_from_part: Pose, goal: Pose, depth: float, clearance: float = 0.0
) -> SeatingResult:
    """The seating test for a pose in the frame of the true kit, given its offset to contact [m].

    kit_from_part, goal: unbatched poses in the kit frame, whose z is the slot's axis; depth, clearance: [m] of it.
    """
    if not np.isfinite(offset):
        return SeatingResult(offset, -np.inf, False, False, False)
    contact = kit_from_part.xyz + offset * kit_from_part.rotate(part.axis)
    height = float(contact[2] - goal.xyz[2])

    def passes(limit: float) -> bool:
        deep = min(limit, depth / 3)
        return bool(abs(height) <= deep - BISECTION_STEP and abs(offset) < limit - BISECTION_STEP)

    fits, near = passes(SEATED_LIMIT), is_rotation_seated(kit_from_part, goal, clearance)
    return SeatingResult(offset, height, fits, fits and near, near and passes(STRICT_LIMIT))


def rotation_limit(clearance: float) -> float:
    """[rad] the largest rotation of a seated prediction from its goal in a slot with a clearance [m]."""
    return float(max(ROTATION_LIMIT, ROTATION_PER_CLEARANCE * clearance))


def is_rotation_seated(pose: Pose, goal: Pose, clearance: float = 0.0) -> bool:
    """Whether the rotation of a pose from its goal, both in the kit frame, is one of a seated part.

    It is one if the rotation is at most ROTATION_LIMIT. In a slot with a wide clearance [m] it is also one if it is at
    most `rotation_limit` and tilts the part by at most ROTATION_LIMIT.
    """
    angle = quaternion_angle(pose.wxyz, goal.wxyz)
    if angle <= ROTATION_LIMIT:
        return True
    w, x, y, z = quaternion_multiply(pose.wxyz, quaternion_conjugate(goal.wxyz))
    tilt = 2 * np.arctan2(np.hypot(x, y), np.hypot(w, z))  # between the two directions of the part's axis
    return bool(angle <= rotation_limit(clearance) and tilt <= ROTATION_LIMIT)


def wrong_poses(slot: Slot) -> Iterator[tuple[str, Pose]]:
    """(description, pose): the design pose lifted, shifted and tilted by errors at which no part may seat."""
    design, shift = slot.goals[0], slot.clearance + SEATED_LIMIT
    directions = np.stack([cosine(DIRECTIONS), sine(DIRECTIONS), np.zeros(len(DIRECTIONS))], axis=1)
    yield "lifted 3 mm", Pose.from_translation(np.array([0, 0, SEATED_LIMIT])) @ design
    moved = Pose.from_translation(shift * directions) @ design
    tilted = rotated_about_centroid(design, WRONG_TILT * directions)
    for k in range(len(DIRECTIONS)):
        yield "moved clearance + 3 mm across", moved[k]
        yield "tilted 20 degrees", tilted[k]


def rotated_about_centroid(pose: Pose, rotvec: np.ndarray) -> Pose:
    """The pose rotated about the part's origin, its centroid, by rotation vectors (..., 3) [rad] in the kit frame."""
    return Pose((Pose.from_rotvec(rotvec) @ Pose(pose.wxyz, np.zeros(3))).wxyz, pose.xyz)
