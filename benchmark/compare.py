"""The comparison of two methods: paired over the queries that both predict, with intervals and p values.

Both have the same queries, so the difference is taken query by query and its mean resampled by assembly and part, as in
`intervals`. The two-sided p value comes from the same resamples: with c of B on the rarer side of zero, zeros counted
on both, it is 2 (c + 1) / (B + 1), at most 1; so it is below 0.05 if the interval excludes zero. A rate, such as
seated, is one bit per query: its p value is from McNemar's exact test on the queries that only one method passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from benchmark import quantities
from benchmark.evaluate import PerQuery
from benchmark.intervals import DRAWS, ENDS, SEED, bootstrap_means
from benchmark.protocol import read_protocol
from benchmark.quantities import Quantity
from benchmark.report import Grid, json_text
from benchmark.score import Scores, score
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.files import write_own
from kit1000.queries.tracks import CURVES
from kit1000.submission import read_valid_submission

ALPHA = 0.05  # significance level
SAME = ("dataset_id", "protocol", "split")  # keys of scores.json that must agree: else the queries differ
UNDECIDED = "no significant difference"
HEADINGS = ("", "A", "B", "A - B", "p", "")


@dataclass(frozen=True)
class Difference:
    """The difference of one quantity between A and B, over the queries that both predict."""

    a: float
    """Mean of A, in the unit of the key; of a rate the share."""
    b: float
    difference: float
    """a - b"""
    ci95: tuple[float, float]
    """Interval of the difference."""
    p: float
    """Two-sided; of a rate from McNemar's exact test, else from the bootstrap. In JSON, 0 is less than 1e-9."""
    better: str | None
    """A or B; None if the difference is not significant."""
    only_a: int | None = None
    """Number of queries that only A passes, for a rate."""
    only_b: int | None = None


@dataclass(frozen=True)
class TrackComparison:
    """The comparison on one track."""

    queries: int
    predicted_a: int
    """Queries with a prediction of A."""
    predicted_b: int
    n: int
    """Queries that both predict: those compared."""
    differences: dict[str, Difference | None]
    """Differences by key of the quantity; None if one of the two does not predict it, or n is 0."""


@dataclass(frozen=True)
class Comparison:
    """The comparison of two scored submissions."""

    a: str
    """Name of the method, and its masks."""
    b: str
    dataset_id: str
    protocol: str
    split: str
    draws: int
    seed: int
    tracks: dict[str, TrackComparison]


def run(
    a: Path,
    b: Path,
    data: Path,
    tracks: Sequence[str] = (),
    out: Path | None = None,
    workers: int = 1,
) -> None:
    """Score two submissions, print their comparison, and write it as JSON.

    Args:
        a: folder of a submission.
        b: folder of another.
        data: dataset folder, with its truth.
        tracks: the tracks to compare; all that both have if empty.
        out: JSON file; nothing is written if absent.
        workers: processes for the seating test.
    """
    protocol, dataset = read_protocol(), Dataset(data)
    submissions = [read_valid_submission(folder) for folder in (a, b)]
    first, second = (score(each, dataset, protocol, workers=workers) for each in submissions)
    comparison = compare(first, second, tracks, protocol.draws, protocol.seed)
    if out is not None:
        write_own(out, json_text(asdict(comparison)).encode())
    print(comparison_text(comparison))


def compare(a: Scores, b: Scores, tracks: Sequence[str] = (), draws: int = DRAWS, seed: int = SEED) -> Comparison:
    """Compare two submissions scored on the same dataset.

    Args:
        a: scores of one.
        b: scores of the other.
        tracks: the tracks to compare; all that both have if empty.
        draws: number of resamples.
        seed: of all resamples.
    """
    for key in SAME:
        if a.summary[key] != b.summary[key]:
            raise InputError(f"scores that cannot be compared: {key} is {a.summary[key]} of A, {b.summary[key]} of B")
    compared = {
        track: _compare_track(a.rows.of_track(track), b.rows.of_track(track), draws, seed)
        for track in _common_tracks(a, b, tracks)
    }
    same = {key: a.summary[key] for key in SAME}
    first, second = (f"{each.summary['method']}, masks {each.summary['manifest']['masks']}" for each in (a, b))
    return Comparison(first, second, **same, draws=draws, seed=seed, tracks=compared)


def _common_tracks(a: Scores, b: Scores, chosen: Sequence[str]) -> list[str]:
    """The tracks to compare, without the curves: the errors of their guesses are set and not drawn."""
    both = [track for track in a.rows.tracks if track in b.rows.tracks and track != CURVES]
    if not both:
        raise InputError("nothing to compare: A and B have no track in common")
    for track in chosen:
        if track not in both:
            raise InputError(f"track {track!r}: {did_you_mean(track, both)}A and B both have {', '.join(both)}")
    return list(chosen) or both


