"""Posed grids of cubic voxels, and volumes of truncated signed distance on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kit1000.errors import InputError, ShapeError, checked
from kit1000.parallel import thread_map, usable_cores
from kit1000.pose import Pose

MAX_VOXELS = 1 << 31  # 8 GiB of float32: with more, the voxel size is probably in the wrong unit
DEFAULT_TRUNCATION = 5.0  # [voxels] that of the paper
SLAB_VOXELS = 1 << 17  # half a megabyte of float32: fits the cache of a core, and gives enough slabs for all threads


@dataclass(frozen=True, eq=False)
class Grid:
    """A box of cubic voxels at a pose in the world."""

    shape: tuple[int, int, int]
    """Number of voxels (nx, ny, nz)."""
    voxel_size: float
    """Distance between the centres of neighbours [m]."""
    world_from_grid: Pose
    """The centre of voxel (i, j, k) is at world_from_grid.apply((i, j, k) * voxel_size)."""

    def __post_init__(self) -> None:
        shape = tuple(checked("shape", self.shape, (3,), np.int64).tolist())
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "voxel_size", float(checked("voxel_size", self.voxel_size, ())))
        if min(shape) < 1 or math.prod(shape) > MAX_VOXELS:
            raise ShapeError(f"shape: expected 1 voxel or more an axis and at most 2^31 in all, got {shape}")
        if self.voxel_size <= 0:
            raise InputError(f"voxel_size: expected an edge above 0 m, got {self.voxel_size}")
        if not isinstance(self.world_from_grid, Pose) or self.world_from_grid.batch_shape != ():
            raise ShapeError("world_from_grid: expected one pose")

    @classmethod
    def centred(cls, world_from_centre: Pose, shape: tuple[int, int, int], voxel_size: float) -> Grid:
        """The grid whose centre, halfway between its first and last voxel, is at a pose."""
        grid = cls(shape, voxel_size, world_from_centre)
        first = -(np.array(grid.shape) - 1) / 2 * grid.voxel_size
        return cls(grid.shape, grid.voxel_size, world_from_centre @ Pose.from_translation(first))

    def world(self, indices: ArrayLike) -> np.ndarray:
        """Points (..., 3) [m] in the world at (fractional) voxel indices (..., 3)."""
        return self.world_from_grid.apply(np.asarray(indices, dtype=np.float64) * self.voxel_size)

    def indices(self, points: ArrayLike) -> np.ndarray:
        """Fractional voxel indices (..., 3) of points (..., 3) [m] in the world, inside the grid or not."""
        return self.world_from_grid.inverse().apply(points) / self.voxel_size

    def centres(self) -> np.ndarray:
        """(nx, ny, nz, 3) [m]: the centre of every voxel in the world."""
        return self.world(np.moveaxis(np.indices(self.shape), 0, -1))

    def crop(self, start: tuple[int, int, int], shape: tuple[int, int, int]) -> Grid:
        """The grid of `shape` whose voxel (0, 0, 0) is voxel `start` of this one; it may extend outside."""
        first = checked("start", start, (3,), np.int64)
        return Grid(shape, self.voxel_size, self.world_from_grid @ Pose.from_translation(first * self.voxel_size))

    def moved(self, pose: Pose) -> Grid:
        """The grid moved in the world by a pose."""
        return Grid(self.shape, self.voxel_size, pose @ self.world_from_grid)

    def __eq__(self, other: object) -> bool:
        """Whether the grids have the same voxels, bit for bit."""
        return isinstance(other, Grid) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        pose = self.world_from_grid
        return (self.shape, self.voxel_size, *pose.wxyz.tolist(), *pose.xyz.tolist())


@dataclass(frozen=True, eq=False)
class Volume:
    """Truncated signed distance at the voxels of a grid."""

    grid: Grid
    values: np.ndarray
    """(nx, ny, nz) float32, read-only: distance / truncation in -1 .. 1, negative inside, NaN unknown."""

    def __post_init__(self) -> None:
        try:
            source = np.asarray(self.values)
            values = source.astype(np.float32) if source.dtype.kind in "biuf" else None
        except ValueError:
            values = None
        expected = f"values: expected float32 of shape {self.grid.shape}, each -1 to 1 or NaN"
        if values is None or values.shape != self.grid.shape:
            raise ShapeError(f"{expected}, got {np.shape(self.values) if values is not None else 'something else'}")
        beyond = np.abs(values) > 1
        if beyond.any():
            at = tuple(int(i) for i in np.argwhere(beyond)[0])
            raise ShapeError(f"{expected}, got {values[at]} at {at}")
        object.__setattr__(self, "values", _read_only(values))

    @classmethod
    def adopt(cls, grid: Grid, values: np.ndarray) -> Volume:
        """A volume with an array (nx, ny, nz) float32 of this package, neither copied nor checked."""
        volume = object.__new__(cls)
        object.__setattr__(volume, "grid", grid)
        object.__setattr__(volume, "values", _read_only(values))
        return volume

    @property
    def known(self) -> np.ndarray:
        """(nx, ny, nz) bool: voxels with a known distance."""
        return ~np.isnan(self.values)

    @property
    def occupied(self) -> np.ndarray:
        """(nx, ny, nz) bool: voxels known to be inside."""
        return self.values < 0

    def filled(self, value: float) -> np.ndarray:
        """(nx, ny, nz) float32, writable: the values, with `value` for unknown voxels (for networks)."""
        return np.where(np.isnan(self.values), np.float32(value), self.values)


def crop(volume: Volume, start: tuple[int, int, int], shape: tuple[int, int, int]) -> Volume:
    """The box of `shape` voxels from voxel `start`; unknown where it extends outside the volume."""
    grid = volume.grid.crop(start, shape)
    low = np.array(start, dtype=np.int64)
    first = np.clip(low, 0, volume.grid.shape)
    last = np.maximum(np.clip(low + grid.shape, 0, volume.grid.shape), first)
    values = np.full(grid.shape, np.nan, np.float32)
    values[_slices(first - low, last - low)] = volume.values[_slices(first, last)]
    return Volume.adopt(grid, values)


def truncation_voxels(grid: Grid, truncation: float | None) -> float:
    """A truncation [m] in voxels, after a check; None gives DEFAULT_TRUNCATION."""
    if truncation is None:
        return DEFAULT_TRUNCATION
    distance = float(checked("truncation", truncation, ()))
    if distance <= 0:
        raise InputError(f"truncation: expected a distance above 0 m, got {distance}")
    return distance / grid.voxel_size


def _slices(first: np.ndarray, last: np.ndarray) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))


def _read_only(values: np.ndarray) -> np.ndarray:
    values.setflags(write=False)
    return values


def for_each_slab(work: Callable[[int, int], None], shape: tuple[int, int, int], threads: int | None) -> None:
    """Call work(start, stop) in threads, for ranges that cover the first axis; compiled loops run side by side.

    The ranges, and so the results, do not depend on the number of threads; None: all available cores.
    """
    if threads is not None and not (isinstance(threads, int) and threads >= 1):
        raise InputError(f"threads: expected a whole number from 1 up, or None for all cores, got {threads!r}")
    step = max(SLAB_VOXELS // (shape[1] * shape[2]), 1)
    ranges = [(start, min(start + step, shape[0])) for start in range(0, shape[0], step)]
    with thread_map(min(threads or usable_cores(), len(ranges))) as spread:
        list(spread(lambda slab: work(*slab), ranges))  # raises what a thread raised
