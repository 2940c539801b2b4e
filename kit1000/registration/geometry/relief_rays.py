"""Rays of a camera on the relief of a cavity in a plate: the depths that the camera would measure."""

from __future__ import annotations

import numpy as np

from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.registration.geometry.height_images import dilated, image_cells, lower_envelope
from kit1000.voxels import Volume

CELL = 0.5e-3  # [m] of a relief, and of the steps along a ray
DEEPEST = 30e-3  # [m] below the face at which a ray ends


def cavity_relief(part: Volume, plate_from_now: Pose, pivot: np.ndarray, clearance: float) -> np.ndarray:
    """(n, n) [m] heights about a pivot of the cavity that a part would cut, 0 on the plate's face; cells of CELL.

    Args:
        part: as it lies now.
        plate_from_now: takes it into the cavity.
        pivot: (3,) [m] plate frame; its height does not count.
        clearance: [m]
    """
    about = Pose.from_translation((-pivot[0], -pivot[1], 0.0))
    envelope = lower_envelope(part, about @ plate_from_now, CELL, image_cells(part, clearance, CELL))
    return np.minimum(dilated(envelope, CELL, clearance), 0.0)


@compiled
def trace(origin, rays, relief, middle, tangent, depth):
    """Fill depth (n,) [m]: where rays (n, 3) from an origin meet a relief (m, m) [m], of cells of CELL about a middle.

    tangent: of half the angle by which the relief is rotated.
    """
    cells = len(relief)
    cosine = (1 - tangent * tangent) / (1 + tangent * tangent)
    sine = 2 * tangent / (1 + tangent * tangent)
    for k in range(len(rays)):
        height, before = 0.0, 0.0
        while True:
            t = (height - origin[2]) / rays[k, 2]
            x, y = origin[0] + t * rays[k, 0] - middle[0], origin[1] + t * rays[k, 1] - middle[1]
            above = height - _height_at(relief, cells, cosine * x + sine * y, cosine * y - sine * x)
            if above <= 0 or height <= -DEEPEST:
                break
            height, before = height - CELL, above
        if above < 0 and before > 0:  # between the last two steps
            t -= CELL * above / (above - before) / rays[k, 2]
        depth[k] = t


@compiled
def _height_at(relief, cells, x, y):
    """[m] of a relief at a point of its frame, linear between cells; 0 beyond it."""
    u, v = x / CELL + (cells - 1) / 2, y / CELL + (cells - 1) / 2
    if not (0 <= u < cells - 1 and 0 <= v < cells - 1):
        return 0.0
    i, j = int(u), int(v)
    a, b = u - i, v - j
    near = (1 - b) * relief[i, j] + b * relief[i, j + 1]
    far = (1 - b) * relief[i + 1, j] + b * relief[i + 1, j + 1]
    return (1 - a) * near + a * far
