"""The cavity in a plate, from a volume of the kits that is aligned with the plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, binary_opening, binary_propagation, label

from kit1000.numerics.compiled import compiled
from kit1000.perception.image_kinds import Noise
from kit1000.pose import Pose
from kit1000.voxels import Grid, Volume, surface_points
from kit1000.voxels.grid import DEFAULT_TRUNCATION

VOXEL = 1e-3  # [m] of the volumes of plates
ABOVE, BELOW = 4e-3, 24e-3  # [m] extent of the volume from the plate's face; no cavity is deeper than 20 mm
CUT = 1.5e-3  # [m] below the plate's face, where a cavity begins unless the noise is larger
RIM = 1e-3  # [m] below the rim, where points are left out: the plate's face is near them too
UNDER = 1e-3  # [m] below the floor, beyond which points are of another face: the plate's lower face is 2 mm away
JUMP = 0.5  # truncations from one voxel down to the next (2.5 mm; a level surface gives 1 mm): a hidden wall
SPECK = 12e-6  # [m^2] a smaller hole is noise
CRACK = 3  # cells across; a hole in a deeper cut must be wider, since noise opens cracks to the outside


@dataclass(frozen=True, eq=False)
class Cavity:
    """A cavity in a plate."""

    world_from_plate: Pose
    """z out of the cavity, z = 0 the plate's face, the origin in the middle of the map."""
    heights: np.ndarray
    """(n, n) [m] map of the surface from above, NaN if it is unknown; cells of VOXEL."""
    free: np.ndarray
    """(n, n) [m] height down to which a cell is free; equal to `heights` if that is known."""
    known: np.ndarray
    """(n, n) bool: cells of the plate's face and of the cavity."""
    region: np.ndarray
    """(n, n) bool: cells of the cavity."""
    depth: float
    """[m] of the floor."""
    points: np.ndarray
    """(k, 3) [m] plate frame: on the walls and the floor."""
    certain_heights: np.ndarray
    """(n, n) [m] the same without surfaces that are only assumed behind a rim."""
    certain_free: np.ndarray
    """(n, n) [m] height down to which a cell is certainly free."""


def plate_grid(world_from_plate: Pose, side: float) -> Grid:
    """The grid aligned with a plate, `side` [m] wide, the plate's origin in its middle."""
    n = round(side / VOXEL)
    layers = round((ABOVE + BELOW) / VOXEL) + 1
    first = Pose.from_translation([-(n - 1) / 2 * VOXEL, -(n - 1) / 2 * VOXEL, -BELOW])
    return Grid((n, n, layers), VOXEL, world_from_plate @ first)


def find_cavity(volume: Volume, world_from_plate: Pose, noise: Noise, deeper: float = 1.0) -> Cavity | None:
    """The cavity in the volume of a plate on its `plate_grid`; None if there is none.

    Args:
        volume: of the plate.
        world_from_plate: see `Cavity`.
        noise: of the image.
        deeper: factor on the depth of the cut, for faces that are farther from their plane than the noise says; if it
            is above 1, cracks are closed as well.
    """
    cut = deeper * max(CUT, 1.25 * noise.distance)
    heights, free = heights_from_above(volume)
    region = _region(heights, free, cut, deeper > 1)
    bottom = heights[region & (heights < -cut)]
    if len(bottom) * VOXEL**2 < SPECK:
        return None
    depth = -float(np.percentile(bottom, 3))
    face = np.abs(heights) < cut
    points = _points(volume, world_from_plate, region, depth, noise.distance)
    if np.isnan(heights[region]).any():  # the upper edge of a hidden wall is visible
        seen = face & seen_face(volume, cut)  # the far rim is that of the height map
        beyond = np.asarray(binary_propagation(region, mask=region | (face & ~seen)), bool)
        points = np.concatenate([points, _edges(seen, beyond)])
    certain_heights, certain_free = heights_from_above(volume, across_jumps=False)
    return Cavity(world_from_plate, heights, free, face | region, region, depth, points, certain_heights, certain_free)


def _points(volume: Volume, world_from_plate: Pose, region: np.ndarray, depth: float, noise: float) -> np.ndarray:
    """(k, 3) [m] plate frame: surface points of a volume in the cavity with a region (n, n) bool and a depth [m]."""
    points = world_from_plate.inverse().apply(surface_points(volume))
    i, j = cells_at(points, len(region))
    below = (points[:, 2] < -max(RIM, noise)) & (points[:, 2] > -depth - max(UNDER, noise))
    return points[np.asarray(binary_dilation(region), bool)[i, j] & below]


