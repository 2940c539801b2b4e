"""The queries of a split with their ground truth, in order, and as the packed arrays that the metrics take."""

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
class ScoredQueries:
    """n queries with their ground truth, scene after scene, as the dataset has them."""

    geometry: Geometry
    tracks: tuple[str, ...]
    """Track of each query."""
    scene_ids: tuple[str, ...]
    truths: tuple[Truth, ...]

    def __len__(self) -> int:
        return len(self.truths)

    def of_scenes(self, scene_ids: Collection[str]) -> ScoredQueries:
        """The queries of some scenes alone."""
        chosen = [i for i, scene_id in enumerate(self.scene_ids) if scene_id in scene_ids]
        tracks, scenes = tuple(self.tracks[i] for i in chosen), tuple(self.scene_ids[i] for i in chosen)
        return ScoredQueries(self.geometry, tracks, scenes, tuple(self.truths[i] for i in chosen))

    @property
    def query_ids(self) -> tuple[str, ...]:
        """Ids of the queries."""
        return tuple(truth.query_id for truth in self.truths)

    @cached_property
    def targets(self) -> Targets:
        """The goals against which pose errors are measured, (n,)."""
        return Targets.of(self.truths, lambda part_id: hull_points(self.geometry, part_id))


def hull_points(geometry: Geometry, part_id: str) -> np.ndarray:
    """(v, 3) [m] part frame: the vertices of a part's convex hull."""
    vertices = geometry.part(part_id).mesh.vertices
    return vertices[ConvexHull(vertices).vertices]


def read_queries(dataset: Dataset, split: str, tracks: Collection[str]) -> ScoredQueries:
    """The queries of some tracks in a split, with their ground truth. Raises InputError if it is absent."""
    rows = [row for row in _read(dataset, split) if row[0] in tracks]
    if not rows:
        raise InputError(f"{dataset.root}: split {split} has no query of {', '.join(sorted(tracks))}")
    names, scene_ids, truths = zip(*rows, strict=True)
    return ScoredQueries(dataset.geometry, names, scene_ids, truths)


@lru_cache(maxsize=4)
def _read(dataset: Dataset, split: str) -> tuple[tuple[str, str, Truth], ...]:
    """Track, scene and ground truth of all queries of a split; cached for the last few splits and datasets."""
    return tuple(
        (query.track, recorded.id, recorded.truth_of(query.id))
        for recorded in dataset.split(split, truth=True)
        for query in recorded.queries
    )


def concatenate(*several: ScoredQueries) -> ScoredQueries:
    """Queries of several splits of one dataset, one after another."""
    first = several[0]
    return ScoredQueries(
        first.geometry,
        sum((each.tracks for each in several), ()),
        sum((each.scene_ids for each in several), ()),
        sum((each.truths for each in several), ()),
    )
