"""What a network gets of a query, as numpy arrays: depth images, or volumes of the part and of the kits.

A pose is seven numbers, `wxyz` then `xyz` [m]; one that nobody says is NaN. Arrays belong to the item alone: what is
done to them, no other item sees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kit1000.dataset.cache import Entry, Key, VolumeCache
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.motions import error_of
from kit1000.pivots import extent_centre
from kit1000.pose import Pose
from kit1000.values import Query, Truth
from kit1000.voxels import Grid, Volume, signed_distance, tsdf
from kit1000.voxels.grid import TRUNCATION

Item = dict[str, Any]
Maker = Callable[[Query, Truth | None, np.random.Generator], Mapping[str, Any]]
"""Makes the item of a query; the truth is None where the split was opened without it. The generator is the item's own:
to draw augmentations from. Two processes that load agree when a maker draws from nothing else."""

SOURCES = ("depth", "truth")


def depth_item(query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
    """The depth image of a query with its masks and camera, and what `asked` says.

    `depth` (H, W) float32 [m], 0 = no return; `part`, `kits` (H, W) bool masks; `camera` (3, 3) and
    `world_from_camera` (7,) float32.
    """
    view = query.view
    seen = {
        "depth": view.depth.copy(),  # the recording itself belongs to all queries of the scene
        "part": query.part_mask,
        "kits": query.kit_region,
        "camera": view.camera.K.astype(np.float32),
        "world_from_camera": numbers(view.world_from_camera),
    }
    return seen | asked(query, truth)


def asked(query: Query, truth: Truth | None) -> Item:
    """What a query says besides its images, and with the truth also what is to be learned.

    `id` text; `pivot` (3,) float32 [m]; `guess` (7,) float32. With the truth: `goal` (7,) float32, and from the guess
    to it `offset` (3,) [m], by which the pivot must move on, and `turn` (3,) [rad], a rotation vector in the world:
    `kit1000.guesses.apply_error(guess, pivot, offset, turn)` is the goal.
    """
    item: Item = {"id": query.id, "pivot": query.pivot.astype(np.float32), "guess": numbers(query.guess)}
    if truth is None:
        return item
    offset, turn = np.full((2, 3), np.nan)
    if query.guess is not None:
        offset, turn = error_of(truth.goal_drawn, query.guess, query.pivot)
    goal = numbers(truth.goal_drawn)
    return item | {"goal": goal, "offset": offset.astype(np.float32), "turn": turn.astype(np.float32)}


def numbers(pose: Pose | None) -> np.ndarray:
    """(7,) float32: a pose as `wxyz` and `xyz` [m]; NaN for none."""
    if pose is None:
        return np.full(7, np.nan, np.float32)
    return np.concatenate([pose.wxyz, pose.xyz]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class VolumeItem:
    """Makes items with a volume of the part and one of the kits, in which the guess lays one upon the other.

    `part`, `kit` (nx, ny, nz) float32, distance / truncation (five voxels), negative inside; `part_grid`, `kit_grid`
    (7,) their `world_from_grid`; and what `asked` says. The kit's grid has the axes of the world, its middle where the
    guess takes the pivot. The part's grid is carried back by the guess: moved as the guess says, voxel (i, j, k) of a
    part's grid is voxel (i, j, k) of the kit's, where they have the same shape. Without a guess the middles are the
    pivot and the middle of what is seen of the kits, and all axes those of the world.
    """

    dataset: Dataset
    """Of the queries: its id names what is cached, its meshes are the true ones."""
    shape: tuple[int, int, int] = (64, 64, 64)
    """Voxels of the part's volume."""
    voxel: float = 1.5e-3
    """[m] of both; 64 of them hold any part of 50 mm."""
    kit_shape: tuple[int, int, int] | None = None
    """Voxels of the kits' volume; as many as the part's by default."""
    source: str = "depth"
    """depth: what the query's image says of the part and of the kits; truth: exact, from the meshes."""
    unknown: float = 1.0
    """What stands where nobody knows: 1 as if free, -1 as if solid."""
    cache: VolumeCache | None = None
    """Where to keep volumes; from the second time on, no image and no mesh is opened for them."""
    codes: bool = False
    """Hand out the codes of the cache, unknown among them, for `kit1000.dataset.torch.decoded` to read on any device."""

    def __post_init__(self) -> None:
        if self.source not in SOURCES:
            raise InputError(f"source {self.source!r}: expected one of {', '.join(SOURCES)}")
        if self.codes and self.cache is None:
            raise InputError("codes: they are those of a cache; give one, as in cache=VolumeCache('cache')")
        for shape in (self.shape, self.kit_shape or self.shape):
            Grid(shape, self.voxel, Pose.identity())  # says now what is wrong with them

    def __call__(self, query: Query, truth: Truth | None, rng: np.random.Generator) -> Item:
        """The item of a query."""
        self._check(query, truth)  # also where a cache could answer
        part = self._kept(query, "part", self.shape, lambda: self.part(query, truth))
        kit = self._kept(query, "kit", self.kit_shape or self.shape, lambda: self.kit(query, truth))
        volumes = {"part": self._handed(part), "kit": self._handed(kit)}
        grids = {"part_grid": numbers(part.grid.world_from_grid), "kit_grid": numbers(kit.grid.world_from_grid)}
        return volumes | grids | asked(query, truth)

    def part(self, query: Query, truth: Truth | None = None) -> Volume:
        """The volume of the part a query asks about."""
        middle = Pose.from_translation(query.pivot)
        if query.guess is not None:
            middle = query.guess.inverse() @ Pose.from_translation(query.guess.apply(query.pivot))
        grid = Grid.centred(middle, self.shape, self.voxel)
        if self.source == "depth":
            return tsdf(grid, query.view, query.part_mask, threads=1)
        true = self.dataset.geometry.true_geometry(self._check(query, truth))
        return signed_distance(grid, [(true.part, true.world_from_part)], threads=1)

    def kit(self, query: Query, truth: Truth | None = None) -> Volume:
        """The volume of the kits where the guess takes the part, or around the middle of them all."""
        middle = extent_centre(query.view, query.kit_region) if query.guess is None else query.guess.apply(query.pivot)
        if middle is None:
            raise InputError(f"{query.id}: its image shows nothing of the kits")
        grid = Grid.centred(Pose.from_translation(middle), self.kit_shape or self.shape, self.voxel)
        if self.source == "depth":
            return tsdf(grid, query.view, query.kit_region, threads=1)
        true = self.dataset.geometry.true_geometry(self._check(query, truth))
        return signed_distance(grid, [(true.assembly, true.world_from_assembly)], threads=1)

    def _check(self, query: Query, truth: Truth | None) -> Any:
        """The truth, which must be there when volumes are true."""
        if truth is None and self.source == "truth":
            raise InputError(f"{query.id}: true volumes want the truth; say dataset.split(NAME, truth=True)")
        return truth

    def _kept(self, query: Query, name: str, shape: tuple[int, int, int], make: Callable[[], Volume]) -> Volume | Entry:
        """The volume, from the cache if there is one; an entry where its codes are asked for."""
        if self.cache is None:
            return make()
        recipe = {"source": self.source, "shape": shape, "voxel": self.voxel, "truncation": TRUNCATION}
        key = Key(self.dataset.id, query.scene_id, f"{query.id}.{name}", recipe)
        return (self.cache.entry if self.codes else self.cache.volume)(key, make)

    def _handed(self, kept: Volume | Entry) -> np.ndarray:
        return kept.codes if isinstance(kept, Entry) else kept.filled(self.unknown)
