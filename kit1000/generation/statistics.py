"""Statistics of scenes, parts and kits: counts and histograms, made shard by shard and added up.

Statistics are nested dicts with integers at the leaves, so their sums are the same in any order. A bin is named by its
edges, and the lower edge belongs to it: "5-15", and "45+" for 45 and above.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from kit1000.dataset.json_rows import Row, pose_of
from kit1000.dataset.scene_data import SceneTruth
from kit1000.queries.tracks import CURVES

TILT_DEG = (0, 5, 15, 30, 45)
VISIBLE_PERCENT = (0, 50, 60, 70, 80, 90, 100)
PIXELS = (0, 800, 1600, 3200, 6400)
SLOT_ANGLE_DEG = (0, 20, 40, 55, 70)
SLOT_VISIBLE_PERCENT = (0, 15, 30, 50, 75, 100)
KEYEDNESS_DEG = (0, 5, 10, 15, 20, 30, 45, 90)
FREE_AXIS = "any turn seats"  # bin name of the keyedness of a slot with a free axis
CROWDED, UNCROWDED = "pushed together", "apart"  # bin names of scenes by how near their parts are to each other

Statistics = dict[str, Any]


def scene_statistics(truths: Iterable[SceneTruth]) -> Statistics:
    """The statistics of some scenes; empty without any. `add_up` sums those of several calls."""
    return add_up(_one_scene(truth) for truth in truths)


def part_statistics(parts: Iterable[Row], kits: Iterable[Row]) -> Statistics:
    """The statistics of some parts and their kits, given as rows of their tables."""
    rows = list(parts)
    if not rows:
        return {}
    return {
        "pairs": len(rows),
        "part_family": _counts(row["family"] for row in rows),
        "symmetry": _counts(row["symmetry"]["name"] for row in rows),
        "keyedness_deg": _counts(_keyedness(kit.get("keyedness")) for kit in kits),
    }


def add_up(terms: Iterable[Mapping[str, Any]]) -> Statistics:
    """The sum of statistics, leaf by leaf; a missing leaf counts as 0."""
    total: Statistics = {}
    for statistics in terms:
        for key, value in statistics.items():
            if isinstance(value, Mapping):
                total[key] = add_up([total.get(key, {}), value])
            else:
                total[key] = total.get(key, 0) + value
    return total


def bin_name(value: float, edges: tuple[int, ...]) -> str:
    """The name of the bin of a number; 100, the last edge of a percentage, belongs to the bin below it."""
    place = bisect_right(edges, value)
    if edges[-1] == 100 and place == len(edges):  # no percentage is above 100
        place -= 1
    return f"{edges[place - 1]}+" if place == len(edges) else f"{edges[place - 1]}-{edges[place]}"


def track_of(query_id: str) -> str:
    """The track of a query, from its id."""
    if query_id.startswith(f"{CURVES}-"):
        return CURVES
    return re.sub(r"^.*?-p\d+-", "", query_id)


def _one_scene(truth: SceneTruth) -> Statistics:
    parts = truth.parts
    return {
        "scenes": 1,
        "crowding": {CROWDED if truth.crowded else UNCROWDED: 1},
        "parts": len(parts),
        "kits": {str(len(parts)): 1},
        "family": _counts(row["family"] for row in parts),
        "rest_mode": _counts(row["rest_mode"] for row in parts),
        "tilt_deg": _counts(bin_name(_tilt_deg(row), TILT_DEG) for row in parts),
        "visible_percent": _counts(bin_name(100 * row["visible"], VISIBLE_PERCENT) for row in parts),
        "pixels": _counts(bin_name(row["pixels"], PIXELS) for row in parts),
        "slot_angle_deg": _counts(bin_name(np.degrees(row["slot_angle"]), SLOT_ANGLE_DEG) for row in parts),
        "slot_visible_percent": _counts(bin_name(100 * row["slot_visible"], SLOT_VISIBLE_PERCENT) for row in parts),
        "unseen": _counts(row["unseen"] for row in parts if row["unseen"] is not None),
        "queries": _counts(map(track_of, truth.queries)),
    }


def _tilt_deg(row: Row) -> float:
    """Angle [deg] between the kit's axis and up, less 1e-6, so that a tilt of 45 degrees is in the bin below."""
    up = pose_of(row["world_from_kit"]).rotate([0.0, 0.0, 1.0])
    return max(float(np.degrees(np.arctan2(np.hypot(up[0], up[1]), up[2]))) - 1e-6, 0.0)


def _keyedness(angle: float | None) -> str:
    return FREE_AXIS if angle is None else bin_name(float(np.degrees(angle)) + 1e-6, KEYEDNESS_DEG)


def _counts(names: Iterable[str]) -> dict[str, int]:
    return dict(sorted(Counter(names).items()))
