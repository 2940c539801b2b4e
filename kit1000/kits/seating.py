"""The seating test: does a predicted pose put the part into its cavity?

The part is held in the predicted orientation, starts HOVER out along the insertion axis as the prediction carries it,
and moves along that axis to first contact with everything that stands there. It is seated when contact leaves it at
goal height (within min(3 mm, depth/3) along the slot's axis), when the predicted pose lies within 3 mm of the contact
pose, and when the slot is the true one. A strict twin asks 1 mm in place of 3. Two independent ways to the contact:
`contact_raise` (closed form on faces and edges, a millisecond) and `judged_raise` (exact booleans of the part's swept
solid, bisected), which must agree within JUDGE_STEP. All lengths are metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, Mesh64, OpType

from kit1000.kits.contact import ContactFeatures, ConvexEdges, vertical_contact_offset, contact_features, convex_edges
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.pose import Pose, quaternion_between

HOVER = 0.1  # [m] the approach begins so far out (paper, section III-E)
SEATED_LIMIT = 3e-3  # [m] how far a seated prediction may be from contact, and contact from goal height
STRICT_LIMIT = 1e-3  # [m] the same for the strict verdict
BISECTION_STEP = 0.02e-3  # [m] resolution of the bisection; verdicts keep this distance from their limits
PARALLEL_TOLERANCE = 1e-15  # 1 - cos of an angle (45 nrad) that moves nothing by a nanometre
WALL_COSINE = 1e-6  # faces whose unit normal has a smaller -z are walls: what they sweep has no volume
PRISM_FACES = np.array(
    [(0, 1, 2), (5, 4, 3), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (2, 5, 3), (2, 3, 0)], dtype=np.int32
)
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class InsertedPart:
    """A part made ready for contact: its convex edges and the axis it is inserted along."""

    edges: ConvexEdges
    axis: np.ndarray
    """(3,) unit, part frame: the direction out of the cavity."""

    @staticmethod
    def of(mesh: Mesh, kit_from_part: Pose) -> InsertedPart:
        """The part as its slot takes it: out of the cavity is +z of the kit."""
        return InsertedPart(convex_edges(mesh), kit_from_part.inverse().rotate(UP))


@dataclass(frozen=True)
class SeatingResult:
    """What the seating test says of one pose."""

    contact_offset: float
    """[m] from the predicted pose up to contact along the carried axis; -inf when nothing is below."""
    contact_height: float
    """[m] of the part's frame at contact above its goal, along the slot's axis."""
    seated: bool
    strict: bool

    @property
    def penetration(self) -> float:
        """[m] how far the prediction lies below contact; 0 above it."""
        return max(self.contact_offset, 0.0)


def contact_offset(plug: InsertedPart, standing: ConvexEdges, standing_from_part: Pose, above: ContactFeatures | None = None) -> float:
    """How far the part must rise along its carried axis to just touch what stands there [m]; closed form.

    Negative when it hangs free, -inf when nothing is below it. above: what stands there, seen along its own z, for
    callers that try many poses: it serves those whose carried axis is z.
    """
    rotation, axis = standing_from_part.rotation_matrix(), standing_from_part.rotate(plug.axis)
    if above is not None and axis[2] > 1 - PARALLEL_TOLERANCE:
        return vertical_contact_offset(contact_features(plug.edges, rotation, standing_from_part.xyz, -1.0), above)
    path = Pose(quaternion_between(axis, UP), np.zeros(3)).rotation_matrix()
    moving = contact_features(plug.edges, path @ rotation, path @ standing_from_part.xyz, -1.0)
    return vertical_contact_offset(moving, contact_features(standing, path, np.zeros(3), 1.0))


def contact_offset_by_booleans(swept: Manifold, plug: InsertedPart, standing: Manifold, standing_from_part: Pose) -> float:
    """The same by exact booleans: the lowest rise at which the swept part is clear of what stands there [m].

    swept: the part swept out along its axis (`swept_out`), part frame. The swept solid makes "free" monotone in the
    rise, so bisection is exact; the answer is good to JUDGE_STEP / 2.
    """
    placed = swept.transform(standing_from_part.matrix()[:3])
    axis = standing_from_part.rotate(plug.axis)

    def free(rise: float) -> bool:
        return (placed.translate(axis * rise) ^ standing).is_empty()

    low, high = -HOVER, HOVER
    if free(low):
        return -np.inf
    while high - low > BISECTION_STEP:
        middle = (low + high) / 2
        low, high = (low, middle) if free(middle) else (middle, high)
    return (low + high) / 2


def swept_solid(mesh: Mesh, axis: np.ndarray, length: float = HOVER) -> Manifold:
    """The solid a part sweeps when it moves `length` [m] along a unit axis, part frame.

    It is the part at both ends of its way and a prism over each face that looks back.
    """
    turn = Pose(quaternion_between(axis, UP), np.zeros(3))
    upright = mesh.moved(turn)
    ends = [solid_from_mesh(upright), solid_from_mesh(upright).translate((0, 0, length))]
    backs = upright.triangles[upright.normals[:, 2] < -WALL_COSINE]
    swept = Manifold.batch_boolean(ends + [_prism(back, length) for back in backs], OpType.Add)
    return swept.transform(turn.inverse().matrix()[:3])


def _prism(triangle: np.ndarray, length: float) -> Manifold:
    """A triangle (3, 3) [m] that looks down, moved up by a length [m]."""
    corners = np.concatenate([triangle, triangle + [0, 0, length]])
    return Manifold(Mesh64(corners, PRISM_FACES))


def seating_result(rise: float, plug: InsertedPart, slot_from_part: Pose, goal: Pose, depth: float) -> SeatingResult:
    """The seating verdict for a pose in the kit frame of the true slot, given its rise to contact.

    slot_from_part, goal: unbatched poses in the kit frame, whose z is the slot's axis.
    """
    if not np.isfinite(rise):
        return SeatingResult(rise, -np.inf, False, False)
    contact = slot_from_part.xyz + rise * slot_from_part.rotate(plug.axis)
    height = float(contact[2] - goal.xyz[2])

    def passes(limit: float) -> bool:
        deep = min(limit, depth / 3)
        return bool(abs(height) <= deep - BISECTION_STEP and abs(rise) < limit - BISECTION_STEP)

    return SeatingResult(rise, height, passes(SEATED_LIMIT), passes(STRICT_LIMIT))
