"""Network inputs of a query as numpy arrays: depth images, or volumes of the part and of the kits.

A pose is seven numbers, `wxyz` then `xyz` [m]; a missing pose is NaN. The arrays of an item are its own and may be
changed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.dataset.volume_cache import Entry, Key, VolumeCache
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.queries.motions import error_of
from kit1000.queries.pivots import extent_centre
from kit1000.values import Query, Truth
from kit1000.voxels import Grid, Volume, signed_distance, tsdf
from kit1000.voxels.grid import DEFAULT_TRUNCATION

Item = dict[str, Any]
Maker = Callable[[Query, Truth | None, np.random.Generator], Mapping[str, Any]]
"""Makes the item of a query; the truth is None where the split was opened without it. The generator is for random
augmentations. Workers make the same items when a maker has no other source of randomness."""

SOURCES = ("depth", "truth")


def depth_item(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    """The depth image of a query with its masks and camera, and the entries of `query_item`.

    `depth` (H, W) float32 [m], 0 = no return; `part`, `kits` (H, W) bool masks; `camera` (3, 3) float32 intrinsics;
    `world_from_camera` (7,) float32.
    """
    view = query.view
    images = {
        "depth": view.depth.copy(),  # the queries of a scene share the original
        "part": query.part_mask,
        "kits": query.kit_region,
        "camera": view.camera.K.astype(np.float32),
        "world_from_camera": pose_vector(view.world_from_camera),
    }
    return images | query_item(query, truth)


def query_item(query: Query, truth: Truth | None) -> Item:
    """A query without its images, and with the truth the learning targets.

    `id` text; `pivot` (3,) float32 [m]; `guess` (7,) float32. With the truth: `goal` (7,) float32, and the correction
    from the guess to the goal, along world axes: `offset` (3,) float32 [m] of the pivot, `rotvec` (3,) float32 [rad];
    `kit1000.queries.motions.apply_error(guess, pivot, offset, rotvec)` is the goal.
    """
    item: Item = {"id": query.id, "pivot": query.pivot.astype(np.float32), "guess": pose_vector(query.guess)}
    if truth is None:
        return item
    offset, rotvec = np.full((2, 3), np.nan)
    if query.guess is not None:
        offset, rotvec = error_of(truth.goal_drawn, query.guess, query.pivot)
    goal = pose_vector(truth.goal_drawn)
    return item | {"goal": goal, "offset": offset.astype(np.float32), "rotvec": rotvec.astype(np.float32)}


def pose_vector(pose: Pose | None) -> np.ndarray:
    """A pose as (7,) float32, `wxyz` then `xyz` [m]; NaN for None."""
    if pose is None:
        return np.full(7, np.nan, np.float32)
    return np.concatenate([pose.wxyz, pose.xyz]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class VolumeItem:
    """Makes items with a volume of the part and a volume of the kits, aligned by the guess.

    Entries: `part`, `kit` (nx, ny, nz) float32, signed distance / truncation (five voxels), negative inside;
    `part_grid`, `kit_grid` (7,) their `world_from_grid`; and those of `query_item`. The kit's grid has the axes of the
    world and is centred where the guess takes the pivot. The part's grid is the kit's, moved by the inverse of the
    guess, so with equal shapes voxel (i, j, k) of both grids coincide after the guess. Without a guess the grids are
    centred at the pivot and at the centre of the visible kits, and all axes are those of the world.
    """

    dataset: Dataset
    """The dataset of the queries: its id is part of the cache keys, its meshes give the true volumes."""
    shape: tuple[int, int, int] = (64, 64, 64)
    """Number of voxels of the part's volume."""
    voxel_size: float = 1.5e-3
    """[m] of both volumes; 64 voxels contain any part of 50 mm."""
    kit_shape: tuple[int, int, int] | None = None
    """Number of voxels of the kits' volume; as the part's when None."""
    source: str = "depth"
    """depth: TSDF from the query's depth image; truth: exact signed distance from the meshes."""
    unknown: float = 1.0
    """Value of unknown voxels: 1 as if free, -1 as if solid."""
    cache: VolumeCache | None = None
    """Cache of the volumes; for cached volumes no image and no mesh is read."""
    codes: bool = False
    """Return the encoded volumes of the cache, for `kit1000.dataset.torch.decode_volumes` to decode on any device."""

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise InputError(f"source {self.source!r}: expected one of {', '.join(SOURCES)}")
        if self.codes and self.cache is None:
            raise InputError("codes: need a cache, as in cache=VolumeCache('cache')")
        for shape in (self.shape, self.kit_shape or self.shape):
            Grid(shape, self.voxel_size, Pose.identity())  # raises for an invalid shape or voxel size

    def __call__(self, query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
        """The item of a query."""
        self._check(query, truth)  # also for cached volumes
        part = self._volume(query, "part", self.shape, lambda: self.part(query, truth))
        kit = self._volume(query, "kit", self.kit_shape or self.shape, lambda: self.kit(query, truth))
        volumes = {"part": self._array(part), "kit": self._array(kit)}
        grids = {"part_grid": pose_vector(part.grid.world_from_grid), "kit_grid": pose_vector(kit.grid.world_from_grid)}
        return volumes | grids | query_item(query, truth)

    def part(self, query: Query, truth: Truth | None = None) -> Volume:
        """The volume of the query's part."""
        middle = Pose.from_translation(query.pivot)
        if query.guess is not None:
            middle = query.guess.inverse() @ Pose.from_translation(query.guess.apply(query.pivot))
        grid = Grid.centred(middle, self.shape, self.voxel_size)
        if self.source == "depth":
            return tsdf(grid, query.view, query.part_mask, threads=1)
        true = self.dataset.geometry.true_geometry(self._check(query, truth))
        return signed_distance(grid, [(true.part, true.world_from_part)], threads=1)

    def kit(self, query: Query, truth: Truth | None = None) -> Volume:
        """The volume of the kits, centred where the guess takes the pivot, or at the centre of the visible kits."""
        middle = extent_centre(query.view, query.kit_region) if query.guess is None else query.guess.apply(query.pivot)
        if middle is None:
            raise InputError(f"{query.id}: the kits are not visible in its image")
        grid = Grid.centred(Pose.from_translation(middle), self.kit_shape or self.shape, self.voxel_size)
        if self.source == "depth":
            return tsdf(grid, query.view, query.kit_region, threads=1)
        true = self.dataset.geometry.true_geometry(self._check(query, truth))
        return signed_distance(grid, [(true.assembly, true.world_from_assembly)], threads=1)

    def _check(self, query: Query, truth: Truth | None) -> Any:
        """The truth; raises InputError when true volumes need it and it is None."""
        if truth is None and self.source == "truth":
            raise InputError(f"{query.id}: true volumes need the truth; use dataset.split(NAME, truth=True)")
        return truth

    def _volume(
        self, query: Query, name: str, shape: tuple[int, int, int], make: Callable[[], Volume]
    ) -> Volume | Entry:
        """A volume, from the cache if there is one; its cache entry where `codes` is set."""
        if self.cache is None:
            return make()
        recipe = {"source": self.source, "shape": shape, "voxel": self.voxel_size, "truncation": DEFAULT_TRUNCATION}
        key = Key(self.dataset.id, query.scene_id, f"{query.id}.{name}", recipe)
        return (self.cache.entry if self.codes else self.cache.volume)(key, make)

    def _array(self, volume: Volume | Entry) -> np.ndarray:
        return volume.codes if isinstance(volume, Entry) else volume.filled(self.unknown)
