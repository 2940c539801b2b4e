"""From one row per query to a summary: means with intervals, rates, groups of queries, curves, listed cases.

Every result is a plain JSON value; null if nothing was measured.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from benchmark import quantities
from benchmark.curves import curve_table
from benchmark.evaluate import PerQuery
from benchmark.intervals import ENDS, bootstrap_means, rate_interval
from benchmark.protocol import Protocol
from benchmark.quantities import Quantity
from kit1000.queries.tracks import CURVES

Row = dict[str, Any]
Clusterings = Sequence[np.ndarray]


def summarise(rows: PerQuery, protocol: Protocol, rotation_only: bool) -> Row:
    """`tracks`, `breakdown`, `curves` and `curve_scenes` of scores.json.

    `rotation_only`: the method predicts no positions.
    """
    rows = _numbered(rows)
    tracks = {track: rows.of_track(track) for track in rows.tracks if track != CURVES}
    curves = rows.of_track(CURVES)
    left = (curves.quantities[each.key] for each in (quantities.POSITION, quantities.ROTATION))
    return {
        "tracks": {track: track_summary(own, protocol, rotation_only) for track, own in tracks.items()},
        "breakdown": {track: breakdown(own, protocol, rotation_only) for track, own in tracks.items()},
        "curves": curve_table(curves.query_id.tolist(), *left) if len(curves) else None,
        "curve_scenes": len(np.unique(curves.scene_id)) or None,
    }


def _numbered(rows: PerQuery) -> PerQuery:
    """The same rows with numbers for assemblies and parts: resampled faster than names, with the same result."""
    assemblies, parts = (np.unique(ids, return_inverse=True)[1] for ids in rows.clusterings)
    return replace(rows, assembly_id=assemblies, part_id=parts)


def track_summary(rows: PerQuery, protocol: Protocol, rotation_only: bool) -> Row:
    """The summary of a track."""
    far = beyond(rows, protocol)
    columns = {**rows.quantities, quantities.BEYOND.key: far}
    return {
        "n": len(rows),
        "coverage": float(rows.covered.mean()),
        **estimates(quantities.QUANTITIES, columns, rows.clusterings, protocol, rotation_only),
        "loose_fits": None if rotation_only else int((rows.quantities[quantities.SEATED.key] & far).sum()),
        "exact_tests": int(rows.exact_test.sum()),
        "exact_disagreements": int(rows.exact_disagreement.sum()),
        "histograms": {name: histogram(columns[name], edges) for name, edges in protocol.histograms.items()},
        "risk_coverage": risk_coverage(rows, protocol.risk_points, rotation_only),
        **_cases(rows, protocol.listed, rotation_only),
    }


def breakdown(rows: PerQuery, protocol: Protocol, rotation_only: bool) -> Row:
    """The headline quantities of every group of queries."""
    return {
        title: {name: _group(rows[inside], protocol, rotation_only) for name, inside in named.items()}
        for title, named in groups(rows, protocol).items()
    }


def _group(rows: PerQuery, protocol: Protocol, rotation_only: bool) -> Row:
    shown = quantities.shown_in("breakdown")
    return {"n": len(rows)} | estimates(shown, rows.quantities, rows.clusterings, protocol, rotation_only)


def beyond(rows: PerQuery, protocol: Protocol) -> np.ndarray:
    """(n,) bool: predictions so far off in position or in rotation that they count as another pose."""
    limits, measured = protocol.thresholds, rows.quantities
    far = measured[quantities.POSITION.key] > limits["beyond_mm"]
    return far | (measured[quantities.ROTATION.key] > limits["beyond_deg"])


def estimates(
    of: Iterable[Quantity],
    columns: Mapping[str, np.ndarray],
    clusterings: Clusterings,
    protocol: Protocol,
    rotation_only: bool,
) -> dict[str, Row | None]:
    """Means and rates of some quantities, by key; None if nothing was measured.

    Args:
        of: the quantities.
        columns: their values (n,), by key.
        clusterings: each (n,) labels; queries of equal labels are resampled together.
        protocol: for the bootstrap.
        rotation_only: whether the method predicts no positions.
    """
    of = tuple(of)
    rates = {
        each.key: None if rotation_only and each.needs_position else _rate(columns[each.key], clusterings)
        for each in of
        if each.rate
    }
    return means({each.key: columns[each.key] for each in of if not each.rate}, clusterings, protocol) | rates


def means(columns: Mapping[str, np.ndarray], clusterings: Clusterings, protocol: Protocol) -> dict[str, Row | None]:
    """Mean, median and interval of columns (n,), over the rows in which they were measured; None if nothing was."""
    complete = [name for name, column in columns.items() if np.isfinite(column).all()]
    found: dict[str, Row | None] = dict.fromkeys(columns)
    if complete:  # the same draws serve all of them
        stacked = np.stack([columns[name] for name in complete], axis=1)
        found |= zip(complete, _mean_rows(stacked, clusterings, protocol), strict=True)
    for name, column in columns.items():
        known = np.isfinite(column)
        if name not in complete and known.any():
            (found[name],) = _mean_rows(column[known, None], [labels[known] for labels in clusterings], protocol)
    return found


def _mean_rows(columns: np.ndarray, clusterings: Clusterings, protocol: Protocol) -> list[Row]:
    """Mean, median and interval of each of m columns (n, m)."""
    drawn = bootstrap_means(columns, clusterings, protocol.draws, protocol.seed)
    ends, medians = np.quantile(drawn, ENDS, axis=0), np.median(columns, axis=0)
    numbers = zip(columns.mean(axis=0).tolist(), medians.tolist(), ends.T.tolist(), strict=True)
    return [{"mean": mean, "median": median, "ci95": ci95} for mean, median, ci95 in numbers]


def _rate(passed: np.ndarray, clusterings: Clusterings) -> Row:
    """The share of True in (n,) bool, with its interval."""
    return {"rate": int(passed.sum()) / len(passed), "ci95": list(rate_interval(passed, clusterings))}


def histogram(values: np.ndarray, edges: Sequence[float]) -> Row | None:
    """Counts between edges; the last bin is open, so its upper edge is null. values: (n,), NaN if not measured."""
    if np.isnan(values).any():
        return None
    counts, _ = np.histogram(values, [*edges, np.inf])
    return {"edges": [*edges, None], "counts": counts.tolist()}


def risk_coverage(rows: PerQuery, points: int, rotation_only: bool) -> Row:
    """Mean MSSD and seated rate of the most confident predictions, from 1/points of all queries up to all.

    Queries of equal confidence enter with their mean, so that their order does not matter.
    """
    shares = np.arange(1, points + 1) / points
    row: Row = {"coverage": shares.tolist()}
    for quantity in (quantities.MSSD, quantities.SEATED):
        risk = _among_first(rows.quantities[quantity.key], rows.confidence, shares)
        row[quantity.key] = None if rotation_only else risk.tolist()
    return row


def _among_first(values: np.ndarray, confidence: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Means over the given shares (k,) of the queries (n,), most confident first."""
    _, group = np.unique(-confidence, return_inverse=True)
    counts = np.bincount(group)
    means = np.bincount(group, values.astype(float)) / counts
    totals = np.concatenate([[0.0], np.cumsum(means * counts)])
    ends = np.concatenate([[0], np.cumsum(counts)])
    first = np.maximum(np.ceil(shares * len(values) - 1e-9), 1)
    return np.interp(first, ends, totals) / first


def _cases(rows: PerQuery, count: int, rotation_only: bool) -> Row:
    """The queries of largest MSSD, and those nearest to its median; of the rotation error without positions."""
    errors = rows.quantities[(quantities.ROTATION if rotation_only else quantities.MSSD).key]
    worst = np.lexsort((rows.query_id, -np.round(errors, 9)))[:count]
    middle = np.lexsort((rows.query_id, np.round(np.abs(errors - np.median(errors)), 9)))[:count]
    return {
        "worst": [_case(rows, i, rotation_only) for i in worst.tolist()],
        "middle": [_case(rows, i, rotation_only) for i in middle.tolist()],
    }


def _case(rows: PerQuery, i: int, rotation_only: bool) -> Row:
    """The quantities of a single query."""
    case: Row = {"query_id": str(rows.query_id[i])}
    for quantity in quantities.shown_in("cases"):
        value = rows.quantities[quantity.key][i].item()
        unknown = np.isnan(value) or (rotation_only and quantity.needs_position)
        case[quantity.key] = None if unknown else value
    return case


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
