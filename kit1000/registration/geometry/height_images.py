"""Reliefs: height images of a solid along an axis; the part from below, the kit from above.

A cavity is what its part sweeps on the way out, dilated sideways by the clearance. Along the insertion axis both are
height fields: at the goal the relief of the kit equals the part's lower envelope, dilated and cut off at the rim.
Images are square, [m], cell (i, j) at ((i, j) - (n - 1) / 2) * cell in the plane; values along its normal.
"""

from __future__ import annotations

from functools import lru_cache, reduce
from itertools import product

import numpy as np

from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.voxels import Volume

RADIUS = 0.06  # [m] below the middle of an image, where a search for the surface begins at the latest
ROUNDING = 1e-6  # [voxels] about boxes, by which the ends of rays may be off
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
    heights = np.full((cells, cells), np.inf)
    solid, near = _boxes(volume)
    if solid is None or near is None:
        return heights
    corners = plane_from_now.apply(volume.grid.world(np.array(list(product(*solid.T)))))
    lowest = min(-RADIUS, corners[:, 2].min())
    first = np.full((cells, cells), lowest) if start is None else np.maximum(start, lowest)
    _march(volume.values, linear, origin, cell, first, solid, near, volume.grid.voxel_size, heights)
    return heights


@lru_cache(maxsize=4)  # the volumes of a part, each asked for its envelopes many times
def _boxes(volume: Volume) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(2, 3) [voxels], twice: the corners of the boxes outside which no value is negative, and outside which all are 1.

    None where none is.
    """
    return _box(volume.values < 0), _box(volume.values != 1)


def _box(voxels: np.ndarray) -> np.ndarray | None:
    """(2, 3) [voxels]: the corners of the box in which voxels (nx, ny, nz) bool are read, linear between voxels."""
    sides = [np.flatnonzero(voxels.any(axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    if len(sides[0]) == 0:
        return None
    return np.array([[side[0] - 1.0 for side in sides], [side[-1] + 1.0 for side in sides]])


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
def _march(values, linear, origin, cell, first, solid, near, voxel, heights):
    """Fill heights (n, n) [m], +inf as they come, by sphere tracing upwards from `first` (n, n) [m].

    solid, near: of `_boxes`. Before a ray enters `near` it reads nothing but 1, so its steps are known.
    """
    n = heights.shape[0]
    dx, dy, dz = linear[0, 2], linear[1, 2], linear[2, 2]
    truncation = 5.0 * voxel
    ray = np.empty(3)
    for i in range(n):
        for j in range(n):
            u, v = (i - (n - 1) / 2) * cell, (j - (n - 1) / 2) * cell
            x0 = linear[0, 0] * u + linear[0, 1] * v + origin[0]
            y0 = linear[1, 0] * u + linear[1, 1] * v + origin[1]
            z0 = linear[2, 0] * u + linear[2, 1] * v + origin[2]
            ray[0], ray[1], ray[2] = x0, y0, z0
            enters, leaves = _through(solid, ray, linear)
            if enters > leaves:
                continue
            enters, _ = _through(near, ray, linear)
            height, before, low = np.inf, 1.0, first[i, j]
            w = first[i, j]
            while w < enters:
                low = w
                w += truncation
            while w <= leaves:
                value = read_value(values, x0 + dx * w, y0 + dy * w, z0 + dz * w)
                if value < 0:
                    height = low + (w - low) * before / (before - value) if before > value else w
                    break
                before, low = value, w
                w += max(value * truncation, 0.25 * voxel)
            heights[i, j] = height


@compiled
def _through(box, ray, linear):
    """The heights [m] at which an upright ray enters and leaves a box (2, 3) [voxels]; leaving first where it misses.

    ray: (3,) [voxels] where it is at height 0.
    """
    enters, leaves = -np.inf, np.inf
    for axis in range(3):
        slope = linear[axis, 2]
        low, high = box[0, axis] - ROUNDING - ray[axis], box[1, axis] + ROUNDING - ray[axis]
        if slope != 0:
            a, b = low / slope, high / slope
            enters, leaves = max(enters, min(a, b)), min(leaves, max(a, b))
        elif low > 0 or high < 0:
            return np.inf, -np.inf
    return enters, leaves


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
