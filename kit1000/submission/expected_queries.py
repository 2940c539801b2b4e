"""The queries of a dataset that a submission should predict, with pivots and guesses. No ground truth is read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path

import numpy as np

from kit1000.dataset.reader import SPLIT_QUERIES, Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.pose import Pose
from kit1000.queries.tracks import CURVES
from kit1000.values import Query

SPLITS = tuple(name for name in SPLIT_QUERIES if name != CURVES)


@dataclass(frozen=True, eq=False)
class ExpectedQueries:
    """The n queries of some splits of a dataset, with the data that a check compares predictions with."""

    dataset_id: str
    checksum: str | None
    """Checksum of the files of this copy; None if dataset.json has none."""
    query_ids: tuple[str, ...]
    tracks: tuple[str, ...]
    """(n,) track of each query."""
    splits: tuple[str, ...]
    """(n,) split of each query: train, val, test or curves."""
    required: np.ndarray
    """(n,) bool: whether the checked split requires a prediction."""
    pivots: np.ndarray
    """(n, 3) [m] world."""
    guessed_positions: np.ndarray
    """(n, 3) [m] world: the pivot under the user's initial guess for this part; NaN if there is none."""
    guessed_rotations: np.ndarray
    """(n, 4) wxyz of the initial guess; NaN if there is none."""
    public_id: str | None = None
    """The id of the public dataset whose withheld ground truth this folder has."""
    cameras: Callable[[np.ndarray], Pose] | None = None
    """world_from_camera (k,) of the images of some queries, by their indices (k,); None if unknown."""

    @cached_property
    def index(self) -> dict[str, int]:
        """The index of each query id."""
        return {query_id: i for i, query_id in enumerate(self.query_ids)}

    def scene_part(self, i: int) -> str:
        """Scene and part of a query: test-s0007-p2."""
        return "-".join(self.query_ids[i].split("-")[:3])


def read_expected_queries(data: Path, split: str, query_ids: Iterable[str]) -> ExpectedQueries:
    """Read the queries of a split, and of other splits that occur in `query_ids`. Raises InputError.

    The result is cached for a dataset with a checksum.
    """
    if split not in SPLITS:
        raise InputError(f"no split {split!r}; {did_you_mean(split, SPLITS)}there are {', '.join(SPLITS)}")
    dataset = Dataset(data)
    folder, checksum = SPLIT_QUERIES[split][0], dataset.summary.get("checksum")
    prefixes = {query_id.partition("-")[0].strip().lower() for query_id in query_ids}
    others = [other for other in ("train", "val", "test") if other in prefixes and other != folder]
    read = _cached_read if checksum else _read_queries
    return read(dataset.root, checksum, split, (folder, *others))


def _read_queries(root: Path, checksum: str | None, split: str, folders: tuple[str, ...]) -> ExpectedQueries:
    dataset = Dataset(root)
    pairs = list(_iterate_queries(dataset, folders))
    queries = [query for _, query in pairs]
    if not queries:
        raise InputError(f"{root}: no query of split {split}: dataset.json lists its scenes in 'shards'")
    pivots = np.array([query.pivot for query in queries]).reshape(-1, 3)
    guessed_positions, guessed_rotations = _read_guesses(queries, pivots)
    required = [_is_required(query_split, query, split) for query_split, query in pairs]
    return ExpectedQueries(
        dataset.id,
        checksum,
        tuple(query.id for query in queries),
        tuple(query.track for query in queries),
        tuple(query_split for query_split, _ in pairs),
        np.array(required, dtype=bool),
        pivots,
        guessed_positions,
        guessed_rotations,
        dataset.public_id,
        partial(_read_cameras, dataset, pairs),
    )


_cached_read = lru_cache(maxsize=4)(_read_queries)


def _iterate_queries(dataset: Dataset, folders: Sequence[str]) -> Iterator[tuple[str, Query]]:
    """All queries with the name of their split; those of the curves follow those of the test split."""
    for folder in folders:
        if not dataset.shards(folder):
            continue
        for query in dataset.split("test-all" if folder == "test" else folder).queries():
            yield folder, query
        if folder == "test" and dataset.summary["config"]["curve_scenes"]:
            for query in dataset.split(CURVES).queries():
                yield CURVES, query


def _read_cameras(dataset: Dataset, pairs: Sequence[tuple[str, Query]], index: np.ndarray) -> Pose:
    """(k,) world_from_camera of some queries, by their indices (k,); no image is read."""
    shards = {folder: dataset.shards("test" if folder == CURVES else folder) for folder in {name for name, _ in pairs}}
    read: dict[tuple[str, str], Pose] = {}
    for folder, query in (pairs[i] for i in index.tolist()):
        file = dataset.observation_file(shards[folder][query.scene_id])
        key = query.scene_id, query.sensor
        if key not in read:
            read[key] = file.camera_pose(*key)
    return Pose.stack([read[pairs[i][1].scene_id, pairs[i][1].sensor] for i in index.tolist()])


def _is_required(query_split: str, query: Query, split: str) -> bool:
    """Whether a submission for a split should predict a query; the curves belong to the test split."""
    folder = SPLIT_QUERIES[split][0]
    return (query_split == folder and (query.drawn or split != "test")) or (query_split == CURVES and folder == "test")


def _read_guesses(queries: list[Query], pivots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) [m] pivots under the initial guesses, of another query of the same part if need be; (n, 4) rotations."""
    with_guess = [i for i, query in enumerate(queries) if query.guess is not None]
    rotations, positions = np.full((len(queries), 4), np.nan), np.full((len(queries), 3), np.nan)
    guesses = Pose.stack([guess for query in queries if (guess := query.guess) is not None])
    rotations[with_guess], positions[with_guess] = guesses.wxyz, guesses.apply(pivots[with_guess])
    by_part = {(queries[i].scene_id, queries[i].part): i for i in with_guess}
    for i, query in enumerate(queries):
        if query.guess is None and (query.scene_id, query.part) in by_part:
            positions[i] = positions[by_part[query.scene_id, query.part]]
    return positions, rotations
