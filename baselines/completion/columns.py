"""Solids that stand in columns under what an image shows, but for what it shows to be free."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import find_objects, label

from baselines.completion.pixels import moved
from kit1000.compiled import compiled
from kit1000.pose import Pose
from kit1000.values import View
from kit1000.voxels import Grid, Volume, tsdf
from kit1000.voxels.grid import TRUNCATION

CELLS = 2 * int(TRUNCATION)  # half a voxel wide, in a truncation


def extruded(
    view: View,
    mask: np.ndarray,
    points: np.ndarray,
    world_from_middle: Pose,
    reach: tuple[float, float],
    floor: float,
    voxel: float,
    one: bool = False,
) -> Volume:
    """Signed distances to a solid that fills the columns under points, but for what the image shows to be free.

    Args:
        view: the image.
        mask: (H, W) bool, the pixels of the thing.
        points: (n, 3) [m] world, of the thing; dense, for a column without one is free.
        world_from_middle: the middle of the volume; columns stand along its z.
        reach: [m] from the middle to every side, and up and down.
        floor: [m] along z from the middle: where columns begin.
        voxel: [m] edge.
        one: whether only the largest piece of the solid is kept: others are points that float.

    Returns:
        A volume about the middle; nowhere unknown.
    """
    side, high = (2 * round(r / voxel) for r in reach)
    fine = Grid.centred(world_from_middle, (2 * side, 2 * side, 2 * high), voxel / 2)
    seen = tsdf(fine, view, mask, threads=1).values[..., ::2]
    heights = (np.arange(0, 2 * high, 2) - (high - 0.5)) * voxel / 2
    top = _top(fine, world_from_middle.inverse(), points)
    solid = (heights <= top[..., None]) & (heights > floor) & ~(seen > 0)
    values = _distances(_largest(solid) if one else solid, seen[::2, ::2])
    return Volume.adopt(Grid((side, side, high), voxel, fine.world_from_grid), values)


def _top(grid: Grid, middle_from_world: Pose, points: np.ndarray) -> np.ndarray:
    """(nx, ny) [m]: the highest of the points about the middle of a grid in each of its columns; -inf where none is."""
    top = np.full(grid.shape[:2], -np.inf)
    _raise(points, middle_from_world.rotation_matrix(), middle_from_world.xyz, grid.voxel, top)
    return top


@compiled
def _raise(points, rotation, shift, voxel, top):
    """Raise `top` (nx, ny) to the highest of the points of each column."""
    nx, ny = top.shape
    for p in range(len(points)):
        x, y, z = moved(rotation, shift, points[p, 0], points[p, 1], points[p, 2])
        i, j = np.rint(x / voxel + (nx - 1) / 2), np.rint(y / voxel + (ny - 1) / 2)
        if 0 <= i < nx and 0 <= j < ny:
            column = np.int64(i), np.int64(j)
            top[column] = max(top[column], z)


def _largest(solid: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) bool: the largest piece of a solid."""
    names, count = label(solid)  # type: ignore[misc]
    return solid if count < 2 else names == 1 + np.bincount(names[solid])[1:].argmax()


def _distances(solid: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Distance / truncation to the surface of a solid; nearer where a surface was seen nearer.

    Args:
        solid: (2 nx, 2 ny, nz) bool, in cells that are half a voxel wide and a voxel high.
        seen: (nx, ny, nz) what was seen in every second cell, in truncations of half a voxel.

    Returns:
        (nx, ny, nz) float32, of every second cell.
    """
    outside, inside = _squares(solid), _squares(~solid)
    held = solid[::2, ::2]
    away = np.maximum(np.sqrt(np.where(held, inside, outside)) - 0.25, 0) / TRUNCATION
    near = _box(solid)
    away[near] = np.fmin(away[near], np.abs(seen[near]) / 2)  # of half a voxel, so is its truncation
    return np.where(held, -away, away).clip(-1, 1).astype(np.float32)


def _box(solid: np.ndarray) -> tuple[slice, ...]:
    """Of every second cell, those that a solid may have within a truncation, in a box."""
    held = find_objects(solid.astype(np.uint8))
    if not held:
        return (slice(0),) * 3
    reach, step = (CELLS + 1, CELLS + 1, CELLS // 2 + 1), (2, 2, 1)
    sides = zip(held[0], reach, step, strict=True)
    return tuple(slice(max(-((r - side.start) // s), 0), (side.stop - 1 + r) // s + 1) for side, r, s in sides)


@compiled
def _squares(solid):
    """(nx, ny, nz) [voxels^2]: from every second cell to the nearest of a solid; exact as far as a truncation goes.

    Axis after axis: the least over a row of cells is that of the least over the rows beside it (Saito and Toriwaki).
    """
    nx, ny, nz = solid.shape
    up = np.full((nx, ny, nz), np.inf)
    for i in range(nx):
        for j in range(ny):
            below = np.inf
            for k in range(nz):
                below = 0.0 if solid[i, j, k] else below + 1
                up[i, j, k] = below
            above = np.inf
            for k in range(nz - 1, -1, -1):
                above = 0.0 if solid[i, j, k] else above + 1
                up[i, j, k] = min(up[i, j, k], above) ** 2
    across = np.full((nx, (ny + 1) // 2, nz), np.inf)
    for i in range(nx):
        for j in range(0, ny, 2):
            for other in range(max(j - CELLS, 0), min(j + CELLS + 1, ny)):
                for k in range(nz):
                    across[i, j // 2, k] = min(across[i, j // 2, k], up[i, other, k] + (other - j) ** 2 / 4)
    squares = np.full(((nx + 1) // 2, (ny + 1) // 2, nz), np.inf)
    for i in range(0, nx, 2):
        for other in range(max(i - CELLS, 0), min(i + CELLS + 1, nx)):
            for j in range(across.shape[1]):
                for k in range(nz):
                    squares[i // 2, j, k] = min(squares[i // 2, j, k], across[other, j, k] + (other - i) ** 2 / 4)
    return squares
