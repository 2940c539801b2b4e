"""The methods that learn nothing, side by side: seconds a query of registration and of ICP, in one process.

    python bench/bench_methods.py data/kit1000

Without a folder a tiny dataset is made first. Images are in memory when the clock starts; the first query of each
method, which compiles, is not counted.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import tyro
from measured_dataset import measured_dataset

from baselines.methods import made, method_of
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error

METHODS = ("icp", "registration", "registration-gtvol")
TRACKS = ("snap", "snap-d415", "place")


@dataclass(frozen=True)
class Methods:
    """Measure how long methods take."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; a tiny one is made when absent."""
    queries: int = 20
    """Of each track, at most."""


def main(asked: Methods) -> None:
    """Print the table."""
    with measured_dataset(asked.data) as (dataset, _):
        split = dataset.split("test", truth=True)
        print(f"{dataset.root.name}: seconds a query, mean and largest, and the mean over that of {METHODS[0]}")
        for track in TRACKS:
            reference = None
            for name in METHODS:
                method = method_of(name)
                if track not in method.tracks:
                    continue
                taken = _seconds(dataset, split, name, track, asked.queries)
                reference = taken.mean() if name == METHODS[0] else reference
                ratio = "" if reference is None else f"{taken.mean() / reference:6.1f}x"
                print(f"  {track:10} {name:19} n {len(taken):3} {taken.mean():6.2f} {taken.max():6.2f}{ratio}")


def _seconds(dataset: Dataset, split, name: str, track: str, most: int) -> np.ndarray:
    """(n,) [s]: of each query but the first."""
    method = method_of(name)
    predictor = made(method, dataset, 0)
    taken = []
    for query in islice(split.queries(track), most + 1):
        truth = split.scene(query.scene_id).truth_of(query.id) if method.uses_true_geometry else None
        query.seen  # noqa: B018
        start = time.perf_counter()
        predictor(query, truth)
        taken.append(time.perf_counter() - start)
    return np.array(taken[1:])


if __name__ == "__main__":
    try:
        main(tyro.cli(Methods))
    except Kit1000Error as error:
        raise SystemExit(f"bench_methods: {error}") from error