def holes_in(volume: Volume, noise: float, deeper: float = 1.0) -> np.ndarray:
    """(n, n) bool: the cells of all holes in the volume of a plate.

    noise: [m] largest distance of points on the plate's face from its plane. deeper: see `find_cavity`.
    """
    heights, free = heights_from_above(volume)
    return _region(heights, free, deeper * max(CUT, 1.25 * noise), deeper > 1)


def _region(heights: np.ndarray, free: np.ndarray, cut: float, closes: bool) -> np.ndarray:
    """(n, n) bool: the cells of holes deeper than a cut [m]. closes: whether cracks to the outside are closed."""
    holes = ~(heights > -cut)
    if closes:
        holes = np.asarray(binary_opening(holes, np.ones((CRACK, CRACK))), bool)
    return _enclosed(holes, free < -cut)


def _enclosed(holes: np.ndarray, deep: np.ndarray) -> np.ndarray:
    """(n, n) bool: holes that do not reach the image border and are known to be deep over more than a SPECK."""
    names, count = label(holes)  # type: ignore[misc]
    rims = np.concatenate([names[0], names[-1], names[:, 0], names[:, -1]])
    sizes = np.bincount(names.ravel(), deep.ravel(), count + 1) * VOXEL**2
    enclosed = np.flatnonzero((sizes > SPECK) & ~np.isin(np.arange(count + 1), rims))
    return np.isin(names, enclosed[enclosed > 0])


def seen_face(volume: Volume, cut: float) -> np.ndarray:
    """(n, n) bool: cells whose centre on the plate's face is seen there.

    The height map does not tell: behind a near rim a ray passes over the rim and reaches `cut` [m] only farther on.
    """
    return np.abs(volume.values[:, :, round(BELOW / VOXEL)]) < cut / (DEFAULT_TRUNCATION * VOXEL)


def _edges(face: np.ndarray, region: np.ndarray) -> np.ndarray:
    """(k, 3) [m]: midpoints between neighbouring cells of the plate's face and of the cavity, RIM below the face."""
    n = len(face)
    edges = []
    for axis in range(2):
        a, b = np.moveaxis(face, axis, 0), np.moveaxis(region, axis, 0)
        i, j = np.nonzero((a[1:] & b[:-1]) | (a[:-1] & b[1:]))
        cells = np.stack([i + 0.5, j] if axis == 0 else [j, i + 0.5], axis=1)
        edges.append((cells - (n - 1) / 2) * VOXEL)
    flat = np.concatenate(edges)
    return np.column_stack([flat, np.full(len(flat), -RIM)])


def cells_at(points: np.ndarray, n: int) -> np.ndarray:
    """(2, k) indices of the cells of points (k, 3) [m] in the plate frame, clipped to the image."""
    return np.clip(np.rint(points[:, :2] / VOXEL + (n - 1) / 2).astype(int), 0, n - 1).T


def heights_from_above(volume: Volume, across_jumps: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """(nx, ny) [m] map of the surface from above, NaN if it is unknown; (nx, ny) [m] height down to which it is free.

    across_jumps: whether a jump of the distance below the plate's face, from free to behind a surface, counts as a
    surface. Behind a near rim the image shows the rim and then the cavity, and nothing below the rim, so that a
    surface there is only assumed.
    """
    heights = np.empty((2, *volume.grid.shape[:2]))
    _descend(volume.values, VOXEL, BELOW, across_jumps, heights[0], heights[1])
    return heights[0], heights[1]


@compiled
def _descend(values, voxel, below, across_jumps, heights, free):
    nx, ny, nz = values.shape
    for i in range(nx):
        for j in range(ny):
            heights[i, j] = free[i, j] = -below
            for k in range(nz - 1, -1, -1):
                value = values[i, j, k]
                if value != value:
                    heights[i, j], free[i, j] = np.nan, (k + 1) * voxel - below
                    break
                if value < 0:
                    above = values[i, j, k + 1] if k + 1 < nz else 1.0
                    heights[i, j] = free[i, j] = (k + value / (value - above)) * voxel - below
                    if not across_jumps and above - value > JUMP and heights[i, j] < -CUT:
                        heights[i, j], free[i, j] = np.nan, (k + 1) * voxel - below
                    break
