"""Reliefs: what of a solid shows along an axis, as height images; the part from below, the kit from above.

A cavity is what its part sweeps on the way out, grown sideways by the clearance. Along the insertion axis both are
height fields, so that a part belongs where the relief of the kit equals the part's lower envelope, grown and cut off
at the rim. Images are square, [m], cell (i, j) at ((i, j) - (n - 1) / 2) * cell in the plane; values along its normal.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import minimum_filter

from kit1000.compiled import compiled
from kit1000.pose import Pose
from kit1000.voxels import Volume

REACH = 0.06  # [m] from its middle no part is larger


def lower_envelope(volume: Volume, plane_from_now: Pose, cell: float, cells: int) -> np.ndarray:
    """(n, n) [m]: the height at which each column of a solid begins, seen from below; +inf where there is none.

    plane_from_now carries the solid into the frame of the image. Of a volume of truncated distances the surface is
    found by stepping as far as the distance allows, then linearly between the last two places.
    """
    grid_from_plane = volume.grid.world_from_grid.inverse() @ plane_from_now.inverse()
    linear = grid_from_plane.rotation_matrix() / volume.grid.voxel
    origin = grid_from_plane.xyz / volume.grid.voxel
    heights = np.empty((cells, cells))
    _march(volume.values, linear, origin, cell, REACH, volume.grid.voxel, heights)
    return heights


def grown(envelope: np.ndarray, cell: float, clearance: float) -> np.ndarray:
    """(n, n) [m]: the lower envelope of a part to which a disc as wide as the clearance is added at every height."""
    reach = int(np.floor(clearance / cell + 0.5))
    u, v = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = u * u + v * v <= (clearance / cell + 0.5) ** 2
    return minimum_filter(envelope, footprint=disc, mode="constant", cval=np.inf)


@compiled
def _march(values, linear, origin, cell, reach, voxel, heights):
    n = heights.shape[0]
    dx, dy, dz = linear[0, 2], linear[1, 2], linear[2, 2]
    truncation = 5.0 * voxel
    for i in range(n):
        for j in range(n):
            u, v = (i - (n - 1) / 2) * cell, (j - (n - 1) / 2) * cell
            x0 = linear[0, 0] * u + linear[0, 1] * v + origin[0]
            y0 = linear[1, 0] * u + linear[1, 1] * v + origin[1]
            z0 = linear[2, 0] * u + linear[2, 1] * v + origin[2]
            height, before, low = np.inf, 1.0, -reach
            w = -reach
            while w <= reach:
                value = _read(values, x0 + dx * w, y0 + dy * w, z0 + dz * w)
                if value < 0:
                    height = low + (w - low) * before / (before - value) if before > value else w
                    break
                before, low = value, w
                w += max(value * truncation, 0.25 * voxel)
            heights[i, j] = height


@compiled
def _read(values, x, y, z):
    """The value at a place, linear between voxels; 1 outside and where nobody knows."""
    nx, ny, nz = values.shape
    if not (0 <= x < nx - 1 and 0 <= y < ny - 1 and 0 <= z < nz - 1):
        return 1.0
    i, j, k = int(x), int(y), int(z)
    a, b, c = x - i, y - j, z - k
    low = (1 - b) * ((1 - a) * values[i, j, k] + a * values[i + 1, j, k])
    low += b * ((1 - a) * values[i, j + 1, k] + a * values[i + 1, j + 1, k])
    high = (1 - b) * ((1 - a) * values[i, j, k + 1] + a * values[i + 1, j, k + 1])
    high += b * ((1 - a) * values[i, j + 1, k + 1] + a * values[i + 1, j + 1, k + 1])
    value = (1 - c) * low + c * high
    return value if value == value else 1.0
