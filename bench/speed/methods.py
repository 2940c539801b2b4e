"""Seconds per query of methods, in one process: registration beside ICP.

    python bench/speed/methods.py data/kit1000

Without a folder a tiny dataset is generated first. Images and meshes are in memory when the clock starts. The first
query of each method is not counted, because it compiles.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from baselines.catalog import method_of
from bench.measured import measured_dataset, run, timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.dataset.reader import Dataset
from kit1000.prediction.making import make_predictor

METHODS = ("icp", "registration", "registration-completed", "registration-gtvol")
TRACKS = ("snap", "snap-d415", "place")
COLUMNS = (
    Column("track", "track"),
    Column("method", "method"),
    Column("n", "queries"),
    Column("seconds", "mean, s", 2),
    Column("median", "median", 2),
    Column("largest", "largest", 2),
    Column("ratio", f"times `{METHODS[0]}` of `{TRACKS[0]}`", 1),
)


@dataclass(frozen=True)
class Methods:
    """Time methods."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; without one a tiny dataset is generated."""
    queries: int = 6
    """Most queries of each track, spread evenly over the test split."""
    methods: tuple[str, ...] = METHODS
    """Methods; the others are compared with the first."""
    out: Path | None = None
    """JSON file of the table, such as results/speed-methods.json."""


def main(options: Methods) -> None:
    """Print the table."""
    with measured_dataset(options.data) as (dataset, _):
        measurement = Measurement.begin(dataset)
        table = measurement.table("methods", "Seconds a query", *COLUMNS)
        reference = None
        for track in TRACKS:
            for name in options.methods:
                if track not in method_of(name).tracks:
                    continue
                values, scenes = _timed(dataset, name, track, options.queries)
                seconds = estimate(values, scenes)
                reference = reference or seconds["mean"]
                table.add(
                    track=f"`{track}`",
                    method=f"`{name}`",
                    n=len(values),
                    seconds=seconds,
                    median=seconds["median"],
                    largest=max(values),
                    ratio=seconds["mean"] / reference,
                )
        measurement.report(options.out)


def _timed(dataset: Dataset, name: str, track: str, most: int) -> tuple[list[float], list[str]]:
    """[s] of each query but the first, and the scenes of these queries."""
    method = method_of(name)
    predictor = make_predictor(method, dataset, 0)
    queries = list(dataset.split("test").queries(track))
    count = min(most, len(queries) - 1)
    seconds = []
    chosen = [queries[0], *(queries[1 + i * (len(queries) - 1) // count] for i in range(count))]
    for query in chosen:
        geometry = dataset.geometry.true_geometry(dataset.truth_of(query)) if method.uses_true_geometry else None
        query.image  # noqa: B018 (reads the images)
        seconds.append(timed(lambda query=query, geometry=geometry: predictor(query, geometry))[0])
    return seconds[1:], [query.scene_id for query in chosen[1:]]


if __name__ == "__main__":
    run(main, Methods, __doc__)
