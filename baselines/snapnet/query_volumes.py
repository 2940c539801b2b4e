"""The inputs of the networks: volumes of a query's part, moved as a guess says, and of the kits around a position.

Values are distance / truncation (five voxels) from -1 to 1, negative inside; unknown space counts as free. The middle
of a volume is its voxel n // 2 along each axis. Training and prediction make them by the same calls.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from operator import attrgetter, methodcaller
from typing import Literal, NamedTuple, TypeVar

import numpy as np
import torch
from scipy.ndimage import find_objects
from torch import Tensor
from torch.nn import functional

from baselines.snapnet.config import Cells, PositionConfig, RotationConfig, Source
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.completion.parts import CompletedPart, PartCompleter
from kit1000.perception.observed.kits import ObservedKits
from kit1000.perception.observed.parts import TABLE_MARGIN, ObservedPart
from kit1000.perception.observed.pixels import cropped
from kit1000.perception.restoration import restored
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.queries.pivots import extent_centre
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query, TrueGeometry
from kit1000.voxels import Grid, Volume, crop, resample, signed_distance, surface_points, tsdf

SCENES = 1024  # whose cropped depth images are kept in memory: 0.5 MB each
PARTS = 4096  # of images, whose volumes are kept in memory: 0.1 MB each in voxels of the small preset

Key = TypeVar("Key")
Value = TypeVar("Value")
Where = Literal["inside", "surface"]


class ImageCrops(NamedTuple):
    """The crops of a depth image that volumes are made of."""

    kits: ObservedKits | None
    parts: dict[int, LabelledDepth]
    """Crops by the index of the part: the box of its mask, with TABLE_MARGIN around it."""


class ImageCache:
    """Cropped depth images, and volumes of parts made of them, kept in memory; when pickled, they stay behind."""

    def __init__(
        self,
        read_image: Callable[[Query], LabelledDepth] = methodcaller("read_image"),
        completer: PartCompleter | None = None,
        kit_completer: KitCompleter | None = None,
    ) -> None:
        """Nothing is read yet.

        Args:
            read_image: how the image of a query is read.
            completer: the network that completes parts; None fills columns.
            kit_completer: the network that completes kits, see `ObservedKits`.
        """
        self._read_image, self._completer, self._kit_completer = read_image, completer, kit_completer
        self.crops: dict[tuple[str, str], ImageCrops] = {}
        self.parts: dict[tuple[str, str, int, float], Volume | None] = {}

    def __reduce__(self) -> tuple[type[ImageCache], tuple[object, ...]]:
        return ImageCache, (self._read_image, self._completer, self._kit_completer)

    def kits(self, query: Query) -> ObservedKits | None:
        """The observed kits of a query; None if its image shows none."""
        return self._of(query).kits

    def part(self, query: Query, voxel: float) -> Volume | None:
        """The observed part in voxels [m], along the axes of the world; None if its image does not show it."""

        def make() -> Volume | None:
            image = self._of(query).parts.get(query.part)
            return None if image is None else _part_volume(image, query, voxel, self._completer)

        return _cached(self.parts, (query.scene_id, query.sensor, query.part, voxel), PARTS, make)

    def _of(self, query: Query) -> ImageCrops:
        key = (query.scene_id, query.sensor)

        def make() -> ImageCrops:
            return image_crops(
                restored(self._read_image(query), simulated_sensor(query.sensor)), query, self._kit_completer
            )

        return _cached(self.crops, key, SCENES, make)


@dataclass(frozen=True, eq=False)
class QueryVolumes:
    """Volumes of one query."""

    query: Query
    source: Source
    """truth: exact, from the true geometry; depth: from the depth image."""
    geometry: TrueGeometry | None = None
    """Needed for exact volumes."""
    cache: ImageCache | None = None
    """Shared with other queries of the dataset; of this query alone when None."""

    def __post_init__(self) -> None:
        if self.source == "truth" and self.geometry is None:
            raise InputError(f"{self.query.id}: exact volumes need the true geometry")

    def part_volume(self, guess: Pose, world_from_work: Pose, cells: Cells, voxel: float) -> np.ndarray:
        """The part, on a grid along the working axes once it is moved by the guess, with the pivot in the middle.

        Args:
            guess: a motion of the part in the world.
            world_from_work: the working axes; the origin is not read.
            cells: (nx, ny, nz) voxels.
            voxel: [m] edge.

        Returns:
            (nx, ny, nz) float32.
        """
        there = Pose(world_from_work.wxyz, guess.apply(self.query.pivot))
        grid = grid_about(guess.inverse() @ there, cells, voxel)
        if self.source == "depth":
            observed = self._images.part(self.query, voxel)
            return np.ones(cells, np.float32) if observed is None else resample(observed, grid, threads=1).filled(1)
        return _exact(grid, self._true.part, self._true.world_from_part)

    def kit_volume(self, world_from_work: Pose, cells: Cells, voxel: float, columns: bool = False) -> np.ndarray:
        """The kits, on a grid of the working axes with their origin in the middle.

        Args:
            world_from_work: the working axes.
            cells: (nx, ny, nz) voxels.
            voxel: [m] edge.
            columns: whether hidden space below the observed kits is solid, see `ObservedKits.volume`.

        Returns:
            (nx, ny, nz) float32.
        """
        grid = grid_about(world_from_work, cells, voxel)
        if self.source == "truth":
            return _exact(grid, self._true.assembly, self._true.world_from_assembly)
        observed = self._images.kits(self.query)
        if observed is None:
            return np.ones(cells, np.float32)
        if columns:
            return resample(observed.volume(world_from_work.xyz, voxel), grid, threads=1).filled(1)
        return tsdf(grid, observed.view, observed.mask, threads=1).filled(1)

    def position_inputs(self, guess: Pose, work: Pose, config: PositionConfig) -> dict[str, np.ndarray]:
        """The volumes `part` and `kit` of the position network, along working axes whose origin is the moved pivot."""
        return {
            "part": self.part_volume(guess, work, config.part_cells, config.voxel),
            "kit": self.kit_volume(work, config.kit_cells, config.voxel),
        }

    def rotation_inputs(
        self, guess: Pose, work: Pose, config: RotationConfig, rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        """The inputs of the rotation network, without the candidates.

        Args:
            guess: a motion of the part in the world.
            work: working axes whose origin is the predicted position of the pivot.
            config: of the network.
            rng: draws the points.

        Returns:
            float32: `part_points` (P, 3), `kit_points` (K, 3) and, with `kit_distance`, `kit_volume` (nx, ny, nz).
        """
        part = self.part_volume(guess, work, config.part_cells, config.voxel)
        kit = self.kit_volume(work, config.kit_cells, config.voxel, columns=True)
        volume = {"kit_volume": kit} if config.kit_distance else {}
        return volume | {
            "part_points": sample_points(part, config.voxel, config.points, config.part_points, rng),
            "kit_points": sample_points(kit, config.voxel, config.points, config.kit_points, rng),
        }

    def initial_guess(self) -> Pose:
        """The user's guess; without one the shift that takes the pivot to the centre of the observed kits.

        Raises:
            InputError: no guess, and no kit is observed.
        """
        if self.query.guess is not None:
            return self.query.guess
        observed = self._images.kits(self.query)
        centre = None if observed is None else extent_centre(observed.view, observed.mask & (observed.view.depth > 0))
        if centre is None:
            raise InputError(f"{self.query.id}: its image shows nothing of the kits")
        return Pose.from_translation(centre - self.query.pivot)

    @property
    def _true(self) -> TrueGeometry:
        assert self.geometry is not None, "checked when made"
        return self.geometry

    @cached_property
    def _images(self) -> ImageCache:
        return self.cache or ImageCache(attrgetter("image"))


def grid_about(world_from_middle: Pose, cells: Cells, voxel: float) -> Grid:
    """The grid of `cells` voxels [m] whose voxel n // 2 along each axis has its centre at a pose."""
    first = -(np.array(cells) // 2) * voxel
    return Grid(cells, voxel, world_from_middle @ Pose.from_translation(first))


def image_crops(image: LabelledDepth, query: Query, completer: KitCompleter | None = None) -> ImageCrops:
    """The crops of a query's image that volumes are made of; completer: of kits, see `ObservedKits`."""
    kits, parts = None, {}
    for label, box in enumerate(find_objects(image.labels), start=1):
        if box is not None and label == ASSEMBLY_LABEL:
            kits = ObservedKits(
                cropped(image, box), simulated_sensor(query.sensor).kind.noise, query.scene_id, completer=completer
            )
        elif box is not None:
            parts[label - FIRST_PART_LABEL] = cropped(image, _with_margin(box, image, label))
    return ImageCrops(kits, parts)


def _with_margin(box: tuple[slice, slice], image: LabelledDepth, label: int) -> tuple[slice, slice]:
    """A box of pixels and TABLE_MARGIN around it, at the depth of the labelled pixels in it."""
    depth = image.view.depth[box][(image.labels[box] == label) & (image.view.depth[box] > 0)]
    more = ceil(TABLE_MARGIN * image.view.camera.fx / depth.min()) if len(depth) else 0
    rows, columns = (slice(max(side.start - more, 0), side.stop + more) for side in box)
    return rows, columns


def _part_volume(image: LabelledDepth, query: Query, voxel: float, completer: PartCompleter | None) -> Volume:
    """The volume of an observed part, cropped to what is not free."""
    observed = ObservedPart(image, FIRST_PART_LABEL + query.part, query.pivot)
    volume = observed.volume(voxel) if completer is None else CompletedPart(observed, completer).volume(voxel)
    boxes = find_objects((volume.values < 1).astype(np.uint8))
    if not boxes:
        return volume
    first, last = np.array([(max(side.start - 1, 0), side.stop + 1) for side in boxes[0]]).T
    return crop(volume, tuple(first), tuple(last - first))


def _exact(grid: Grid, mesh: Mesh, world_from_body: Pose) -> np.ndarray:
    return signed_distance(grid, [(mesh, world_from_body)], threads=1).filled(1)


def _cached(store: dict[Key, Value], key: Key, most: int, make: Callable[[], Value]) -> Value:
    """The value of a key, made when it is missing; beyond `most` values the oldest is dropped."""
    if key not in store:
        if len(store) >= most:
            del store[next(iter(store))]
        store[key] = make()
    return store[key]


def sample_points(volume: np.ndarray, voxel: float, where: Where, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points of a volume, drawn uniformly without replacement.

    Where there are fewer than `count`, all of them are taken repeatedly, each time in a new order (the release fills
    up with a corner of the volume, which then is a point of the shape); where there are none, all points lie in the
    middle.

    Args:
        volume: (nx, ny, nz) float32, signed distances in truncations, 1 where unknown.
        voxel: [m] edge.
        where: inside: centres of voxels whose value is at most 0; surface: zero crossings between two voxels, except
            where the value jumps by more than the truncation: that is the end of the observed surface.
        count: points.
        rng: draws them.

    Returns:
        (count, 3) float32 [m] from the middle of the voxel n // 2 of each axis, along the axes of the grid; in
        random order.
    """
    values = np.asarray(volume, np.float32)
    if values.ndim != 3:
        raise InputError(f"volume: expected shape (nx, ny, nz), got {values.shape}")
    if where == "inside":
        indices = np.argwhere(values <= 0).astype(np.float64)
    else:
        indices = surface_points(Volume(Grid(values.shape, 1.0, Pose.identity()), values))
    if len(indices) == 0:
        return np.zeros((count, 3), np.float32)
    full, rest = divmod(count, len(indices))
    rounds = [rng.permutation(len(indices)) for _ in range(full)] + [rng.choice(len(indices), rest, replace=False)]
    return ((indices[np.concatenate(rounds)] - np.array(values.shape) // 2) * voxel).astype(np.float32)


def rotated(points: Tensor, rotations: Tensor) -> Tensor:
    """Points (B, P, 3) rotated about the origin by quaternions (B, C, 4) wxyz. (B, C, P, 3), of the points' type.

    Each coordinate is one fixed sum of three products, so that a point rotated alone and in a batch is the same to
    the bit: the points within a radius must not depend on how many candidates are scored together.
    """
    matrix = _matrices(rotations).to(points.dtype)[:, :, None]  # (B, C, 1, 3, 3)
    p = points[:, None, :, None]  # (B, 1, P, 1, 3)
    return matrix[..., 0] * p[..., 0] + matrix[..., 1] * p[..., 1] + matrix[..., 2] * p[..., 2]  # (B, C, P, 3)


def interpolated(volume: Tensor, points: Tensor, voxel: float) -> Tensor:
    """Values of volumes at points, trilinear; outside, the value of the nearest voxel at the border.

    Args:
        volume: (B, nx, ny, nz).
        points: (B, C, P, 3) [m] from the middle of the voxel n // 2 of each axis.
        voxel: [m] edge.

    Returns:
        (B, C, P).
    """
    cells = points.new_tensor(volume.shape[1:])
    normalised = 2 * (points / voxel + torch.floor(cells / 2)) / (cells - 1) - 1  # -1 and 1 at the outermost voxels
    grid = normalised.flip(-1)[:, :, :, None]  # torch counts axes from the last
    values = functional.grid_sample(volume[:, None], grid, padding_mode="border", align_corners=True)
    return values[:, 0, :, :, 0]


def _matrices(wxyz: Tensor) -> Tensor:
    """Rotation matrices of quaternions of any length above 0. (..., 4) -> (..., 3, 3)."""
    w, x, y, z = (wxyz / wxyz.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
