"""What the networks see of a query: volumes of its part, laid as a guess lays it, and of the kits around a place.

Values are distance / truncation (five voxels) from -1 to 1, negative inside. Where nobody knows it is free. The middle
of a volume is its voxel n // 2 along each axis. Training and answering make them by the same calls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import ceil
from operator import attrgetter, methodcaller
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.ndimage import find_objects

from baselines.completion import AROUND, SeenKits, SeenPart
from baselines.completion.pixels import noise_of, window
from baselines.snapnet.config import Cells, Kind, PositionConfig, RotationConfig
from baselines.snapnet.points import points_of
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pivots import extent_centre
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query, Truth
from kit1000.voxels import Grid, Volume, crop, resample, signed_distance, tsdf

MESHES = 2048  # parts, and as many assemblies, kept in memory: 0.2 MB each, all of a training split
SCENES = 1024  # whose depth images, cut to their masks, are kept in memory: 0.5 MB each
PARTS = 4096  # of images, whose volumes are kept in memory: 0.1 MB each in voxels of the small size

Key = TypeVar("Key")
Value = TypeVar("Value")


class Standing(NamedTuple):
    """The kits of an assembly: one mesh, and where each kit is in it."""

    mesh: Mesh
    assembly_from_kit: dict[str, Pose]
    """By the id of the kit."""


class Seen(NamedTuple):
    """What an image shows, cut out of it; nothing of what it does not show."""

    kits: SeenKits | None
    parts: dict[int, LabelledDepth]
    """By the number of the part: the box of its mask, and AROUND it."""


class Kept:
    """Meshes and cut-out depth images of a dataset that stay in memory once they were read, up to a number of them.

    May be pickled and forked; when pickled, what is kept stays behind.
    """

    def __init__(self, dataset: Dataset, look: Callable[[Query], LabelledDepth] = methodcaller("read_image")) -> None:
        """Nothing is read yet. look: how the image of a query is read; what is pickled reads it anew."""
        self.dataset = dataset
        self.part: Callable[[str], Mesh] = lru_cache(MESHES)(self._part)
        self.assembly: Callable[[str], Standing] = lru_cache(MESHES)(self._assembly)
        self._look = look
        self._seen: dict[tuple[str, str], Seen] = {}
        self._parts: dict[tuple[str, str, int, float], Volume | None] = {}

    def __reduce__(self) -> tuple[type[Kept], tuple[Dataset]]:
        return Kept, (self.dataset,)

    def seen_kits(self, query: Query) -> SeenKits | None:
        """What was seen of the kits of a query, which must be one of this dataset as it was read."""
        return self._of(query).kits

    def seen_part(self, query: Query, voxel: float) -> Volume | None:
        """The part as its image shows it, in voxels [m], upright; None where it does not."""

        def make() -> Volume | None:
            look = self._of(query).parts.get(query.part)
            return None if look is None else _filled_part(look, query, voxel)

        return _remembered(self._parts, (query.scene_id, query.sensor, query.part, voxel), PARTS, make)

    def _of(self, query: Query) -> Seen:
        key = (query.scene_id, query.sensor)
        return _remembered(self._seen, key, SCENES, lambda: cut_out(self._look(query), query))

    def _part(self, part_id: str) -> Mesh:
        return self.dataset.geometry.part(part_id).mesh

    def _assembly(self, assembly_id: str) -> Standing:
        assembly = self.dataset.geometry.assembly(assembly_id)
        return Standing(assembly.mesh, {mount.kit.id: mount.assembly_from_kit for mount in assembly.mounts})


@dataclass(frozen=True, eq=False)
class Looks:
    """Volumes of one query."""

    query: Query
    truth: Truth | None
    """Needed where the volumes are true."""
    kind: Kind
    """truth: exact, from the meshes of the part and of the assembly; partial: what the depth image says of either."""
    dataset: Dataset
    """Of the query: its meshes are the true ones."""
    kept: Kept | None = None
    """Where meshes and images are remembered for other queries."""

    def __post_init__(self) -> None:
        if self.kind == "truth" and self.truth is None:
            raise InputError(f"{self.query.id}: true volumes want the truth; say dataset.split(NAME, truth=True)")

    def part_volume(self, guess: Pose, world_from_work: Pose, cells: Cells, voxel: float) -> np.ndarray:
        """The part, on a grid that has the working axes once it is moved by the guess, with the pivot in the middle.

        Args:
            guess: a motion of the part in the world.
            world_from_work: the working axes; where they begin is not read.
            cells: (nx, ny, nz) voxels.
            voxel: [m] edge.

        Returns:
            (nx, ny, nz) float32.
        """
        there = Pose(world_from_work.wxyz, guess.apply(self.query.pivot))
        grid = grid_about(guess.inverse() @ there, cells, voxel)
        if self.kind == "partial":
            seen = self._store.seen_part(self.query, voxel)
            return np.ones(cells, np.float32) if seen is None else resample(seen, grid, threads=1).filled(1)
        return _exact(grid, self._store.part(self._known.part_id), self._known.world_from_part)

    def kit_volume(self, world_from_work: Pose, cells: Cells, voxel: float, columns: bool = False) -> np.ndarray:
        """The kits, on a grid of the working axes with their origin in the middle.

        Args:
            world_from_work: the working axes.
            cells: (nx, ny, nz) voxels.
            voxel: [m] edge.
            columns: whether what an image hides of the kits is filled under what it shows, see `SeenKits.volume`.

        Returns:
            (nx, ny, nz) float32.
        """
        grid = grid_about(world_from_work, cells, voxel)
        if self.kind == "truth":
            standing = self._store.assembly(self._known.assembly_id)
            kit = standing.assembly_from_kit[self._known.part_id]
            return _exact(grid, standing.mesh, self._known.world_from_kit @ kit.inverse())
        seen = self._store.seen_kits(self.query)
        if seen is None:
            return np.ones(cells, np.float32)
        if columns:
            return resample(seen.volume(world_from_work.xyz, voxel), grid, threads=1).filled(1)
        return tsdf(grid, seen.view, seen.mask, threads=1).filled(1)

    def for_position(self, guess: Pose, work: Pose, config: PositionConfig) -> dict[str, np.ndarray]:
        """What the position network is shown: `part` and `kit`, along working axes that begin where the pivot is."""
        return {
            "part": self.part_volume(guess, work, config.part_cells, config.voxel),
            "kit": self.kit_volume(work, config.kit_cells, config.voxel),
        }

    def for_rotation(
        self, guess: Pose, place: Pose, config: RotationConfig, rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        """What the rotation network is shown, but for the turns.

        Args:
            guess: a motion of the part in the world.
            place: working axes that begin where the part goes.
            config: what is wanted.
            rng: draws the points.

        Returns:
            float32: `part_points` (P, 3), `kit_points` (K, 3) and, where the config has distances, `kit_volume`
            (nx, ny, nz).
        """
        part = self.part_volume(guess, place, config.part_cells, config.voxel)
        kit = self.kit_volume(place, config.kit_cells, config.voxel, columns=True)
        told = {"kit_volume": kit} if config.distance else {}
        return told | {
            "part_points": points_of(part, config.voxel, config.points, config.part_points, rng),
            "kit_points": points_of(kit, config.voxel, config.points, config.kit_points, rng),
        }

    def start(self) -> Pose:
        """The guess, or where nobody guesses the shift that takes the pivot to the middle of what is seen of the kits.

        Raises:
            InputError: no guess, and nothing seen of the kits.
        """
        if self.query.guess is not None:
            return self.query.guess
        seen = self._store.seen_kits(self.query)
        middle = None if seen is None else extent_centre(seen.view, seen.mask & (seen.view.depth > 0))
        if middle is None:
            raise InputError(f"{self.query.id}: its image shows nothing of the kits")
        return Pose.from_translation(middle - self.query.pivot)

    @property
    def _known(self) -> Truth:
        assert self.truth is not None, "checked when made"
        return self.truth

    @cached_property
    def _store(self) -> Kept:
        return self.kept or Kept(self.dataset, attrgetter("image"))


def grid_about(world_from_middle: Pose, cells: Cells, voxel: float) -> Grid:
    """The grid of `cells` voxels [m] whose voxel n // 2 along each axis has its centre at a pose."""
    first = -(np.array(cells) // 2) * voxel
    return Grid(cells, voxel, world_from_middle @ Pose.from_translation(first))


def _remembered(store: dict[Key, Value], key: Key, most: int, make: Callable[[], Value]) -> Value:
    """The value of a key, made when it is not there; the first of too many goes."""
    if key not in store:
        if len(store) >= most:
            del store[next(iter(store))]
        store[key] = make()
    return store[key]


def cut_out(look: LabelledDepth, query: Query) -> Seen:
    """The windows of the image of a query that volumes are made of."""
    kits, parts = None, {}
    for label, box in enumerate(find_objects(look.labels), start=1):
        if box is not None and label == ASSEMBLY_LABEL:
            kits = SeenKits(window(look, box), noise_of(query.sensor), query.scene_id)
        elif box is not None:
            parts[label - FIRST_PART_LABEL] = window(look, _grown(box, look, label))
    return Seen(kits, parts)


def _grown(box: tuple[slice, slice], look: LabelledDepth, label: int) -> tuple[slice, slice]:
    """A box of pixels, and so many more as AROUND asks for at the depth of what is seen there."""
    depth = look.view.depth[box][(look.labels[box] == label) & (look.view.depth[box] > 0)]
    more = ceil(AROUND * look.view.camera.fx / depth.min()) if len(depth) else 0
    rows, columns = (slice(max(side.start - more, 0), side.stop + more) for side in box)
    return rows, columns


def _filled_part(look: LabelledDepth, query: Query, voxel: float) -> Volume:
    """What is seen of a part and what hides behind, no more of the volume than is not free."""
    volume = SeenPart(look, FIRST_PART_LABEL + query.part, query.pivot).volume(voxel)
    held = find_objects((volume.values < 1).astype(np.uint8))
    if not held:
        return volume
    first, last = np.array([(max(side.start - 1, 0), side.stop + 1) for side in held[0]]).T
    return crop(volume, tuple(first), tuple(last - first))


def _exact(grid: Grid, mesh: Mesh, world_from_body: Pose) -> np.ndarray:
    return signed_distance(grid, [(mesh, world_from_body)], threads=1).filled(1)
