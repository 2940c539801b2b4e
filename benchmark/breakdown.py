"""Groups of queries that share a property: rest mode, tilt, kits, crowding, family, visible share, noise, symmetry."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from benchmark.per_query import PerQuery
from benchmark.protocol import Protocol

TITLES = {
    "rest_mode": "Rest mode of the part",
    "tilt": "Tilt of the slot, °",
    "kits": "Kits in the assembly",
    "parts": "Parts of the scene",
    "family": "Family of the part in training",
    "visible": "Visible share of the part",
    "noise": "Noise of the image, px of disparity",
    "symmetry": "Goals of the slot",
}
"""The properties and their titles on pages, in order."""


def groups(rows: PerQuery, protocol: Protocol) -> dict[str, dict[str, np.ndarray]]:
    """For each property, the masks (n,) of the rows in each of its groups; a group without rows is left out."""
    labels = {
        "rest_mode": rows.rest_mode,
        "tilt": binned(rows.tilt_deg, protocol.breakdown["tilt_deg"]),
        "kits": rows.kits.astype(str),
        "parts": np.where(rows.crowded, "pushed together", "apart"),
        "family": np.where(rows.held_out, "held out", "seen"),
        "visible": binned(rows.visible, protocol.breakdown["visible"]),
    }
    if "noise_px" in protocol.breakdown and (rows.noise_px > 0).any():
        labels["noise"] = binned(rows.noise_px, protocol.breakdown["noise_px"])
    labels["symmetry"] = rows.symmetry
    return {key: {name: column == name for name in _in_order(column)} for key, column in labels.items()}


def _in_order(names: np.ndarray) -> list[str]:
    """Each name once: those of bins by their lower end, others by the alphabet."""
    return sorted(map(str, np.unique(names)), key=group_order)


def group_order(name: str) -> tuple[float, str]:
    """Sort key of a group: bins such as 5-15 or 30+ by their lower end, others by name."""
    number = re.match(r"[\d.]+", name)
    return float(number[0]) if number else 0.0, name


def binned(values: np.ndarray, edges: Sequence[float]) -> np.ndarray:
    """The bin of each value, by name: `5-15` holds 5 and not 15; the last bin, `30+`, is open. (n,) -> (n,) str."""
    names = [f"{low:g}-{high:g}" for low, high in pairwise(edges)] + [f"{edges[-1]:g}+"]
    bins = np.searchsorted(edges, values, side="right") - 1
    return np.array(names)[np.maximum(bins, 0)]
