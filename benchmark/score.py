"""Scoring a submission: its predictions are measured against the ground truth and summarised under a protocol.

`score` returns the rows of single queries and the summary, which as text is scores.json: the same input gives the same
bytes on every computer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmark.evaluate import PerQuery, align, evaluate
from benchmark.protocol import Protocol, read_protocol
from benchmark.provenance import commit, evaluator
from benchmark.queries import ScoredQueries, concatenate, read_queries
from benchmark.summary import summarise
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.files import sha256
from kit1000.metrics.seating import EXACT_BANDS
from kit1000.queries.tracks import CURVES
from kit1000.submission import Submission, check, read_valid_submission
from kit1000.submission.predictions import FILE


@dataclass(frozen=True, eq=False)
class Scores:
    """The scores of a submission."""

    rows: PerQuery
    """All queries of its tracks and of the curves."""
    summary: dict[str, Any]
    """The content of scores.json."""


def read_checked(folder: Path, data: Path, split: str) -> Submission:
    """Read the valid predictions of a submission; `invalid` of the result counts the other rows.

    Raises InputError with the first error of form that `kit1000 check` finds: a score of misread numbers would mislead.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no folder of a submission")
    errors = check(folder, data, split).form_errors
    for first in errors[:1]:
        more = f" ({len(errors)} errors)" if len(errors) > 1 else ""
        raise InputError(f"{folder}: {first}{more}; `kit1000 check {folder} --data {data}` lists all")
    submission = read_valid_submission(folder)
    if submission.invalid.first is not None and not len(submission.predictions):
        raise InputError(f"{folder}: no row is a valid prediction, the first error is {submission.invalid.first}")
    return submission


def invalid_text(submission: Submission) -> str | None:
    """One line about the rows that are not scored; None without any."""
    count, first = submission.invalid.count, submission.invalid.first
    if first is None:
        return None
    rows = "1 row is no valid prediction" if count == 1 else f"{count} rows are no valid predictions"
    return f"{submission.folder}: {rows}; their queries count as no motion; the first: {first}"


def score(
    submission: Submission,
    dataset: Dataset,
    protocol: Protocol | None = None,
    split: str | None = None,
    exact: str = "near",
    workers: int = 1,
) -> Scores:
    """Score a submission on the tracks of its manifest.

    Args:
        submission: as `kit1000.read_submission` returns it.
        dataset: the one of its predictions, with ground truth.
        protocol: the current one if absent.
        split: the protocol's first, test, if absent; with it the curves are scored too.
        exact: near, all or never: the predictions that the exact seating test decides.
        workers: processes for the seating test.
    """
    protocol = protocol or read_protocol()
    split = split or protocol.splits[0]
    _check_options(submission, dataset, protocol, split, exact, workers)
    tracks = [track for track in (*protocol.tracks, CURVES) if track in submission.manifest.tracks]
    rotation_only = submission.manifest.predicts == "rotation"
    queries = _queries(dataset, protocol, split, tracks, submission.predictions.query_ids)
    _check_query_ids(submission, dataset, split, queries)
    rows = evaluate(queries, align(submission.predictions, queries), rotation_only, exact, workers)
    provenance = _provenance(submission, dataset, protocol, split, exact)
    return Scores(rows, provenance | summarise(rows, protocol, rotation_only))


def _queries(
    dataset: Dataset, protocol: Protocol, split: str, tracks: list[str], predicted: Collection[str]
) -> ScoredQueries:
    """The queries of the tracks in a split, and those of the curves when it is the protocol's own split.

    The curves hold all their scenes, or only the first ones if no other is predicted, since methods are slow.
    """
    parts: list[ScoredQueries] = []
    config = dataset.summary["config"]
    known = [track for track in tracks if track in config["tracks"]]
    if known:
        parts.append(read_queries(dataset, split, known))
    if CURVES in tracks and split == protocol.splits[0] and config["curve_scenes"]:
        curves = read_queries(dataset, protocol.curves["split"], [CURVES])
        parts.append(curve_queries(curves, protocol.curves["first_scenes"], predicted))
    if not parts:
        raise InputError(f"{dataset.root}: split {split} has no query of {', '.join(tracks) or 'no track'}")
    return concatenate(*parts)


def curve_queries(curves: ScoredQueries, first_scenes: int, predicted: Collection[str]) -> ScoredQueries:
    """The queries of the first scenes if all predicted ones are among them; else those of all scenes."""
    first = curves.of_scenes(set(sorted(set(curves.scene_ids))[:first_scenes]))
    return first if set(predicted).intersection(curves.query_ids) <= set(first.query_ids) else curves


def _check_options(
    submission: Submission, dataset: Dataset, protocol: Protocol, split: str, exact: str, workers: int
) -> None:
    """Refuse wrong options before anything is read."""
    for name, value, choices in (("split", split, protocol.splits), ("exact", exact, EXACT_BANDS)):
        if value not in choices:
            hint = did_you_mean(value, choices)
            raise InputError(f"{name} {value!r}: {hint}expected one of {', '.join(choices)}")
    if workers < 1:
        raise InputError(f"workers: expected 1 or more, got {workers}")
    dataset_id = submission.manifest.dataset_id
    if dataset_id not in (dataset.id, dataset.public_id):
        raise InputError(
            f"{submission.folder}: predictions for dataset {dataset_id}, and {dataset.root} is {dataset.id}: "
            "score it on the dataset it was made for"
        )


def _check_query_ids(submission: Submission, dataset: Dataset, split: str, queries: ScoredQueries) -> None:
    """Refuse a submission with predictions for unknown queries, or with none for the scored ones."""
    known = set(queries.query_ids)
    strays = [query_id for query_id in submission.predictions.query_ids if query_id not in known]
    if len(strays) == len(submission.predictions):
        first = f" (its first is of {strays[0]})" if strays else ""
        raise InputError(f"{submission.folder}: no prediction for a query of split {split} in its tracks{first}")
    scored = {query_id.partition("-")[0] for query_id in known}
    strays = [query_id for query_id in strays if query_id.partition("-")[0] in scored]
    others = set(_all_query_ids(dataset, split)) if strays else set()
    unknown = [query_id for query_id in strays if query_id not in others]
    if unknown:
        raise InputError(
            f"{submission.folder}: query {unknown[0]} is not in {dataset.root} ({len(unknown)} such); "
            f"`kit1000 check {submission.folder} --data {dataset.root}` lists all faults"
        )


def _all_query_ids(dataset: Dataset, split: str) -> Iterator[str]:
    """Ids of all queries about the scenes of a split: every part, every track, the curves."""
    if not split.startswith("test"):
        return (query.id for query in dataset.split(split).queries())
    splits = ["test-all", CURVES] if dataset.summary["config"]["curve_scenes"] else ["test-all"]
    return (query.id for name in splits for query in dataset.split(name).queries())


def _provenance(submission: Submission, dataset: Dataset, protocol: Protocol, split: str, exact: str) -> dict[str, Any]:
    """The keys of scores.json about protocol, dataset, code and submission."""
    return {
        "protocol": protocol.name,
        "status": protocol.status,
        "metric_versions": dict(protocol.metric_versions),
        "dataset_id": dataset.id,
        "split": split,
        "exact": exact,
        "commit": commit(),
        "evaluator": evaluator(),
        "method": submission.manifest.method,
        "manifest": asdict(submission.manifest),
        "predictions_sha256": sha256(submission.folder / FILE),
    }
