"""Seconds of `kit1000 kit` on mesh files, such as CAD parts of others: reading, kit, preview and report.

python bench/speed/kit_files.py PARTS
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from bench.speed.timing import timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.errors import InputError, Kit1000Error
from kit1000.export.own_part import InexactKit, make_kit_from_file
from kit1000.parts.files.sources import mesh_files

MADE, REFUSED = "kit made", "refused"
COLUMNS = (
    Column("outcome", "outcome"),
    Column("n", "files"),
    Column("seconds", "CPU seconds, mean", 2),
    Column("median", "median", 2),
    Column("late", "90th percentile", 2),
    Column("largest", "largest", 2),
    Column("ratio", "largest / median", 1),
)


@dataclass(frozen=True)
class KitFiles:
    """Time the kits of mesh files, with the defaults of `kit1000 kit`."""

    parts: tyro.conf.Positional[Path]
    """Folder of mesh files."""
    files: int | None = None
    """Most files, spread evenly over the folder; all by default."""
    out: Path | None = None
    """JSON file of the table, such as results/speed-kit-files.json."""


def main(options: KitFiles) -> None:
    """Print the table."""
    found = mesh_files(options.parts)
    count = min(options.files or len(found), len(found))
    paths = [found[i * len(found) // count] for i in range(count)]
    _outcome(paths[0])  # numba compiles on the first
    seconds: dict[str, list[float]] = {MADE: [], REFUSED: []}
    for path in paths:
        spent, outcome = timed(lambda path=path: _outcome(path), time.process_time)
        seconds[outcome].append(spent)
    measurement = Measurement.begin()
    measurement.setting["command"] = measurement.setting["command"].replace(str(options.parts), "PARTS")
    table = measurement.table("files", f"Seconds of `kit1000 kit`, {len(paths)} mesh files", *COLUMNS)
    for outcome, values in seconds.items():
        if values:
            table.add(outcome=outcome, **_summary(values))
    measurement.report(options.out)


def _outcome(path: Path) -> str:
    """Whether the command makes a kit of a file."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            make_kit_from_file(path, Path(folder))
        except (InputError, InexactKit):
            return REFUSED
    return MADE


def _summary(values: list[float]) -> dict[str, object]:
    seconds, largest = estimate(values), max(values)
    quantiles = {"median": seconds["median"], "late": np.quantile(values, 0.9), "largest": largest}
    return {"n": len(values), "seconds": seconds, **quantiles, "ratio": largest / seconds["median"]}


if __name__ == "__main__":
    try:
        main(tyro.cli(KitFiles))
    except Kit1000Error as error:
        raise SystemExit(f"kit_files: {error}") from error
