"""Projective truncated signed distance (TSDF) from one depth image.

A voxel at depth z whose pixel has depth d gets the value (d - z) / truncation, at most 1. More than the truncation
behind the surface it is unknown; such voxels are never filled as solid.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from kit1000.errors import InputError, checked
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import matmul
from kit1000.values import View
from kit1000.voxels.grid import Grid, Volume, for_each_slab, truncation_voxels

MIN_DEPTH = 1e-6  # [m] of a voxel in front of the camera; others have no pixel


def tsdf(
    grid: Grid,
    view: View,
    mask: ArrayLike | None = None,
    truncation: float | None = None,
    threads: int | None = None,
) -> Volume:
    """The truncated signed distance of the voxels of a grid from one depth image.

    The pixel of a voxel is the one whose centre is nearest to its projection. Unknown (NaN) are voxels outside the
    image, behind the camera, on pixels without return, and more than the truncation behind the depth of their pixel.

    Args:
        grid: the voxels to compute.
        view: the depth image.
        mask: (H, W) bool, the pixels of the object. The ray of a pixel outside the mask passes the object, so its
            voxels are free (1) up to the depth of the pixel and unknown beyond.
        truncation: [m] along the optical axis; five voxels by default.
        threads: number of threads; all cores by default. The result does not depend on it.
    """
    limit = truncation_voxels(grid, truncation) * grid.voxel_size
    image = _signed_depth(view, mask)
    values = np.empty(grid.shape, np.float32)
    across, down, forward = _projection(grid, view)

    def fill(start: int, stop: int) -> None:
        _fill_slab(start, stop, across, down, forward, image, 1 / limit, values)

    for_each_slab(fill, grid.shape, threads)
    return Volume.adopt(grid, values)


def _signed_depth(view: View, mask: ArrayLike | None) -> np.ndarray:
    """(H, W) float32 [m]: the depth, negated outside the mask, 0 without return."""
    if view.depth.size and view.depth.min() < 0:
        raise InputError(f"depth: expected 0 (no return) or more, got {view.depth.min()} m")
    if mask is None:
        return view.depth
    signed = np.empty(view.depth.shape, np.float32)
    _negate_outside(view.depth, checked("mask", mask, view.depth.shape, np.bool_), signed)
    signed.setflags(write=False)
    return signed


def _projection(grid: Grid, view: View) -> np.ndarray:
    """(3, 4) matrix from the voxel index (i, j, k, 1) to (u + 1/2) z and (v + 1/2) z [pixels m], and z [m]."""
    camera = view.camera
    camera_from_grid = view.world_from_camera.inverse() @ grid.world_from_grid
    point_from_index = np.column_stack([camera_from_grid.rotation_matrix() * grid.voxel_size, camera_from_grid.xyz])
    pixel_from_point = np.array([[camera.fx, 0, camera.cx + 0.5], [0, camera.fy, camera.cy + 0.5], [0, 0, 1]])
    return matmul(pixel_from_point, point_from_index)


@compiled
def _negate_outside(depth, mask, signed):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            signed[v, u] = depth[v, u] if mask[v, u] else -depth[v, u]


@compiled
def _fill_slab(start, stop, across, down, forward, image, per_reach, values):
    """Write values[start:stop]; `across`, `down`, `forward` (4,) are the rows of `_projection`."""
    height, width = image.shape
    pixels = image.reshape(-1)
    ny, nz = values.shape[1:]
    steps = np.arange(nz).astype(np.float64)
    index, depths = np.empty(nz, np.uint32), np.empty(nz, np.float32)
    for i in range(start, stop):
        for j in range(ny):
            x = across[0] * i + across[1] * j + across[3]
            y = down[0] * i + down[1] * j + down[3]
            z = forward[0] * i + forward[1] * j + forward[3]
            first, last = _clip_range(z - MIN_DEPTH, forward[2], 0, nz)
            first, last = _clip_range(x, across[2], first, last)
            first, last = _clip_range(width * z - x, width * forward[2] - across[2], first, last)
            first, last = _clip_range(y, down[2], first, last)
            first, last = _clip_range(height * z - y, height * forward[2] - down[2], first, last)
            values[i, j, :first] = np.nan
            values[i, j, last:] = np.nan
            _find_pixels(steps[first:last], x, y, z, across[2], down[2], forward[2], width, height, index)
            for n in range(last - first):
                depths[n] = pixels[index[n]]
            _compare_depths(steps[first:last], z, forward[2], depths, per_reach, values[i, j, first:last])


@compiled
def _find_pixels(steps, x, y, z, x1, y1, z1, width, height, index):
    """Write the flat index of the pixel of each voxel of a row, in a (height, width) image."""
    right, bottom = np.int32(width - 1), np.int32(height - 1)
    for n in range(steps.shape[0]):
        inverse = 1 / (z + z1 * steps[n])
        u = np.int32((x + x1 * steps[n]) * inverse)
        v = np.int32((y + y1 * steps[n]) * inverse)
        index[n] = min(max(v, np.int32(0)), bottom) * width + min(max(u, np.int32(0)), right)


@compiled
def _compare_depths(steps, z, z1, depths, per_reach, row):
    """Write the values of a row of voxels from the signed depths of their pixels."""
    one, nan = np.float32(1), np.float32(np.nan)
    for n in range(steps.shape[0]):
        surface, depth = depths[n], z + z1 * steps[n]
        value = np.float32((surface - depth) * per_reach)
        inside = nan if value < -one else min(value, one)
        outside = one if depth <= -surface else nan
        row[n] = inside if surface > 0 else outside


@compiled
def _clip_range(base, slope, first, last):
    """Narrow the range first .. last - 1 of k to base + slope k >= 0."""
    if slope == 0 or base + slope * first >= 0 <= base + slope * (last - 1):
        return (first, last) if base + slope * first >= 0 else (first, first)
    edge = -base / slope
    if slope > 0:
        first = max(first, int(np.ceil(min(max(edge, first), last))))
    else:
        last = min(last, int(np.floor(min(max(edge, first - 1.0), last))) + 1)
    return first, max(first, last)
