"""Height maps: heights of a solid along an axis, of a part from below and of a plate from above.

A cavity is what its part sweeps on the way out, dilated sideways by the clearance. Along the insertion axis both are
height fields: at the goal the heights of the kit equal the part's lower envelope, dilated and cut off at the rim. Maps
are square, [m]; cell (i, j) lies at ((i, j) - (n - 1) / 2) * cell in the plane, values are along the plane's normal.
"""

from __future__ import annotations

from functools import lru_cache, reduce
from itertools import product

import numpy as np
from scipy.ndimage import binary_fill_holes

from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import Cavity
from kit1000.voxels import Volume

RADIUS = 0.06  # [m] below the middle of a map, where a search for the surface begins at the latest
ROUNDING = 1e-6  # [voxels] by which boxes are enlarged: the ends of rays may be off by the last digit
MARGIN = 3e-3  # [m] least margin of a map about the volume of a part
HIDDEN = 2e-3  # [m] a cell that is free down to here belongs to the cavity
HIDDEN_FLOOR_TRUST = 0.5  # trust in a floor that is deep but hidden
ISLAND_TRUST = 0.2  # trust in an island of a cavity that is partly hidden
RAY_CELL = 0.5e-3  # [m] cells of the map that rays meet, and the steps along a ray
DEEPEST = 30e-3  # [m] below the face at which a ray ends


def map_cells(part: Volume, clearance: float, cell: float) -> int:
    """Cells across a map that holds a part, dilated by the clearance, in any rotation about its volume's middle."""
    half = max(part.grid.shape) * part.grid.voxel_size / 2 + max(MARGIN, clearance)
    return 2 * round(half / cell)


def lower_envelope(
    volume: Volume, plane_from_now: Pose, cell: float, cells: int, start: np.ndarray | None = None
) -> np.ndarray:
    """(n, n) [m]: the lowest height of a solid in each column; +inf in a column without solid.

    The surface is found by sphere tracing in the volume of truncated distances, then linearly between the last two
    samples.

    Args:
        volume: of the solid.
        plane_from_now: takes the solid into the frame of the map.
        cell: [m] edge of a cell.
        cells: n.
        start: (n, n) [m] heights at which the search begins; +inf leaves a column out. By default below the solid.
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


@lru_cache(maxsize=4)  # the volumes of a part, each read for many envelopes
def _boxes(volume: Volume) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Corners (2, 3) [voxels] of the box that holds all negative values, and of that which holds all other than 1.

    None for a box without such values.
    """
    return _box(volume.values < 0), _box(volume.values != 1)


def _box(voxels: np.ndarray) -> np.ndarray | None:
    """(2, 3) [voxels]: corners of the box in which linear interpolation reads voxels (nx, ny, nz) bool, if any."""
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
    """Fill heights (n, n) [m], +inf before the call, by sphere tracing upwards from `first` (n, n) [m].

    solid, near: the boxes of `_boxes`. All values outside `near` are 1, so the steps of a ray there are known.
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
    """The heights [m] at which an upright ray enters and leaves a box (2, 3) [voxels]; it leaves first if it misses.

    ray: (3,) [voxels] its place at height 0.
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
    """The value at a point, linear between voxels; 1 outside and if it is unknown."""
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


def expected_heights(cavity: Cavity) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) [m] heights of a plate from its face down, and (n, n) 0..1 the trust in each cell.

    A floor that is hidden but known to be deep is set to the cavity's depth, with half the trust. Around the cavity
    the plate is whole. An island in a partly hidden cavity may belong to a hollow that the part's image hides.
    """
    hidden = np.isnan(cavity.heights) & cavity.region
    deep = cavity.free < -HIDDEN
    heights = np.where(hidden, np.where(deep, -cavity.depth, 0.0), cavity.heights)
    heights = np.where(cavity.region, np.minimum(heights, 0), 0)
    trust = np.where(hidden, np.where(deep, HIDDEN_FLOOR_TRUST, 0.0), 1.0)
    if hidden.any():
        trust[np.asarray(binary_fill_holes(cavity.region), bool) & ~cavity.region] = ISLAND_TRUST
    return heights, trust


def cavity_heights(part: Volume, plate_from_now: Pose, pivot: np.ndarray, clearance: float) -> np.ndarray:
    """(n, n) [m] heights about a pivot of the cavity that a part would cut, 0 on the plate's face; cells of RAY_CELL.

    Args:
        part: as it lies now.
        plate_from_now: takes it into the cavity.
        pivot: (3,) [m] plate frame; only x and y count.
        clearance: [m]
    """
    about = Pose.from_translation((-pivot[0], -pivot[1], 0.0))
    envelope = lower_envelope(part, about @ plate_from_now, RAY_CELL, map_cells(part, clearance, RAY_CELL))
    return np.minimum(dilated(envelope, RAY_CELL, clearance), 0.0)


@compiled
def trace(origin, rays, heights, middle, tangent, depth):
    """Fill depth (n,) [m]: where rays (n, 3) from an origin meet a map (m, m) [m] of cells of RAY_CELL about a middle.

    tangent: tangent of half the angle by which the heights are rotated.
    """
    cells = len(heights)
    cosine = (1 - tangent * tangent) / (1 + tangent * tangent)
    sine = 2 * tangent / (1 + tangent * tangent)
    for k in range(len(rays)):
        height, before = 0.0, 0.0
        while True:
            t = (height - origin[2]) / rays[k, 2]
            x, y = origin[0] + t * rays[k, 0] - middle[0], origin[1] + t * rays[k, 1] - middle[1]
            above = height - _height_at(heights, cells, cosine * x + sine * y, cosine * y - sine * x)
            if above <= 0 or height <= -DEEPEST:
                break
            height, before = height - RAY_CELL, above
        if above < 0 and before > 0:  # between the last two steps
            t -= RAY_CELL * above / (above - before) / rays[k, 2]
        depth[k] = t


@compiled
def _height_at(heights, cells, x, y):
    """[m] height at a point of the map's frame, linear between cells; 0 beyond the map."""
    u, v = x / RAY_CELL + (cells - 1) / 2, y / RAY_CELL + (cells - 1) / 2
    if not (0 <= u < cells - 1 and 0 <= v < cells - 1):
        return 0.0
    i, j = int(u), int(v)
    a, b = u - i, v - j
    near = (1 - b) * heights[i, j] + b * heights[i, j + 1]
    far = (1 - b) * heights[i + 1, j] + b * heights[i + 1, j + 1]
    return (1 - a) * near + a * far
