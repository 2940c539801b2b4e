"""Groups of queries that are alike in one thing: rest, tilt, kits, family, what is seen, symmetry, loose fit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from benchmark.per_query import PerQuery
from benchmark.protocol import Protocol


def groups(rows: PerQuery, protocol: Protocol) -> dict[str, dict[str, np.ndarray]]:
    """For each thing, which rows are in which of its groups: masks (n,); a group without rows is left out."""
    labels = {
        "rest_mode": rows.rest_mode,
        "tilt": binned(rows.tilt_deg, protocol.breakdown["tilt_deg"]),
        "kits": rows.kits.astype(str),
        "family": np.where(rows.held_out, "held out", "seen"),
        "visible": binned(rows.visible, protocol.breakdown["visible"]),
        "symmetry": rows.symmetry,
        "loose": np.where(rows.loose, "yes", "no"),
    }
    return {thing: {name: found == name for name in _in_order(found)} for thing, found in labels.items()}


def _in_order(names: np.ndarray) -> list[str]:
    """Each name once: those of bins by their lower end, others by the alphabet."""
    return sorted(map(str, np.unique(names)), key=lambda name: (_lower_end(name), name))


def _lower_end(name: str) -> float:
    number = re.match(r"[\d.]+", name)
    return float(number[0]) if number else 0.0


def binned(values: np.ndarray, edges: Sequence[float]) -> np.ndarray:
    """The bin of each value, by name: `5-15` holds 5 and not 15; the last bin, `30+`, is open. (n,) -> (n,) str."""
    names = [f"{low:g}-{high:g}" for low, high in pairwise(edges)] + [f"{edges[-1]:g}+"]
    bins = np.searchsorted(edges, values, side="right") - 1
    return np.array(names)[np.maximum(bins, 0)]
