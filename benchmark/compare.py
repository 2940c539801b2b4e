"""Which of two methods is better: paired on the queries that both answer, with intervals and p values.

Both face the same queries, so the difference is taken query by query and its mean resampled by assembly, as in
`intervals`. The two-sided p value is read off the same resamples: with c of B on the rarer side of zero, zeros on both,
it is 2 (c + 1) / (B + 1), at most 1; so it says below 0.05 where the interval leaves zero out. Seated or not is one bit
a query: there the p value is McNemar's, exact, from the queries that only one of the two seats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from benchmark.cache import ResultCache
from benchmark.intervals import DRAWS, ENDS, SEED, bootstrap_means
from benchmark.per_query import PerQuery
from benchmark.protocol import read_protocol
from benchmark.report import json_text, table
from benchmark.score import Scored, score
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.files import write_bytes
from kit1000.submission import read_submission
from kit1000.tracks import CURVES

ALPHA = 0.05  # below it a p value shows a difference
SEATED = "seated"
METRICS = {"position_mm": "position mm", "rotation_deg": "rotation deg", "mssd_mm": "MSSD mm", SEATED: "seated %"}
"""What is compared, and how a table heads it; of seated more is better, of the others less."""
STATED = ("dataset_id", "protocol", "split")  # two scores that differ in one of these are of different questions
UNDECIDED = "no difference can be shown"
HEADINGS = ("", "A", "B", "A - B", "p", "")


@dataclass(frozen=True)
class Difference:
    """Of one metric between A and B, over the queries that both answer."""

    a: float
    """Mean of A, in the unit of the metric; of seated a share."""
    b: float
    difference: float
    """a - b"""
    ci95: tuple[float, float]
    """Of the difference."""
    p: float
    """Two-sided; exact by McNemar of seated, from the bootstrap of the others. As JSON, 0 is less than 1e-9."""
    better: str | None
    """A or B; None where no difference can be shown."""
    only_a: int | None = None
    """Of seated: queries that A alone seats."""
    only_b: int | None = None


@dataclass(frozen=True)
class TrackComparison:
    """Of one track."""

    asked: int
    answered_a: int
    answered_b: int
    n: int
    """Queries that both answer: those compared."""
    differences: dict[str, Difference | None]
    """By metric; None where one of the two does not predict it, or n is 0."""


@dataclass(frozen=True)
class Comparison:
    """Of two scored submissions."""

    a: str
    """Name of the method."""
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
    cache: ResultCache | None = None,
) -> None:
    """Score two submissions, print how they compare, and write it as JSON.

    Args:
        a: folder of a submission.
        b: folder of another.
        data: dataset folder, with its truth.
        tracks: those to compare; all that both answer when empty.
        out: JSON file; nothing is written when absent.
        workers: processes for the seating test.
        cache: where rows are kept; nowhere when absent.
    """
    protocol, dataset = read_protocol(), Dataset(data)
    submissions = [read_submission(folder) for folder in (a, b)]
    first, second = (score(each, dataset, protocol, workers=workers, cache=cache) for each in submissions)
    found = compare(first, second, tracks, protocol.draws, protocol.seed)
    if out is not None:
        write_bytes(out, json_text(asdict(found)).encode())
    print(comparison_text(found))


def compare(a: Scored, b: Scored, tracks: Sequence[str] = (), draws: int = DRAWS, seed: int = SEED) -> Comparison:
    """Compare two submissions scored on the same dataset.

    Args:
        a: one.
        b: the other.
        tracks: those to compare; all that both answer when empty.
        draws: how many resamples.
        seed: of all of them.
    """
    for key in STATED:
        if a.summary[key] != b.summary[key]:
            raise InputError(f"scores that cannot be compared: {key} is {a.summary[key]} of A, {b.summary[key]} of B")
    compared = {
        track: _of_track(a.rows.of_track(track), b.rows.of_track(track), draws, seed) for track in _shared(a, b, tracks)
    }
    stated = {key: a.summary[key] for key in STATED}
    names = {"a": a.summary["method"], "b": b.summary["method"]}
    return Comparison(**names, **stated, draws=draws, seed=seed, tracks=compared)


def _shared(a: Scored, b: Scored, asked: Sequence[str]) -> list[str]:
    """The tracks to compare; those of the curves are no track, their errors are set."""
    both = [track for track in a.rows.tracks if track in b.rows.tracks and track != CURVES]
    if not both:
        raise InputError("nothing to compare: A and B answer no track in common")
    for track in asked:
        if track not in both:
            raise InputError(f"track {track!r}: {did_you_mean(track, both)}A and B both answer {', '.join(both)}")
    return list(asked) or both


def _of_track(a: PerQuery, b: PerQuery, draws: int, seed: int) -> TrackComparison:
    """Compare the rows of one track, which both have in the same order."""
    if not np.array_equal(a.query_id, b.query_id):
        raise InputError("scores that cannot be compared: A and B are of different queries")
    both = a.covered & b.covered
    differences = _differences(a[both], b[both], draws, seed) if both.any() else dict.fromkeys(METRICS)
    return TrackComparison(len(a), int(a.covered.sum()), int(b.covered.sum()), int(both.sum()), differences)


def _differences(a: PerQuery, b: PerQuery, draws: int, seed: int) -> dict[str, Difference | None]:
    """Compare n >= 1 paired rows in every metric that both have."""
    pairs = {metric: _pair(a, b, metric) for metric in METRICS}
    told = {metric: pair for metric, pair in pairs.items() if np.isfinite(pair).all()}
    columns = np.stack([first - second for first, second in told.values()], axis=1)
    drawn = bootstrap_means(columns, a.assembly_id, draws, seed)
    found: dict[str, Difference | None] = dict.fromkeys(METRICS)
    return found | {metric: _judged(metric, pair, drawn[:, i]) for i, (metric, pair) in enumerate(told.items())}


def _pair(a: PerQuery, b: PerQuery, metric: str) -> np.ndarray:
    """(2, n) the metric of A and of B, NaN where it was not measured."""
    pair = np.stack([np.asarray(getattr(rows, metric), np.float64) for rows in (a, b)])
    if metric == SEATED:  # a bool has no NaN: what is not seated is told from what was not tested by the MSSD
        pair[np.isnan([a.mssd_mm, b.mssd_mm])] = np.nan
    return pair


def _judged(metric: str, pair: np.ndarray, drawn: np.ndarray) -> Difference:
    """Say who is better.

    Args:
        metric: one of METRICS.
        pair: (2, n) of A and of B.
        drawn: (draws,) mean differences of the resamples.
    """
    lo, hi = np.quantile(drawn, ENDS).tolist()
    a, b = pair.mean(axis=1).tolist()
    only_a, only_b, p = None, None, bootstrap_p(drawn)
    if metric == SEATED:
        only_a, only_b = int((pair[0] > pair[1]).sum()), int((pair[0] < pair[1]).sum())
        p = mcnemar_p(only_a, only_b)
    shown = (lo > 0 or hi < 0) and p < ALPHA  # of seated both: McNemar's test takes queries for independent
    better = ("A" if (a > b) == (metric == SEATED) else "B") if shown else None
    return Difference(a, b, a - b, (lo, hi), p, better, only_a, only_b)


def bootstrap_p(drawn: np.ndarray) -> float:
    """Two-sided p value of no difference, from mean differences of resamples (draws,); never below 2 / (draws + 1)."""
    rarer = min((drawn <= 0).sum(), (drawn >= 0).sum())
    return min(1.0, 2 * (int(rarer) + 1) / (len(drawn) + 1))


def mcnemar_p(only_a: int, only_b: int) -> float:
    """Exact two-sided p value of McNemar's test: are queries that one alone passes as often A's as B's?"""
    return float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def comparison_text(found: Comparison) -> str:
    """The report that a person reads."""
    lines = [
        f"A: {found.a}",
        f"B: {found.b}",
        f"on {found.dataset_id}, split {found.split}, protocol {found.protocol}",
    ]
    for track, compared in found.tracks.items():
        lines += ["", *_track_lines(track, compared)]
    lines += [
        "",
        f"A - B [95 % interval], paired; {found.draws} resamples of whole assemblies, seed {found.seed}; p two-sided,",
        "from the resamples, of seated by McNemar's exact test. Not corrected for how many comparisons are made.",
    ]
    return "\n".join(lines)


def _track_lines(track: str, compared: TrackComparison) -> list[str]:
    first = f"{track}: {compared.n} queries that both answer"
    if compared.n < compared.asked:
        first += f", of {compared.asked}; A answers {compared.answered_a}, B {compared.answered_b}"
    told = [(METRICS[metric], row) for metric, row in compared.differences.items() if row is not None]
    return [first, *table(HEADINGS, [_cells(name, row) for name, row in told])] if told else [first]


def _cells(name: str, row: Difference) -> list[str]:
    """A line of the table: per cent of seated, otherwise the unit of the metric."""
    scale, digits = (100, 1) if row.only_a is not None else (1, 2)
    a, b, difference, lo, hi = (f"{scale * x:.{digits}f}" for x in (row.a, row.b, row.difference, *row.ci95))
    verdict = UNDECIDED if row.better is None else f"{row.better} is better by {difference.lstrip('-')}"
    if row.only_a is not None:
        verdict += f" ({row.only_a} by A alone, {row.only_b} by B alone)"
    return [name, a, b, f"{difference} [{lo}, {hi}]", "<0.001" if row.p < 1e-3 else f"{row.p:.3f}", verdict]