def _compare_track(a: PerQuery, b: PerQuery, draws: int, seed: int) -> TrackComparison:
    """Compare the rows of one track, which both have in the same order."""
    if not np.array_equal(a.query_id, b.query_id):
        raise InputError("scores that cannot be compared: A and B are of different queries")
    both = a.covered & b.covered
    keys = [quantity.key for quantity in quantities.shown_in("comparison")]
    differences = _differences(a[both], b[both], draws, seed) if both.any() else dict.fromkeys(keys)
    return TrackComparison(len(a), int(a.covered.sum()), int(b.covered.sum()), int(both.sum()), differences)


def _differences(a: PerQuery, b: PerQuery, draws: int, seed: int) -> dict[str, Difference | None]:
    """Compare n >= 1 paired rows in every quantity that both predict; by key."""
    shown = quantities.shown_in("comparison")
    pairs = {quantity: _pair(a, b, quantity) for quantity in shown}
    known = {quantity: pair for quantity, pair in pairs.items() if np.isfinite(pair).all()}
    columns = np.stack([first - second for first, second in known.values()], axis=1)
    resampled = bootstrap_means(columns, a.clusterings, draws, seed)
    differences: dict[str, Difference | None] = dict.fromkeys(quantity.key for quantity in shown)
    for i, (quantity, pair) in enumerate(known.items()):
        differences[quantity.key] = _difference(quantity, pair, resampled[:, i])
    return differences


def _pair(a: PerQuery, b: PerQuery, quantity: Quantity) -> np.ndarray:
    """(2, n) the quantity of A and of B, NaN if it was not measured."""
    pair = np.stack([np.asarray(rows.quantities[quantity.key], np.float64) for rows in (a, b)])
    if quantity.rate and quantity.needs_position:  # a bool has no NaN: without positions there is no MSSD either
        mssd = [rows.quantities[quantities.MSSD.key] for rows in (a, b)]
        pair[np.isnan(mssd)] = np.nan
    return pair


def _difference(quantity: Quantity, pair: np.ndarray, resampled: np.ndarray) -> Difference:
    """The difference of a quantity, and whether it is significant.

    Args:
        quantity: the quantity.
        pair: (2, n) of A and of B.
        resampled: (draws,) mean differences of the resamples.
    """
    lo, hi = np.quantile(resampled, ENDS).tolist()
    a, b = pair.mean(axis=1).tolist()
    only_a, only_b, p = None, None, bootstrap_p(resampled)
    if quantity.rate:
        only_a, only_b = int((pair[0] > pair[1]).sum()), int((pair[0] < pair[1]).sum())
        p = mcnemar_p(only_a, only_b)
    significant = (lo > 0 or hi < 0) and p < ALPHA  # a rate needs both: McNemar's test takes queries as independent
    better = ("A" if (a > b) == quantity.higher_is_better else "B") if significant else None
    return Difference(a, b, a - b, (lo, hi), p, better, only_a, only_b)


def bootstrap_p(resampled: np.ndarray) -> float:
    """Two-sided p value of no difference, from mean differences of resamples (draws,); never below 2 / (draws + 1)."""
    rarer = min((resampled <= 0).sum(), (resampled >= 0).sum())
    return min(1.0, 2 * (int(rarer) + 1) / (len(resampled) + 1))


def mcnemar_p(only_a: int, only_b: int) -> float:
    """Exact two-sided p value of McNemar's test, from the numbers of queries that only one of the two passes."""
    return float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def comparison_text(comparison: Comparison) -> str:
    """The report for a terminal."""
    lines = [
        f"A: {comparison.a}",
        f"B: {comparison.b}",
        f"on {comparison.dataset_id}, split {comparison.split}, protocol {comparison.protocol}",
    ]
    for track, compared in comparison.tracks.items():
        lines += ["", *_track_lines(track, compared)]
    lines += [
        "",
        f"A - B [95 % interval], paired; {comparison.draws} resamples of assemblies and parts, seed {comparison.seed};",
        "two-sided p from the resamples, of rates from McNemar's exact test. Not corrected for multiple comparisons.",
    ]
    return "\n".join(lines)


def _track_lines(track: str, compared: TrackComparison) -> list[str]:
    first = f"{track}: {compared.n} queries that both predict"
    if compared.n < compared.queries:
        first += f", of {compared.queries}; A predicts {compared.predicted_a}, B {compared.predicted_b}"
    known = [(each, row) for each in quantities.shown_in("comparison") if (row := compared.differences[each.key])]
    rows = [_cells(quantity, row) for quantity, row in known]
    return [first, Grid(HEADINGS, rows, [not heading for heading in HEADINGS]).text()] if known else [first]


def _cells(quantity: Quantity, row: Difference) -> list[str]:
    """A line of the table, in the unit of the quantity."""
    a, b, difference, lo, hi = (
        quantity.text(quantity.scale * value) for value in (row.a, row.b, row.difference, *row.ci95)
    )
    verdict = UNDECIDED if row.better is None else f"{row.better} is better by {difference.lstrip('-')}"
    if quantity.rate:
        verdict += f" ({row.only_a} by A alone, {row.only_b} by B alone)"
    return [quantity.heading, a, b, f"{difference} [{lo}, {hi}]", "<0.001" if row.p < 1e-3 else f"{row.p:.3f}", verdict]
