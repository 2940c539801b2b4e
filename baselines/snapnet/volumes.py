"""What the networks see of a query: volumes of its part, laid as a guess lays it, and of the kits around a place.

Values are distance / truncation (five voxels) from -1 to 1, negative inside; where nobody knows they are 1, as if free.
The middle of a volume is its voxel n // 2 along each axis. Training and answering make them by the same calls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy.ndimage import find_objects

from baselines.snapnet.config import UNKNOWN, Cells, Kind, PositionConfig, RotationConfig
from baselines.snapnet.points import points_of
from kit1000.camera import Camera
from kit1000.data.making.queries import middle_of
from kit1000.data.reader import Dataset
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Look, Query, Truth, View
from kit1000.voxels import Grid, signed_distance, tsdf

MESHES = 2048  # parts, and as many assemblies, kept in memory: 0.2 MB each, all of a training split
SCENES = 1024  # whose depth images, cut to their masks, are kept in memory: 0.5 MB each


class Standing(NamedTuple):
    """The kits of an assembly: one mesh, and where each kit is in it."""

    mesh: Mesh
    assembly_from_kit: dict[str, Pose]
    """By the id of the kit."""


class Kept:
    """Meshes and cut-out depth images of a dataset that stay in memory once they were read, up to a number of them.

    May be pickled and forked; when pickled, what is kept stays behind.
    """

    def __init__(self, dataset: Dataset) -> None:
        self.dataset = dataset
        self.part: Callable[[str], Mesh] = lru_cache(MESHES)(self._part)
        self.assembly: Callable[[str], Standing] = lru_cache(MESHES)(self._assembly)
        self._views: dict[tuple[str, str], dict[int, View]] = {}

    def __reduce__(self) -> tuple[type[Kept], tuple[Dataset]]:
        return Kept, (self.dataset,)

    def views(self, query: Query) -> dict[int, View]:
        """What `cut_out` leaves of the image of a query, which must be one of this dataset as it was read."""
        key = (query.scene_id, query.sensor)
        if key not in self._views:
            if len(self._views) >= SCENES:
                del self._views[next(iter(self._views))]
            self._views[key] = cut_out(query.look())
        return self._views[key]

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
            return self._seen(grid, FIRST_PART_LABEL + self.query.part)
        return _exact(grid, self._store.part(self._known.part_id), self._known.world_from_part)

    def kit_volume(self, world_from_work: Pose, cells: Cells, voxel: float, unknown: float = UNKNOWN) -> np.ndarray:
        """The kits, on a grid of the working axes with their origin in the middle.

        Args:
            world_from_work: the working axes.
            cells: (nx, ny, nz) voxels.
            voxel: [m] edge.
            unknown: value where nobody knows.

        Returns:
            (nx, ny, nz) float32.
        """
        grid = grid_about(world_from_work, cells, voxel)
        if self.kind == "partial":
            return self._seen(grid, ASSEMBLY_LABEL, unknown)
        standing = self._store.assembly(self._known.assembly_id)
        kit = standing.assembly_from_kit[self._known.part_id]
        return _exact(grid, standing.mesh, self._known.world_from_kit @ kit.inverse())

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
            (nx, ny, nz), NaN where nobody knows.
        """
        part = self.part_volume(guess, place, config.part_cells, config.voxel)
        known = self.kit_volume(place, config.kit_cells, config.voxel, np.nan)
        kit = np.where(np.isnan(known), np.float32(UNKNOWN), known)
        told = {"kit_volume": known} if config.distance else {}
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
        view = self._views.get(ASSEMBLY_LABEL)
        middle = None if view is None else middle_of(view, view.depth > 0)
        if middle is None:
            raise InputError(f"{self.query.id}: its image shows nothing of the kits")
        return Pose.from_translation(middle - self.query.pivot)

    @property
    def _known(self) -> Truth:
        assert self.truth is not None, "checked when made"
        return self.truth

    @cached_property
    def _store(self) -> Kept:
        return self.kept or Kept(self.dataset)

    @cached_property
    def _views(self) -> dict[int, View]:
        return cut_out(self.query.seen) if self.kept is None else self.kept.views(self.query)

    def _seen(self, grid: Grid, label: int, unknown: float = UNKNOWN) -> np.ndarray:
        if label not in self._views:
            return np.full(grid.shape, unknown, np.float32)
        return tsdf(grid, self._views[label], threads=1).filled(unknown)


def grid_about(world_from_middle: Pose, cells: Cells, voxel: float) -> Grid:
    """The grid of `cells` voxels [m] whose voxel n // 2 along each axis has its centre at a pose."""
    first = -(np.array(cells) // 2) * voxel
    return Grid(cells, voxel, world_from_middle @ Pose.from_translation(first))


def cut_out(look: Look) -> dict[int, View]:
    """By label, the image cut to the box of its mask, without a return beside the mask; labels not seen are left out.

    Volumes made of them are those of the whole image with its mask: pixels beside the mask only tell free from unknown,
    and both are 1 to a network.
    """
    views = {}
    for label, box in enumerate(find_objects(look.labels), start=1):
        if box is not None:
            depth = np.where(look.labels[box] == label, look.view.depth[box], np.float32(0))
            camera = _shifted(look.view.camera, depth.shape, box[1].start, box[0].start)
            views[label] = View(camera, look.view.world_from_camera, depth)
    return views


def _shifted(camera: Camera, size: tuple[int, ...], left: int, top: int) -> Camera:
    """The camera of a window of its image that begins at a column and a row; size: its rows and columns."""
    return Camera(size[1], size[0], camera.fx, camera.fy, camera.cx - left, camera.cy - top)


def _exact(grid: Grid, mesh: Mesh, world_from_body: Pose) -> np.ndarray:
    return signed_distance(grid, [(mesh, world_from_body)], threads=1).filled(UNKNOWN)
