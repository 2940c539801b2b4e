"""Measures of single stages as `python -m benchmark table2 --components FILE` reads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmark.intervals import ENDS, bootstrap_means
from benchmark.report import json_text
from benchmark.table2 import read_components
from kit1000.files import write_bytes


def add_components(
    path: Path, component: str, measures: Mapping[str, Sequence[float]], clusters: Sequence[str], digits: int = 3
) -> None:
    """Add the mean of each measure to a file; a measure that the file has of the same component is replaced.

    Args:
        path: JSON file; need not exist.
        component: the stage, such as "segmentation, d415"; its method is part of each measure's label.
        measures: n values by "method: measure".
        clusters: n labels, values of equal labels are not independent; such as the assembly of each.
        digits: of the numbers.
    """
    rows = read_components(path) if path.exists() else []
    for name, values in measures.items():
        label, _, measure = name.partition(": ")
        draws = bootstrap_means(np.asarray(values, float)[:, None], [clusters])[:, 0]
        new = {
            "component": component,
            "label": label,
            "measure": measure,
            "value": round(float(np.mean(values)), digits),
            "interval": [round(float(end), digits) for end in np.quantile(draws, ENDS)],
            "n": len(values),
        }
        same = ("component", "label", "measure")
        rows = [row for row in rows if any(row[key] != new[key] for key in same)] + [new]
    write_bytes(path, json_text(rows).encode())
