"""Seconds per query of the methods without learning, registration and ICP, in one process.

    python bench/speed/methods.py data/kit1000

Without a folder a tiny dataset is generated first. Images and meshes are in memory when the clock starts; the first
query of each method, which compiles, is not counted.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import tyro

from baselines.catalog import method_of
from bench.measured_dataset import measured_dataset
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.prediction.making import make_predictor

METHODS = ("icp", "registration", "registration-gtvol")
TRACKS = ("snap", "snap-d415", "place")


@dataclass(frozen=True)
class Methods:
    """Time methods."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    queries: int = 20
    """Most queries of each track."""


def main(options: Methods) -> None:
    """Print the table."""
    with measured_dataset(options.data) as (dataset, _):
        print(f"{dataset.root.name}: seconds per query, mean and largest, and the mean relative to {METHODS[0]}")
        for track in TRACKS:
            reference = None
            for name in METHODS:
                method = method_of(name)
                if track not in method.tracks:
                    continue
                seconds = _timed(dataset, name, track, options.queries)
                reference = seconds.mean() if name == METHODS[0] else reference
                ratio = "" if reference is None else f"{seconds.mean() / reference:6.1f}x"
                print(f"  {track:10} {name:19} n {len(seconds):3} {seconds.mean():6.2f} {seconds.max():6.2f}{ratio}")


def _timed(dataset: Dataset, name: str, track: str, most: int) -> np.ndarray:
    """(n,) [s] of each query but the first."""
    method = method_of(name)
    predictor = make_predictor(method, dataset, 0)
    seconds = []
    for query in islice(dataset.split("test").queries(track), most + 1):
        geometry = dataset.geometry.true_geometry(dataset.truth_of(query)) if method.uses_true_geometry else None
        query.image  # noqa: B018 (reads the images)
        start = time.perf_counter()
        predictor(query, geometry)
        seconds.append(time.perf_counter() - start)
    return np.array(seconds[1:])


if __name__ == "__main__":
    try:
        main(tyro.cli(Methods))
    except Kit1000Error as error:
        raise SystemExit(f"methods: {error}") from error
