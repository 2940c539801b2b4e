"""From one row a query to what a table says: means with intervals, rates, histograms, risk-coverage, named cases.

Everything here is a plain JSON value; null stands where nothing was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmark.breakdown import groups
from benchmark.curves import curve_table
from benchmark.intervals import ENDS, bootstrap_means, rate_interval
from benchmark.per_query import PerQuery
from benchmark.protocol import Protocol
from kit1000.tracks import CURVES

Row = dict[str, Any]
ERRORS = ("position_mm", "rotation_deg", "mssd_mm", "penetration_mm", "position_plain_mm", "rotation_plain_deg")
LEADING = ("position_mm", "rotation_deg", "mssd_mm")  # what a breakdown tells
CASE = ("position_mm", "rotation_deg", "mssd_mm", "seated")  # what is told of a single query


def summarised(rows: PerQuery, protocol: Protocol, rotations: bool) -> Row:
    """What scores.json says of the rows: `tracks`, `breakdown` and `curves`; `rotations`: nothing else is predicted."""
    rows = _numbered(rows)
    tracks = {track: rows.of_track(track) for track in rows.tracks if track != CURVES}
    curves = rows.of_track(CURVES)
    return {
        "tracks": {track: track_summary(own, protocol, rotations) for track, own in tracks.items()},
        "breakdown": {track: breakdown(own, protocol, rotations) for track, own in tracks.items()},
        "curves": curve_table(curves.query_id.tolist(), curves.position_mm, curves.rotation_deg)
        if len(curves)
        else None,
    }


def _numbered(rows: PerQuery) -> PerQuery:
    """The same rows with numbers for assemblies: they are resampled quicker than names, and alike."""
    return replace(rows, assembly_id=np.unique(rows.assembly_id, return_inverse=True)[1])


def track_summary(rows: PerQuery, protocol: Protocol, rotations: bool) -> Row:
    """Everything that is said of a track."""
    histograms = {name: histogram(getattr(rows, name), edges) for name, edges in protocol.histograms.items()}
    return {
        "n": len(rows),
        "coverage": float(rows.covered.mean()),
        **means(rows, (*ERRORS, "seconds"), protocol),
        **{name: None if rotations else _rate(getattr(rows, name)) for name in ("seated", "seated_strict")},
        "beyond": None if rotations else _rate(beyond(rows, protocol)),
        "loose_fits": None if rotations else int((rows.seated & beyond(rows, protocol)).sum()),
        "judged": int(rows.judged.sum()),
        "differs": int(rows.differs.sum()),
        "histograms": histograms,
        "risk_coverage": risk_coverage(rows, protocol.risk_points, rotations),
        **_cases(rows, protocol.listed, rotations),
    }


def breakdown(rows: PerQuery, protocol: Protocol, rotations: bool) -> Row:
    """The leading numbers of every group of queries."""
    return {
        thing: {name: _group(rows[inside], protocol, rotations) for name, inside in named.items()}
        for thing, named in groups(rows, protocol).items()
    }


def _group(rows: PerQuery, protocol: Protocol, rotations: bool) -> Row:
    return {"n": len(rows), **means(rows, LEADING, protocol), "seated": None if rotations else _rate(rows.seated)}


def beyond(rows: PerQuery, protocol: Protocol) -> np.ndarray:
    """(n,) bool: which answers are so far off in position or in rotation that they count as another pose."""
    limits = protocol.thresholds
    return (rows.position_mm > limits["beyond_mm"]) | (rows.rotation_deg > limits["beyond_deg"])


def means(rows: PerQuery, names: Sequence[str], protocol: Protocol) -> dict[str, Row | None]:
    """Mean, median and interval of some columns, over the rows where they were measured; None where nothing was."""
    columns = {name: getattr(rows, name) for name in names}
    whole = [name for name, column in columns.items() if np.isfinite(column).all()]
    told: dict[str, Row | None] = dict.fromkeys(names)
    if whole:  # the same draws serve all of them
        told |= zip(whole, _mean_rows(np.stack([columns[name] for name in whole], axis=1), rows, protocol), strict=True)
    for name in names:
        known = np.isfinite(columns[name])
        if name not in whole and known.any():
            (told[name],) = _mean_rows(columns[name][known, None], rows[known], protocol)
    return told


def _mean_rows(columns: np.ndarray, rows: PerQuery, protocol: Protocol) -> list[Row]:
    """Mean, median and interval of columns (n, m) of the rows."""
    drawn = bootstrap_means(columns, rows.assembly_id, protocol.draws, protocol.seed)
    ends, medians = np.quantile(drawn, ENDS, axis=0), np.median(columns, axis=0)
    stated = zip(columns.mean(axis=0).tolist(), medians.tolist(), ends.T.tolist(), strict=True)
    return [{"mean": mean, "median": median, "ci95": ci95} for mean, median, ci95 in stated]


def _rate(passed: np.ndarray) -> Row:
    """The share of trues and its interval."""
    count, n = int(passed.sum()), len(passed)
    return {"rate": count / n, "ci95": list(rate_interval(count, n))}


def histogram(values: np.ndarray, edges: Sequence[float]) -> Row | None:
    """Counts between edges; the last bin is open, so its upper edge is null. values: (n,), NaN when not measured."""
    if np.isnan(values).any():
        return None
    counts, _ = np.histogram(values, [*edges, np.inf])
    return {"edges": [*edges, None], "counts": counts.tolist()}


def risk_coverage(rows: PerQuery, points: int, rotations: bool) -> Row:
    """Mean MSSD and share seated of the most confident answers, from 1/points of all queries up to all.

    Equal confidence is taken in every order alike: such queries enter with their mean.
    """
    shares = np.arange(1, points + 1) / points
    risk, seated = (_among_first(values, rows.confidence, shares) for values in (rows.mssd_mm, rows.seated))
    return {
        "coverage": shares.tolist(),
        "mssd_mm": None if rotations else risk.tolist(),
        "seated": None if rotations else seated.tolist(),
    }


def _among_first(values: np.ndarray, confidence: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Means over the given shares (k,) of the queries (n,), most confident first."""
    _, group = np.unique(-confidence, return_inverse=True)
    counts = np.bincount(group)
    means = np.bincount(group, values.astype(float)) / counts
    totals = np.concatenate([[0.0], np.cumsum(means * counts)])
    ends = np.concatenate([[0], np.cumsum(counts)])
    first = np.maximum(np.ceil(shares * len(values) - 1e-9), 1)
    return np.interp(first, ends, totals) / first


def _cases(rows: PerQuery, count: int, rotations: bool) -> Row:
    """The worst answers, and those nearest to the median, by MSSD; by rotation where there is nothing else."""
    errors = rows.rotation_deg if rotations else rows.mssd_mm
    worst = np.lexsort((rows.query_id, -np.round(errors, 9)))[:count]
    middle = np.lexsort((rows.query_id, np.round(np.abs(errors - np.median(errors)), 9)))[:count]
    return {
        "worst": [_case(rows, i, rotations) for i in worst.tolist()],
        "middle": [_case(rows, i, rotations) for i in middle.tolist()],
    }


def _case(rows: PerQuery, i: int, rotations: bool) -> Row:
    told = {name: getattr(rows, name)[i].item() for name in CASE}
    if rotations:
        told |= {"position_mm": None, "mssd_mm": None, "seated": None}
    return {"query_id": str(rows.query_id[i]), **told}
