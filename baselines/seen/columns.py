"""Solids that stand in columns under what an image shows, but for what it shows to be free."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from kit1000.pose import Pose
from kit1000.values import View
from kit1000.voxels import Grid, Volume, tsdf
from kit1000.voxels.grid import TRUNCATION


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
    top = _top(fine, world_from_middle.inverse().apply(points))
    solid = (heights <= top[..., None]) & (heights > floor) & ~(seen > 0)
    values = _distances(_largest(solid) if one else solid, seen)
    return Volume.adopt(Grid((side, side, high), voxel, fine.world_from_grid), values[::2, ::2])


def _top(grid: Grid, points: np.ndarray) -> np.ndarray:
    """(nx, ny) [m]: the highest of the points about the middle of a grid in each of its columns; -inf where none is."""
    i, j = np.rint(points[:, :2] / grid.voxel + (np.array(grid.shape[:2]) - 1) / 2).astype(int).T
    inside = (i >= 0) & (j >= 0) & (i < grid.shape[0]) & (j < grid.shape[1])
    top = np.full(grid.shape[:2], -np.inf)
    np.maximum.at(top, (i[inside], j[inside]), points[inside, 2])
    return top


def _largest(solid: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) bool: the largest piece of a solid."""
    names, count = label(solid)  # type: ignore[misc]
    return solid if count < 2 else names == 1 + np.bincount(names[solid])[1:].argmax()


def _distances(solid: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) float32: distance / truncation to the surface of a solid; nearer where a surface was seen nearer.

    Cells are half a voxel wide and a voxel high.
    """
    values = np.ones(solid.shape, np.float32)
    held = np.nonzero(solid)
    if len(held[0]) == 0:
        return values
    margins = (2 * int(TRUNCATION) + 1, 2 * int(TRUNCATION) + 1, int(TRUNCATION) + 1)
    box = tuple(slice(max(i.min() - m, 0), i.max() + m + 1) for i, m in zip(held, margins, strict=True))
    solid, seen = solid[box], seen[box]
    outside, inside = (np.asarray(distance_transform_edt(place, (0.5, 0.5, 1.0))) for place in (~solid, solid))
    away = np.maximum(np.where(solid, inside, outside) - 0.25, 0) / TRUNCATION
    away = np.fmin(away, np.abs(seen) / 2)  # of half a voxel, so is its truncation
    values[box] = np.where(solid, -away, away).clip(-1, 1)
    return values
