"""Interpolation of volumes: resampling on another grid, and points on the surface."""

from __future__ import annotations

import numpy as np

from kit1000.numerics.compiled import compiled
from kit1000.voxels.grid import Grid, Volume, for_each_slab

SNAP_TOLERANCE = 1e-6  # [voxels] within which a point counts as a voxel's centre: rounding then needs no neighbour
MAX_STEP = 1.0  # neighbours whose values differ by more are at the border of the observed region


def resample(volume: Volume, grid: Grid, threads: int | None = None) -> Volume:
    """The volume at the voxels of another grid, by trilinear interpolation.

    Unknown where any voxel with a positive weight is unknown or outside. Values keep their scale (they are divided by
    the truncation they were made with), and a coarser grid gets no smoothing.
    """
    source_from_grid = volume.grid.world_from_grid.inverse() @ grid.world_from_grid
    linear = source_from_grid.rotation_matrix() * (grid.voxel_size / volume.grid.voxel_size)
    origin = source_from_grid.xyz / volume.grid.voxel_size
    values = np.empty(grid.shape, np.float32)

    def read(start: int, stop: int) -> None:
        _interpolate(start, stop, linear, origin, volume.values, values)

    for_each_slab(read, grid.shape, threads)
    return Volume.adopt(grid, values)


def surface_points(volume: Volume) -> np.ndarray:
    """(n, 3) float64 [m], world: zero crossings between neighbouring voxels, both known.

    Along x first, then y, then z, each in the order of the voxels. Neighbours whose values differ by more than
    MAX_STEP are omitted: there the observed region ends, and no surface was observed.
    """
    ends = np.zeros(4, np.int64)
    _find_crossings(volume.values, ends, np.empty((0, 3)))
    indices = np.empty((int(ends[3]), 3))
    _find_crossings(volume.values, np.concatenate([[0], ends[:3].cumsum()]), indices)
    return volume.grid.world(indices)


@compiled
def _interpolate(start, stop, linear, origin, source, values):
    size = source.shape
    place, low = np.empty(3), np.empty(3, np.int64)
    share = np.empty(3)
    for i in range(start, stop):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                inside = True
                for axis in range(3):
                    place[axis] = linear[axis, 0] * i + linear[axis, 1] * j + linear[axis, 2] * k + origin[axis]
                    near = np.round(place[axis])
                    if abs(place[axis] - near) < SNAP_TOLERANCE:
                        place[axis] = near
                    inside &= 0 <= place[axis] <= size[axis] - 1
                if not inside:
                    values[i, j, k] = np.nan
                    continue
                for axis in range(3):
                    low[axis] = np.int64(place[axis])
                    share[axis] = place[axis] - low[axis]
                total = 0.0
                for corner in range(8):
                    x, y, z = corner & 1, corner >> 1 & 1, corner >> 2
                    weight = share[0] if x else 1 - share[0]
                    weight *= share[1] if y else 1 - share[1]
                    weight *= share[2] if z else 1 - share[2]
                    if weight > 0:
                        total += weight * source[low[0] + x, low[1] + y, low[2] + z]
                values[i, j, k] = min(max(total, -1.0), 1.0) if total == total else np.nan


@compiled
def _find_crossings(values, ends, indices):
    """Count the zero crossings per axis and in total in `ends` (4,); write them from there on if `indices` has rows."""
    nx, ny, nz = values.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                here = values[i, j, k]
                for axis in range(3):
                    x, y, z = i + (axis == 0), j + (axis == 1), k + (axis == 2)
                    if x == nx or y == ny or z == nz:
                        continue
                    there = values[x, y, z]
                    if (here < 0) == (there < 0) or not abs(here - there) <= MAX_STEP:
                        continue
                    if indices.shape[0]:
                        at = ends[axis]
                        indices[at, 0], indices[at, 1], indices[at, 2] = i, j, k
                        indices[at, axis] += np.float64(here) / (np.float64(here) - np.float64(there))
                    ends[axis] += 1
    ends[3] = ends[0] + ends[1] + ends[2]
