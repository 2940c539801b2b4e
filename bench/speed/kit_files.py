"""CPU seconds of `kit1000 kit` on mesh files of a folder: start, reading, kit, preview and report.

    python bench/speed/kit_files.py PARTS

Each file is one command, as for a user. A first command, which is not counted, compiles modules and loops.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from tqdm import tqdm

from bench.measured import run, spread
from benchmark.measurements import Column, Measurement, estimate
from kit1000.parts.files.read import mesh_files

UNUSUAL = ("PYTHONDONTWRITEBYTECODE", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
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
    paths = spread(found, options.files or len(found))
    seconds: dict[str, list[float]] = {MADE: [], REFUSED: []}
    command(paths[0])  # numba compiles on the first
    for path in tqdm(paths, desc="files", disable=None):
        spent, outcome = command(path)
        seconds[outcome].append(spent)
    measurement = Measurement.begin()
    measurement.setting["command"] = measurement.setting["command"].replace(str(options.parts), "PARTS")
    table = measurement.table("files", f"CPU seconds of `kit1000 kit`, {len(paths)} mesh files", *COLUMNS)
    for outcome, values in seconds.items():
        if values:
            table.add(outcome=outcome, **_summary(values))
    measurement.report(options.out)


def command(path: Path) -> tuple[float, str]:
    """The CPU seconds of the command on one file, and whether it makes a kit: MADE or REFUSED."""
    with tempfile.TemporaryDirectory() as folder:
        line = [sys.executable, "-m", "kit1000", "kit", str(path), "--out", str(Path(folder) / "kit")]
        before = _seconds_of_children()
        done = subprocess.run(line, capture_output=True, check=False, env=_environment())
        return _seconds_of_children() - before, REFUSED if done.returncode else MADE


def _environment() -> dict[str, str]:
    """The environment of a user: libraries choose their threads, and compiled modules stay for the next command."""
    return {name: value for name, value in os.environ.items() if name not in UNUSUAL}


def _seconds_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _summary(values: list[float]) -> dict[str, object]:
    seconds, largest = estimate(values), max(values)
    quantiles = {"median": seconds["median"], "late": np.quantile(values, 0.9), "largest": largest}
    return {"n": len(values), "seconds": seconds, **quantiles, "ratio": largest / seconds["median"]}


if __name__ == "__main__":
    run(main, KitFiles, __doc__)
