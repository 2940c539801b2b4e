"""What a dataset asks, as a check needs it: ids, and roughly where every part belongs. No truth is read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from kit1000.dataset.reader import WANTED, Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.pose import Pose
from kit1000.tracks import CURVES
from kit1000.values import Query

SPLITS = tuple(name for name in WANTED if name != CURVES)


@dataclass(frozen=True, eq=False)
class Asked:
    """The queries of a dataset, n of them, and what a submission should answer."""

    dataset_id: str
    checksum: str | None
    """Of the bytes of this copy; None where it is not told."""
    query_ids: tuple[str, ...]
    tracks: tuple[str, ...]
    """(n,) of each query."""
    splits: tuple[str, ...]
    """(n,) train, val, test or curves."""
    wanted: np.ndarray
    """(n,) bool: asked by the split that is checked."""
    pivots: np.ndarray
    """(n, 3) [m] world."""
    homes: np.ndarray
    """(n, 3) [m] world: where a person guesses that the pivot belongs; NaN where nobody says."""
    guesses: np.ndarray
    """(n, 4) wxyz of the guess; NaN where there is none."""

    @cached_property
    def index(self) -> dict[str, int]:
        """Where each query stands."""
        return {query_id: i for i, query_id in enumerate(self.query_ids)}

    @cached_property
    def _loosely(self) -> dict[str, str]:
        return {_loose(query_id): query_id for query_id in self.query_ids}

    @cached_property
    def _by_part(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for query_id in self.query_ids:
            found.setdefault(_part(query_id), []).append(query_id)
        return found

    def part(self, i: int) -> str:
        """Scene and part of a query: test-s0007-p2."""
        return _part(self.query_ids[i])

    def near(self, query_id: str, thoroughly: bool) -> str | None:
        """The query that was probably meant."""
        text = query_id[:100]
        same = self._loosely.get(_loose(text))
        if same is not None or not thoroughly:
            return same
        of_part = self._by_part.get(_part(_loose_part(text)), [])
        found = get_close_matches(text.lower(), of_part or self.query_ids, n=1, cutoff=0.6 if of_part else 0.85)
        return found[0] if found else None


def asked_of(data: Path, split: str, query_ids: Iterable[str]) -> Asked:
    """Read the queries of a split, and of the other splits that some of the ids name. Raises InputError.

    A dataset that says what its bytes sum up to is read once, however many submissions are checked.
    """
    if split not in SPLITS:
        raise InputError(f"no split {split!r}; {did_you_mean(split, SPLITS)}there are {', '.join(SPLITS)}")
    dataset = Dataset(data)
    folder, checksum = WANTED[split][0], dataset.summary.get("checksum")
    named = {query_id.partition("-")[0].strip().lower() for query_id in query_ids}
    others = [other for other in ("train", "val", "test") if other in named and other != folder]
    read = _remembered if checksum else _read
    return read(dataset.root, checksum, split, (folder, *others))


def _read(root: Path, checksum: str | None, split: str, folders: tuple[str, ...]) -> Asked:
    dataset = Dataset(root)
    held = list(_queries(dataset, folders))
    queries = [query for _, query in held]
    pivots = np.array([query.pivot for query in queries]).reshape(-1, 3)
    homes, guesses = _homes(queries, pivots)
    wanted = [_wanted(of, query, split) for of, query in held]
    return Asked(
        dataset.id,
        checksum,
        tuple(query.id for query in queries),
        tuple(query.track for query in queries),
        tuple(of for of, _ in held),
        np.array(wanted, dtype=bool),
        pivots,
        homes,
        guesses,
    )


_remembered = lru_cache(maxsize=4)(_read)


def _queries(dataset: Dataset, folders: Sequence[str]) -> Iterator[tuple[str, Query]]:
    """All queries with the name of their split, those of the curves behind the others of the test split."""
    for folder in folders:
        if not dataset.shards(folder):
            continue
        for query in dataset.split("test-all" if folder == "test" else folder).queries():
            yield folder, query
        if folder == "test" and dataset.summary["config"]["curve_scenes"]:
            for query in dataset.split(CURVES).queries():
                yield CURVES, query


def _wanted(of: str, query: Query, split: str) -> bool:
    """Whether a submission for a split should answer a query; to the test split belong the curves."""
    folder = WANTED[split][0]
    return (of == folder and (query.drawn or split != "test")) or (of == CURVES and folder == "test")


def _homes(queries: list[Query], pivots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each part belongs, roughly, and how it is turned: by its guess, or where by a guess of the same part."""
    said = [i for i, query in enumerate(queries) if query.guess is not None]
    guesses, homes = np.full((len(queries), 4), np.nan), np.full((len(queries), 3), np.nan)
    stacked = Pose.stack([guess for query in queries if (guess := query.guess) is not None])
    guesses[said], homes[said] = stacked.wxyz, stacked.apply(pivots[said])
    by_part = {(queries[i].scene_id, queries[i].part): i for i in said}
    for i, query in enumerate(queries):
        if query.guess is None and (query.scene_id, query.part) in by_part:
            homes[i] = homes[by_part[query.scene_id, query.part]]
    return homes, guesses


def _loose(query_id: str) -> str:
    """An id without what people and programs change: case, hyphens, leading zeros."""
    return re.sub(r"(?<=[a-z])0+(?=\d)", "", re.sub(r"[\s_./-]+", "-", query_id.strip().lower()))


def _loose_part(query_id: str) -> str:
    return re.sub(r"[\s_./-]+", "-", query_id.strip().lower())


def _part(query_id: str) -> str:
    """Scene and part of a query: test-s0007-p2."""
    return "-".join(query_id.split("-")[:3])
