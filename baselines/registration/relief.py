"""Reliefs: height images of a solid along an axis; the part from below, the kit from above.

A cavity is what its part sweeps on the way out, dilated sideways by the clearance. Along the insertion axis both are
height fields: at the goal the relief of the kit equals the part's lower envelope, dilated and cut off at the rim.
Images are square, [m], cell (i, j) at ((i, j) - (n - 1) / 2) * cell in the plane; values along its normal.
"""

from __future__ import annotations

from functools import lru_cache, reduce
from itertools import product

import numpy as np

from kit1000.compiled import compiled
from kit1000.pose import Pose
from kit1000.voxels import Volume

RADIUS = 0.06  # [m] below the middle of an image, where a search for the surface begins at the latest
MARGIN = 3e-3  # [m] least about the volume of a part, of its images


def image_cells(part: Volume, clearance: float, cell: float) -> int:
    """Cells across an image that holds a part, dilated by the clearance, in any rotation about its volume's middle."""
    half = max(part.grid.shape) * part.grid.voxel_size / 2 + max(MARGIN, clearance)
    return 2 * round(half / cell)


def lower_envelope(
    volume: Volume, plane_from_now: Pose, cell: float, cells: int, start: np.ndarray | None = None
) -> np.ndarray:
    """(n, n) [m]: the lowest height of a solid in each column; +inf where there is none.

    start: (n, n) [m] heights from which on the solid is searched, with nothing where they are +inf; all by default.

    plane_from_now takes the solid into the frame of the image. The surface is found by sphere tracing in the volume of
    truncated distances, then linearly between the last two samples.
    """
    grid_from_plane = volume.grid.world_from_grid.inverse() @ plane_from_now.inverse()
    linear = grid_from_plane.rotation_matrix() / volume.grid.voxel_size
    origin = grid_from_plane.xyz / volume.grid.voxel_size
    heights = np.empty((cells, cells))
    low, high = _bounds(volume, plane_from_now)
    lowest = min(-RADIUS, low[2])
    first = np.full((cells, cells), lowest) if start is None else np.maximum(start, lowest)
    at = (np.arange(cells) - (cells - 1) / 2) * cell
    first[(at < low[0]) | (at > high[0])] = np.inf
    first[:, (at < low[1]) | (at > high[1])] = np.inf
    _march(volume.values, linear, origin, cell, first, high[2], volume.grid.voxel_size, heights)
    return heights


def _bounds(volume: Volume, plane_from_now: Pose) -> tuple[np.ndarray, np.ndarray]:
    """(3,) [m] twice, in the plane's frame: the corners of a box that holds a solid; empty where there is none."""
    box = _box(volume)
    if box is None:
        return np.full(3, np.inf), np.full(3, -np.inf)
    corners = plane_from_now.apply(box)
    return corners.min(0), corners.max(0)


@lru_cache(maxsize=4)  # the volumes of a part, each asked for its envelopes many times
def _box(volume: Volume) -> np.ndarray | None:
    """(8, 3) [m] world: the corners of a box, along the axes of its grid, about a solid; None where there is none."""
    solid = volume.values < 0
    sides = [np.flatnonzero(solid.any(axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    if len(sides[0]) == 0:
        return None
    ends = [(side[0] - 1.0, side[-1] + 1.0) for side in sides]  # the surface lies less than a voxel from the solid
    return volume.grid.world(np.array(list(product(*ends))))


def dilated(envelope: np.ndarray, cell: float, clearance: float) -> np.ndarray:
    """(n, n) [m]: the lower envelope of a part dilated at every height by a disc with the clearance as its radius."""
    halves = disc(cell, clearance).sum(1) // 2  # cells to either side, in each row of the disc
    n, radius = len(envelope), len(halves) // 2
    wide = np.pad(envelope, radius, constant_values=np.inf)
    along = [wide[:, radius : radius + n]]  # the least within so many cells along the second axis
    for half in range(1, radius + 1):
        sides = (wide[:, start : start + n] for start in (radius - half, radius + half))
        along.append(reduce(np.minimum, sides, along[-1]))
    return reduce(np.minimum, (along[half][row : row + n] for row, half in enumerate(halves.tolist())))


def disc(cell: float, clearance: float) -> np.ndarray:
    """(m, m) bool: the cells of a disc with the clearance [m] as its radius."""
    radius = int(np.floor(clearance / cell + 0.5))
    u, v = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return u * u + v * v <= (clearance / cell + 0.5) ** 2


@compiled
def _march(values, linear, origin, cell, first, radius, voxel, heights):
    n = heights.shape[0]
    dx, dy, dz = linear[0, 2], linear[1, 2], linear[2, 2]
    truncation = 5.0 * voxel
    for i in range(n):
        for j in range(n):
            u, v = (i - (n - 1) / 2) * cell, (j - (n - 1) / 2) * cell
            x0 = linear[0, 0] * u + linear[0, 1] * v + origin[0]
            y0 = linear[1, 0] * u + linear[1, 1] * v + origin[1]
            z0 = linear[2, 0] * u + linear[2, 1] * v + origin[2]
            height, before, low = np.inf, 1.0, first[i, j]
            w = first[i, j]
            while w <= radius:
                value = read_value(values, x0 + dx * w, y0 + dy * w, z0 + dz * w)
                if value < 0:
                    height = low + (w - low) * before / (before - value) if before > value else w
                    break
                before, low = value, w
                w += max(value * truncation, 0.25 * voxel)
            heights[i, j] = height


@compiled
def read_value(values, x, y, z):
    """The value at a point, linear between voxels; 1 outside and where it is unknown."""
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
