"""What a scorer knows of the queries of a split: their truths in order, and the packed arrays that metrics take."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.metrics import Targets
from kit1000.values import Truth


@dataclass(frozen=True, eq=False)
class Questions:
    """Queries with what is true of them, n in all; scene after scene, as the dataset has them."""

    geometry: Geometry
    tracks: tuple[str, ...]
    """Of each query."""
    scene_ids: tuple[str, ...]
    truths: tuple[Truth, ...]

    def __len__(self) -> int:
        return len(self.truths)

    def of_scenes(self, scene_ids: Collection[str]) -> Questions:
        """Those of some scenes alone."""
        kept = [i for i, scene_id in enumerate(self.scene_ids) if scene_id in scene_ids]
        tracks, scenes = tuple(self.tracks[i] for i in kept), tuple(self.scene_ids[i] for i in kept)
        return Questions(self.geometry, tracks, scenes, tuple(self.truths[i] for i in kept))

    @property
    def query_ids(self) -> tuple[str, ...]:
        """Ids of the queries."""
        return tuple(truth.query_id for truth in self.truths)

    @cached_property
    def targets(self) -> Targets:
        """What the pose errors are measured against, (n,)."""
        return Targets.of(self.truths, self._hull)

    def _hull(self, part_id: str) -> np.ndarray:
        """(v, 3) [m] part frame: the vertices of a part's convex hull."""
        vertices = self.geometry.part(part_id).mesh.vertices
        return vertices[ConvexHull(vertices).vertices]


def questions(dataset: Dataset, split: str, tracks: Collection[str]) -> Questions:
    """The queries of some tracks in a split, with their truths. Raises InputError when the truth is not here."""
    found = [row for row in _read(dataset, split) if row[0] in tracks]
    if not found:
        raise InputError(f"{dataset.root}: split {split} asks nothing in {', '.join(sorted(tracks))}")
    names, scene_ids, truths = zip(*found, strict=True)
    return Questions(dataset.geometry, names, scene_ids, truths)


@lru_cache(maxsize=4)
def _read(dataset: Dataset, split: str) -> tuple[tuple[str, str, Truth], ...]:
    """All queries of a split: track, scene and truth. Remembered for as long as a dataset is open, or a few others."""
    return tuple(
        (query.track, recorded.id, recorded.truth_of(query.id))
        for recorded in dataset.split(split, truth=True)
        for query in recorded.queries
    )


def joined(*several: Questions) -> Questions:
    """Queries of several splits of one dataset, one after another."""
    first = several[0]
    return Questions(
        first.geometry,
        sum((each.tracks for each in several), ()),
        sum((each.scene_ids for each in several), ()),
        sum((each.truths for each in several), ()),
    )
