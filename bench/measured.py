"""What the programs of bench/ share: the dataset, the clock, the command line, and measures for Table II."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
import tyro

from benchmark.intervals import ENDS, bootstrap_means
from benchmark.report import json_text
from benchmark.table2 import read_components
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.files import write_bytes
from kit1000.generation.build import generate
from kit1000.generation.presets import preset

Made = TypeVar("Made")
Options = TypeVar("Options")
Item = TypeVar("Item")
DECIMALS = 3  # of the measures for Table II


def run(main: Callable[[Options], None], options: type[Options], description: str | None) -> None:
    """Call `main` with the options of the command line; an error of ours ends the program with one line."""
    try:
        main(tyro.cli(options, description=description))
    except Kit1000Error as error:
        raise SystemExit(f"error: {error}") from error


@contextmanager
def measured_dataset(folder: Path | None) -> Iterator[tuple[Dataset, Path]]:
    """The dataset of a folder, or a new tiny one when None, and a temporary folder that is deleted afterwards."""
    with tempfile.TemporaryDirectory() as temporary:
        if folder is None:
            folder = Path(temporary) / "tiny"
            generate(preset("tiny"), folder, workers=1)
        yield Dataset(folder), Path(temporary)


def spread(items: Sequence[Item], most: int) -> list[Item]:
    """At most `most` of the items, evenly spread over them."""
    count = min(most, len(items))
    return [items[i * len(items) // count] for i in range(count)]


def timed(work: Callable[[], Made], clock: Callable[[], float] = time.perf_counter) -> tuple[float, Made]:
    """The seconds that work takes, and what it returns.

    clock: `time.process_time` counts processor time, which other programs hardly lengthen.
    """
    start = clock()
    made = work()
    return clock() - start, made


def add_components(
    path: Path, component: str, measures: Mapping[str, Sequence[float]], clusters: Sequence[str]
) -> None:
    """Add the mean of each measure to the JSON file that `python -m benchmark table2 --components` reads.

    Args:
        path: JSON file; need not exist. A measure that it already holds for the same component is replaced.
        component: the stage, such as "segmentation, d415"; its method is part of each measure's label.
        measures: n values by "method: measure".
        clusters: n labels, such as the assembly of each value; values with equal labels are not independent.
    """
    rows = read_components(path) if path.exists() else []
    for name, values in measures.items():
        label, _, measure = name.partition(": ")
        draws = bootstrap_means(np.asarray(values, float)[:, None], [clusters])[:, 0]
        new = {
            "component": component,
            "label": label,
            "measure": measure,
            "value": round(float(np.mean(values)), DECIMALS),
            "interval": [round(float(end), DECIMALS) for end in np.quantile(draws, ENDS)],
            "n": len(values),
        }
        same = ("component", "label", "measure")
        rows = [row for row in rows if any(row[key] != new[key] for key in same)] + [new]
    write_bytes(path, json_text(rows).encode())
