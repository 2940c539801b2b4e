"""The offset to contact by exact booleans: a second computation of the seating test.

`kit1000.kits.seating.contact_offset` computes it in closed form; both agree within BISECTION_STEP.
"""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold, Mesh64, OpType

from kit1000.kits.seating import BISECTION_STEP, HOVER, UP, WALL_COSINE, InsertedPart
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.pose import Pose, quaternion_between

PRISM_FACES = np.array(
    [(0, 1, 2), (5, 4, 3), (0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2), (2, 5, 3), (2, 3, 0)], dtype=np.int32
)


def contact_offset_by_booleans(swept: Manifold, part: InsertedPart, fixed: Manifold, fixed_from_part: Pose) -> float:
    """[m] along the carried axis that takes the part to first contact: the smallest at which it sweeps free space.

    swept: `swept_solid` of the part along its axis, part frame. With it "free" is monotone in the offset, so bisection
    is exact; the error is at most BISECTION_STEP / 2.
    """
    placed = swept.transform(fixed_from_part.matrix()[:3])
    axis = fixed_from_part.rotate(part.axis)

    def free(offset: float) -> bool:
        return (placed.translate(axis * offset) ^ fixed).is_empty()

    low, high = -HOVER, HOVER
    if free(low):
        return -np.inf
    while high - low > BISECTION_STEP:
        middle = (low + high) / 2
        low, high = (low, middle) if free(middle) else (middle, high)
    return (low + high) / 2


def swept_solid(mesh: Mesh, axis: np.ndarray, length: float = HOVER) -> Manifold:
    """The solid that a part sweeps when it moves `length` [m] along a unit axis, part frame.

    It is the union of the part at both ends of the motion and of a prism over each face that points backward.
    """
    axis_to_z = Pose(quaternion_between(axis, UP), np.zeros(3))
    upright = mesh.moved(axis_to_z)
    ends = [solid_from_mesh(upright), solid_from_mesh(upright).translate((0, 0, length))]
    backs = upright.triangles[upright.normals[:, 2] < -WALL_COSINE]
    swept = Manifold.batch_boolean(ends + [_prism(back, length) for back in backs], OpType.Add)
    return swept.transform(axis_to_z.inverse().matrix()[:3])


def _prism(triangle: np.ndarray, length: float) -> Manifold:
    """A downward-facing triangle (3, 3) [m] extruded up by a length [m]."""
    corners = np.concatenate([triangle, triangle + [0, 0, length]])
    return Manifold(Mesh64(corners, PRISM_FACES))
