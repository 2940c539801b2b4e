"""Sweeps: what a part sweeps on its way out of a cavity in one rotation, as distances in horizontal slices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.registration.geometry.height_maps import dilated, lower_envelope, map_cells
from kit1000.voxels import Volume

CELL = 0.625e-3  # [m] of slices
LAYER = 1e-3  # [m] between slices
REACH = 12  # cells (7.5 mm) up to which distances are computed, at least
BEYOND = 2e-3  # [m] beyond the clearance, up to which distances are computed: residuals are clipped there
ABOVE = 3e-3  # [m] of slices beyond the depth of the cavity: the part may be refined upwards
NO_FLOOR = 0.1  # [m] floor of a cell without part: above everything


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a part sweeps on its way up, in one rotation, from its lowest point on; its pivot is the origin."""

    rotation: Pose
    """plate_from_now, a rotation alone."""
    distance: np.ndarray
    """(layers, n, n) float32 [m]: horizontal distance from each cell to the sweep at the layer's height; 0 inside."""
    floor: np.ndarray
    """(n, n) float32 [m]: lower envelope of the dilated part; NO_FLOOR in a cell without part."""
    lowest: float
    """[m] of the sweep, relative to the pivot."""

    @classmethod
    def from_envelope(
        cls, envelope: np.ndarray, rotation: Pose, lowest: float, depth: float, clearance: float
    ) -> Sweep:
        """The sweep above a lower envelope (n, n) [m], in slices from `lowest` to a little above `depth` [m]."""
        layers = int(np.ceil((depth + ABOVE) / LAYER)) + 1
        reach = max(REACH, int(np.ceil((clearance + BEYOND) / CELL)))
        distance = np.full((layers, *envelope.shape), (reach - 0.5) * CELL, np.float32)
        rows, columns = (_near(np.any(np.isfinite(envelope), axis=axis), reach) for axis in (1, 0))
        near = np.empty((layers, rows.stop - rows.start, columns.stop - columns.start), np.float32)
        _horizontal_distances(envelope[rows, columns] - lowest, LAYER, CELL, reach, near)
        distance[:, rows, columns] = near
        floor = dilated(envelope, CELL, clearance)
        return cls(rotation, distance, np.where(np.isfinite(floor), floor, NO_FLOOR).astype(np.float32), lowest)


def envelope_about(
    part: Volume, pivot: np.ndarray, rotation: Pose, clearance: float, start: np.ndarray | None = None
) -> np.ndarray:
    """(n, n) [m]: the lower envelope of a part in a rotation, its pivot (3,) [m] the origin.

    Args:
        part: a volume with the pivot about in its middle.
        pivot: of the part.
        rotation: of the part.
        clearance: [m] by which the map is wider than the part.
        start: see `lower_envelope`.
    """
    cells = map_cells(part, clearance, CELL)
    return lower_envelope(part, rotation @ Pose.from_translation(-pivot), CELL, cells, start)


def _near(filled: np.ndarray, reach: int) -> slice:
    """The cells of a row (n,) bool that are within a reach of filled ones."""
    at = np.flatnonzero(filled)
    return slice(max(at[0] - reach, 0), min(at[-1] + reach + 1, len(filled))) if len(at) else slice(0, 0)


@compiled
def _horizontal_distances(heights, layer, cell, reach, distance):
    """Fill distance (layers, m, n): from each cell to the nearest whose envelope is at or below the layer.

    Exact up to `reach` cells, and that beyond. Half a cell less: the edge runs between a cell inside and the next.
    """
    layers, m, n = distance.shape
    along, least = np.empty((m, n), np.int32), np.empty(n, np.int32)  # squares of whole cells: integers are exact
    for k in range(layers):
        for i in range(m):
            gap = reach
            for j in range(n):
                gap = 0 if heights[i, j] <= k * layer + 1e-9 else min(gap + 1, reach)
                along[i, j] = gap
            gap = reach
            for j in range(n - 1, -1, -1):
                gap = 0 if heights[i, j] <= k * layer + 1e-9 else min(gap + 1, reach)
                along[i, j] = min(along[i, j], gap) ** 2
        for i in range(m):
            least[:] = reach**2
            for other in range(max(i - reach, 0), min(i + reach + 1, m)):
                across = np.int32((other - i) ** 2)
                for j in range(n):  # innermost: neighbours in memory
                    least[j] = min(least[j], along[other, j] + across)
            for j in range(n):
                distance[k, i, j] = max(np.sqrt(least[j]) - 0.5, 0.0) * cell


@compiled
def rotation_matrix(twist):
    """(3, 3) rotation matrix of the first three numbers, a Rodrigues vector."""
    x, y, z = twist[0] / 2, twist[1] / 2, twist[2] / 2
    t = 2 / (1 + x * x + y * y + z * z)
    return np.array(
        [
            [1 - t * (y * y + z * z), t * (x * y - z), t * (x * z + y)],
            [t * (x * y + z), 1 - t * (x * x + z * z), t * (y * z - x)],
            [t * (x * z - y), t * (y * z + x), 1 - t * (x * x + y * y)],
        ]
    )


@compiled
def rotation_matrices(twists):
    """(m, 3, 3) those of twists (m, 6)."""
    matrices = np.empty((len(twists), 3, 3))
    for t in range(len(twists)):
        matrices[t] = rotation_matrix(twists[t])
    return matrices


@compiled
def in_sweep(point, twist, r):
    """The point in the frame of the sweep."""
    dx, dy, dz = point[0] - twist[3], point[1] - twist[4], point[2] - twist[5]
    x = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
    y = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
    z = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
    return x, y, z


@compiled
def floors_under(points, twist, floor):
    """(n,) [m]: the floor at the cell of each point."""
    n = floor.shape[0]
    r = rotation_matrix(twist)
    out = np.empty(len(points))
    for p in range(len(points)):
        x, y, _ = in_sweep(points[p], twist, r)
        u, v = x / CELL + (n - 1) / 2, y / CELL + (n - 1) / 2
        out[p] = floor[int(min(max(u + 0.5, 0.0), n - 1.0)), int(min(max(v + 0.5, 0.0), n - 1.0))]
    return out


@compiled
def cell_at(x, y, above, shape):
    """Fractional cell (u, v) and layer w of a point of a sweep, `above` [m] its lowest point; clipped to the volume."""
    layers, n, _ = shape
    u = min(max(x / CELL + (n - 1) / 2, 0.0), n - 1.001)
    v = min(max(y / CELL + (n - 1) / 2, 0.0), n - 1.001)
    return u, v, min(max(above / LAYER, 0.0), layers - 1.001)


@compiled
def nearer(a, b):
    """The signed distance of the nearer of two surfaces; the second if both are as near."""
    return a if abs(a) < abs(b) else b


@compiled
def distance_at(distance, u, v, w):
    """A distance (layers, n, n) at cell (u, v) of layer w, linear between them."""
    i, j, k = int(u), int(v), int(w)
    a, b, c = u - i, v - j, w - k
    below = (1 - a) * ((1 - b) * distance[k, i, j] + b * distance[k, i, j + 1])
    below += a * ((1 - b) * distance[k, i + 1, j] + b * distance[k, i + 1, j + 1])
    above = (1 - a) * ((1 - b) * distance[k + 1, i, j] + b * distance[k + 1, i, j + 1])
    above += a * ((1 - b) * distance[k + 1, i + 1, j] + b * distance[k + 1, i + 1, j + 1])
    return (1 - c) * below + c * above
