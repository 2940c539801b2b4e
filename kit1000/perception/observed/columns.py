"""Solids that fill the columns below observed points, except for what images show to be free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import find_objects, label

from kit1000.numerics.compiled import compiled
from kit1000.perception.observed.pixels import transformed
from kit1000.pose import Pose
from kit1000.values import LabelledDepth, View
from kit1000.voxels import Grid, Volume, tsdf
from kit1000.voxels.grid import DEFAULT_TRUNCATION

CELLS = 2 * int(DEFAULT_TRUNCATION)  # half a voxel wide, in a truncation
STEP = (2, 2, 1)  # cells from voxel to voxel
SKIN = 0.5e-3  # [m] behind an observed surface that is solid, whatever a network says
SURE = 1.5e-3  # [m] behind an observed surface that is surely solid: no wall of a part is thinner than 2 mm


class MaskedView(NamedTuple):
    """A depth image and the pixels of an object."""

    view: View
    mask: np.ndarray
    """(H, W) bool"""

    @classmethod
    def of(cls, image: LabelledDepth, label: int) -> MaskedView:
        """The pixels of a label."""
        return cls(image.view, image.labels == label)


def observed_distance(grid: Grid, images: Sequence[MaskedView]) -> Volume:
    """The projective truncated signed distance of the voxels of a grid, NaN where no image knows it.

    Free is what any image shows to be free: the distance is then the least of those that do. Behind all surfaces the
    nearest one counts. A mean would fill space that is seen from the side.
    """
    first, *others = (tsdf(grid, image.view, image.mask, threads=1) for image in images)
    if not others:
        return first
    values = first.values.copy()
    for other in others:
        both = np.where(
            (values > 0) & (other.values > 0), np.minimum(values, other.values), np.fmax(values, other.values)
        )
        values = np.where(np.isnan(values), other.values, np.where(np.isnan(other.values), values, both))
    return Volume.adopt(grid, values)


@dataclass(frozen=True, eq=False)
class ObservedColumns:
    """What depth images show of an object, in cells that are half a voxel wide and a voxel high."""

    grid: Grid
    """Grid of the volumes: every second cell along x and y."""
    fine: Grid
    """Grid of half a voxel: its every second layer has the cells."""
    distance: np.ndarray
    """(2 nx, 2 ny, nz) observed distance, in truncations of half a voxel; positive is free, NaN unknown."""
    below_top: np.ndarray
    """(2 nx, 2 ny, nz) bool: not above the highest point of the column."""
    above_floor: np.ndarray
    """(nz,) bool"""

    @classmethod
    def of(
        cls,
        images: Sequence[MaskedView],
        points: np.ndarray,
        world_from_middle: Pose,
        half_sizes: tuple[float, float],
        floor: float,
        voxel: float,
    ) -> ObservedColumns:
        """What one image or several show in the columns about a middle.

        Args:
            images: of the object.
            points: (n, 3) [m] world, on the object; dense, as a column without one is free.
            world_from_middle: the middle of the volumes; columns run along its z axis.
            half_sizes: [m] from the middle to the sides, and to top and bottom.
            floor: [m] along z from the middle: the lower end of columns.
            voxel: [m] edge.
        """
        side, height = (2 * round(half / voxel) for half in half_sizes)
        fine = Grid.centred(world_from_middle, (2 * side, 2 * side, 2 * height), voxel / 2)
        observed = observed_distance(fine, images).values[..., ::2]
        heights = (np.arange(0, 2 * height, 2) - (height - 0.5)) * voxel / 2
        top = _top(fine, world_from_middle.inverse(), points)
        grid = Grid((side, side, height), voxel, fine.world_from_grid)
        return cls(grid, fine, observed, heights <= top[..., None], heights > floor)

    def filled(self, largest_only: bool, more: np.ndarray | None = None) -> Volume:
        """Signed distances to the columns below the points, except for free space; no voxel is unknown.

        Args:
            largest_only: whether only the largest connected piece is kept; the others are outliers.
            more: (2 nx, 2 ny, nz) bool, cells that are filled too where they are not seen free.
        """
        solid = self.filled_cells(more)
        return self._volume(_largest(solid) if largest_only else solid, self.distance)

    def filled_cells(self, more: np.ndarray | None = None) -> np.ndarray:
        """(2 nx, 2 ny, nz) bool: the cells below the points, except for free space; more: see `filled`."""
        below = self.below_top if more is None else self.below_top | more
        return below & self.above_floor & ~(self.distance > 0)

    def completed(self, likely: np.ndarray, exact: bool) -> Volume:
        """Signed distances to the cells (2 nx, 2 ny, nz) bool that are likely filled, above the floor.

        exact: whether the observed distance is; then what it shows to be free is, and its surfaces are those of the
        solid.
        """
        if not exact:
            return self._volume(_largest(likely & self.above_floor), np.full_like(self.distance, np.nan))
        thin = (self.distance <= 0) & (self.distance > -SKIN / (DEFAULT_TRUNCATION * self.grid.voxel_size / 2))
        solid = (likely | thin) & ~(self.distance > 0) & self.above_floor
        return self._volume(_largest(solid), self._near())

    def sure(self) -> Volume:
        """Signed distances to what lies at most SURE behind an observed surface."""
        behind = -SURE / (DEFAULT_TRUNCATION * self.grid.voxel_size / 2)
        return self._volume((self.distance <= 0) & (self.distance > behind) & self.above_floor, self._near())

    def possible(self) -> Volume:
        """Signed distances to all that is not surely free: what the image does not show to be, above the floor."""
        return self._volume(~(self.distance > 0) & self.above_floor, self._near())

    def _near(self) -> np.ndarray:
        """The observed distance within its truncation; beyond, it limits no other."""
        return np.where(np.abs(self.distance) < 1, self.distance, np.float32(np.nan))

    def _volume(self, solid: np.ndarray, distance: np.ndarray) -> Volume:
        return Volume.adopt(self.grid, _distances(solid, distance[::2, ::2]))


def _top(grid: Grid, middle_from_world: Pose, points: np.ndarray) -> np.ndarray:
    """(nx, ny) [m]: height of the highest point in each column of a grid, from its middle; -inf without points."""
    top = np.full(grid.shape[:2], -np.inf)
    _raise(points, middle_from_world.rotation_matrix(), middle_from_world.xyz, grid.voxel_size, top)
    return top


@compiled
def _raise(points, rotation, shift, voxel, top):
    """Raise `top` (nx, ny) to the highest point in each column."""
    nx, ny = top.shape
    for p in range(len(points)):
        x, y, z = transformed(rotation, shift, points[p, 0], points[p, 1], points[p, 2])
        i, j = np.rint(x / voxel + (nx - 1) / 2), np.rint(y / voxel + (ny - 1) / 2)
        if 0 <= i < nx and 0 <= j < ny:
            column = np.int64(i), np.int64(j)
            top[column] = max(top[column], z)


def _largest(solid: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) bool: the largest connected piece of a solid."""
    names, count = label(solid)  # type: ignore[misc]
    return solid if count < 2 else names == 1 + np.bincount(names[solid])[1:].argmax()


