"""What three cameras show of a scene: a height map of the kits and one of each part.

Masks are those of the primary camera: the image of a query. The three cameras are recorded with test scenes; those of
training scenes are rendered, which needs their truth, and kept in a folder beside the dataset.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from joblib import Memory
from scipy.ndimage import distance_transform_edt

from baselines.heights.maps import UNSEEN, HeightMap
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.numerics.compiled import compiled
from kit1000.perception.observed.pixels import pixel_points, transformed
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, View

CELL = 1e-3  # [m] of stored maps: a pixel of the three cameras
CORNER, CELLS = np.array([-0.21, -0.42]), (420, 840)  # of the map of the table
KITS = 420  # rows from here on are the half of the table where kits stand
PART_CELLS = (100, 100)  # of a part's map, about its pivot: no part is longer than 50 mm
LOWEST = 1e-3  # [m] above the table: what is lower is the table
CAMERAS = 3
SCENES, RECENT = 1200, 4  # kept in memory, of 0.8 and 1.4 MB each


@dataclass(frozen=True, eq=False)
class SceneHeights:
    """What three cameras show of a scene."""

    kits: HeightMap
    """Heights of the half of the table where kits stand."""
    middle: np.ndarray
    """(2,) [m] middle of the extent of the observed kits."""
    parts: dict[int, HeightMap]
    """Heights by the index of the part; UNSEEN beside it."""


class RecordedHeights:
    """The maps of queries, from the recorded images of the three cameras."""

    def __init__(self, dataset: Dataset) -> None:
        """Nothing is read yet."""
        self.dataset = dataset
        self._table = lru_cache(RECENT)(self._read)

    def of(self, query: Query) -> SceneHeights:
        """The maps of the kits and of the query's part; raises InputError if its scene was recorded without them."""
        return _scene_heights(self._table(query.scene_id), query.image, {query.part: query.pivot})

    def _read(self, scene_id: str) -> np.ndarray:
        scene = self.dataset.recorded_scene(scene_id, truth=False)
        return _table(three_views(scene))


class RenderedHeights:
    """The maps of scenes whose truth may be read, as the three cameras would record them; kept in memory and files."""

    def __init__(self, dataset: Dataset, folder: Path) -> None:
        """Nothing is read yet. folder: where maps are kept, created when needed."""
        self.dataset, self.folder = dataset, folder
        self.of = lru_cache(SCENES)(self._of)

    @classmethod
    def beside(cls, dataset: Dataset) -> RenderedHeights:
        """Maps kept in the folder NAME.heights beside a dataset."""
        return cls(dataset, dataset.root.with_name(f"{dataset.root.name}.heights"))

    def __reduce__(self) -> tuple[type[RenderedHeights], tuple[Dataset, Path]]:
        return RenderedHeights, (self.dataset, self.folder)

    def _of(self, scene_id: str) -> SceneHeights:
        kept = Memory(self.folder, compress=True, verbose=0).cache(_rendered_heights, ignore=["dataset"])
        return kept(self.dataset, self.dataset.id, scene_id)  # pyright: ignore[reportReturnType]


def _rendered_heights(dataset: Dataset, dataset_id: str, scene_id: str) -> SceneHeights:
    """The maps of a scene; `dataset_id` tells datasets of one folder apart."""
    scene = dataset.recorded_scene(scene_id, truth=True)
    pivots = {query.part: query.pivot for query in scene.queries if query.sensor == "ideal"}
    return _scene_heights(_table(scene.render("three").values()), scene.labelled_depth("ideal"), pivots)


def three_views(scene: RecordedScene) -> list[View]:
    """The images of the three cameras; raises InputError if a scene was recorded without them."""
    return [scene.view(f"three/{i}/ideal") for i in range(CAMERAS)]


def _table(views: Iterable[View]) -> np.ndarray:
    """CELLS float32 [m]: the map of the table, as some cameras see it."""
    table = np.full(CELLS, UNSEEN, np.float32)
    for view in views:
        _raise(table, view)
    return table


def _scene_heights(table: np.ndarray, image: LabelledDepth, pivots: Mapping[int, np.ndarray]) -> SceneHeights:
    """The maps of a scene.

    Args:
        table: the map of its table.
        image: of the primary camera: its masks tell parts apart.
        pivots: (3,) [m] of parts, by their index.
    """
    kits = HeightMap(CORNER + (0, KITS * CELL), CELL, table[:, KITS:])
    observed = np.argwhere(kits.heights > LOWEST)
    span = observed.min(0) + observed.max(0) + 1 if len(observed) else np.array(kits.heights.shape)
    labels = part_labels(image)
    parts = {i: _part_map(table, labels, i, pivot) for i, pivot in pivots.items()}
    return SceneHeights(kits, kits.corner + span * CELL / 2, parts)


def _raise(table: np.ndarray, view: View) -> None:
    """Raise the cells of the map of the table to the points of a view."""
    camera, pose = view.camera, view.world_from_camera
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    _raise_cells(table, view.depth, intrinsics, pose.rotation_matrix(), pose.xyz)


@compiled
def cell_below(u, v, z, intrinsics, rotation, shift):
    """The cell of the map of the table below the point of a pixel at depth z, and the point's height [m]."""
    fx, fy, cx, cy = intrinsics
    x, y, height = transformed(rotation, shift, (u - cx) / fx * z, (v - cy) / fy * z, z)
    return int(np.floor((x - CORNER[0]) / CELL)), int(np.floor((y - CORNER[1]) / CELL)), height


@compiled
def _raise_cells(table, depth, intrinsics, rotation, shift):
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if depth[v, u] > 0:
                i, j, height = cell_below(u, v, depth[v, u], intrinsics, rotation, shift)
                if 0 <= i < table.shape[0] and 0 <= j < table.shape[1]:
                    table[i, j] = max(table[i, j], max(height, 0.0))


def part_labels(image: LabelledDepth) -> np.ndarray:
    """CELLS int64: the label of the part that the primary camera sees in a cell of the table; 0 where it sees none."""
    mask = (image.labels >= FIRST_PART_LABEL) & (image.view.depth > 0)
    points = pixel_points(image.view, mask)
    index = np.floor((points[:, :2] - CORNER) / CELL).astype(np.int64)
    inside = ((index >= 0) & (index < CELLS)).all(-1)
    labels = np.zeros(CELLS, np.int64)
    labels[tuple(index[inside].T)] = image.labels[mask][inside]
    return labels


def _part_map(table: np.ndarray, labels: np.ndarray, part: int, pivot: np.ndarray) -> HeightMap:
    """The map of a part: cells above the table that are nearer to its own labelled cells than to those of others."""
    first = np.clip(np.floor((pivot[:2] - CORNER) / CELL).astype(int) - np.array(PART_CELLS) // 2, 0, None)
    crop = tuple(slice(i, i + n) for i, n in zip(first, PART_CELLS, strict=True))
    there, labels = np.full(PART_CELLS, UNSEEN, np.float32), np.pad(labels, ((0, 100), (0, 100)))[crop]
    held = table[crop]
    there[: held.shape[0], : held.shape[1]] = held
    nearest = np.asarray(distance_transform_edt(labels == 0, return_distances=False, return_indices=True))
    own = (labels[tuple(nearest)] == FIRST_PART_LABEL + part) & (there > LOWEST)
    return HeightMap(CORNER + first * CELL, CELL, np.where(own, there, UNSEEN))