def _distances(solid: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """Signed distance / truncation to the surface of a solid, or to the observed surface where that is nearer.

    Args:
        solid: (2 nx, 2 ny, nz) bool, in cells that are half a voxel wide and a voxel high.
        observed: (nx, ny, nz) observed distance in every second cell, in truncations of half a voxel.

    Returns:
        (nx, ny, nz) float32, of every second cell.
    """
    near = _box(solid)
    fine = tuple(slice(side.start * step, side.stop * step) for side, step in zip(near, STEP, strict=True))
    outside, inside = _squares(solid[fine]), _squares(~solid[fine])
    inner = solid[fine][::2, ::2]
    distance = np.maximum(np.sqrt(np.where(inner, inside, outside)) - 0.25, 0) / DEFAULT_TRUNCATION
    distance = np.fmin(distance, np.abs(observed[near]) / 2)  # its truncation is half as long
    values = np.ones(observed.shape, np.float32)
    values[near] = np.where(inner, -distance, distance).clip(-1, 1)
    return values


def _box(solid: np.ndarray) -> tuple[slice, ...]:
    """The box of every second cell outside of which no cell has the solid within a truncation."""
    boxes = find_objects(solid.astype(np.uint8))
    if not boxes:
        return (slice(0, 0),) * 3
    reach = (CELLS + 1, CELLS + 1, CELLS // 2 + 1)
    sides = zip(boxes[0], reach, STEP, solid.shape, strict=True)
    return tuple(
        slice(max(-((r - side.start) // s), 0), min((side.stop - 1 + r) // s + 1, n // s)) for side, r, s, n in sides
    )


@compiled
def _squares(solid):
    """(nx, ny, nz) [voxels^2]: squared distance from every second cell to a solid; exact within a truncation.

    One axis at a time (Saito and Toriwaki 1994).
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
