"""Scoring a submission: its answers are measured against the truth and summed up under a protocol.

`score` gives the rows of single queries and the summary, which as text is scores.json: the same input gives the same
bytes, wherever it is made.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmark.cache import ResultCache, key_of
from benchmark.measure import answers_to, measured
from benchmark.per_query import PerQuery
from benchmark.protocol import Protocol, read_protocol
from benchmark.provenance import commit, evaluator
from benchmark.summary import summarised
from benchmark.truths import Questions, joined, questions
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.files import sha256
from kit1000.metrics.seating import EXACT_BANDS
from kit1000.submission import Submission, check, read_submission
from kit1000.submission.predictions import FILE
from kit1000.tracks import CURVES


@dataclass(frozen=True, eq=False)
class Scored:
    """A scored submission."""

    rows: PerQuery
    """Every query that was asked, of the tracks and of the curves."""
    summary: dict[str, Any]
    """What scores.json holds."""


def read_checked(folder: Path, data: Path, split: str) -> Submission:
    """Read a submission after `kit1000 check` has found no error in it; a query without an answer is none.

    Raises InputError with the first error: a score of numbers that mean something else would mislead.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no folder of a submission")
    errors = check(folder, data, split).errors
    for first in errors[:1]:
        more = f" ({len(errors)} errors)" if len(errors) > 1 else ""
        raise InputError(f"{folder}: {first}{more}; `kit1000 check {folder} --data {data}` lists all")
    return read_submission(folder)


def score(
    submission: Submission,
    dataset: Dataset,
    protocol: Protocol | None = None,
    split: str | None = None,
    judge: str = "near",
    workers: int = 1,
    cache: ResultCache | None = None,
) -> Scored:
    """Score a submission on the tracks that its manifest names.

    Args:
        submission: as `kit1000.read_submission` gives it.
        dataset: the one it answers, with its truth.
        protocol: the current one when absent.
        split: the protocol's first, test, when absent; with it the curves are scored too.
        judge: near, all or never; whom the exact judge of seating is asked about.
        workers: processes for the seating test.
        cache: where rows are kept; nowhere when absent.
    """
    protocol = protocol or read_protocol()
    split = split or protocol.splits[0]
    _check(submission, dataset, protocol, split, judge, workers)
    tracks = [track for track in (*protocol.tracks, CURVES) if track in submission.manifest.tracks]
    rotations = submission.manifest.predicts == "rotation"

    def make() -> PerQuery:
        asked = _asked(dataset, protocol, split, tracks, submission.predictions.query_ids)
        _check_known(submission, dataset, split, asked)
        return measured(asked, answers_to(asked, submission.predictions), rotations, judge, workers)

    key = key_of(submission.predictions, dataset.id, split, tracks, rotations, judge)
    rows = make() if cache is None else cache.rows(key, make)
    stated = _stated(submission, dataset, protocol, split, judge)
    return Scored(rows, stated | summarised(rows, protocol, rotations))


def _asked(dataset: Dataset, protocol: Protocol, split: str, tracks: list[str], answered: Collection[str]) -> Questions:
    """The questions of the tracks in a split, and those of the curves when it is the protocol's own split.

    Slow methods may leave whole scenes out of the curves: they are drawn of those of which any query is answered.
    """
    parts: list[Questions] = []
    held = dataset.summary["config"]
    known = [track for track in tracks if track in held["tracks"]]
    if known:
        parts.append(questions(dataset, split, known))
    if CURVES in tracks and split == protocol.splits[0] and held["curve_scenes"]:
        curves, known_ids = questions(dataset, protocol.curves["split"], [CURVES]), set(answered)
        asked = zip(curves.scene_ids, curves.query_ids, strict=True)
        scenes = {scene_id for scene_id, query_id in asked if query_id in known_ids}
        parts.append(curves.of_scenes(scenes) if scenes else curves)
    if not parts:
        raise InputError(f"{dataset.root}: split {split} asks nothing in {', '.join(tracks) or 'no track'}")
    return joined(*parts)


def _check(submission: Submission, dataset: Dataset, protocol: Protocol, split: str, judge: str, workers: int) -> None:
    """Refuse what cannot be scored before anything is read."""
    if split not in protocol.splits:
        raise InputError(f"split {split!r}: {did_you_mean(split, protocol.splits)}expected one of {', '.join(protocol.splits)}")
    if judge not in EXACT_BANDS:
        raise InputError(f"judge {judge!r}: {did_you_mean(judge, EXACT_BANDS)}expected one of {', '.join(EXACT_BANDS)}")
    if workers < 1:
        raise InputError(f"workers: expected 1 or more, got {workers}")
    said = submission.manifest.dataset_id
    if said != dataset.id:
        raise InputError(
            f"{submission.folder}: answers dataset {said}, and {dataset.root} is {dataset.id}: "
            "score it on the dataset it was made for"
        )


def _check_known(submission: Submission, dataset: Dataset, split: str, asked: Questions) -> None:
    """Refuse a submission with answers to queries that are nowhere, or with none to those that are asked."""
    known = set(asked.query_ids)
    strays = [query_id for query_id in submission.predictions.query_ids if query_id not in known]
    if len(strays) == len(submission.predictions):
        first = f" (its first is of {strays[0]})" if strays else ""
        raise InputError(f"{submission.folder}: answers no query of split {split} in its tracks{first}")
    scored = {query_id.partition("-")[0] for query_id in known}
    strays = [query_id for query_id in strays if query_id.partition("-")[0] in scored]
    others = set(_ids(dataset, split)) if strays else set()
    unknown = [query_id for query_id in strays if query_id not in others]
    if unknown:
        raise InputError(
            f"{submission.folder}: query {unknown[0]} is not in {dataset.root} ({len(unknown)} such); "
            f"`kit1000 check {submission.folder} --data {dataset.root}` lists all faults"
        )


def _ids(dataset: Dataset, split: str) -> Iterator[str]:
    """Ids of all queries about the scenes of a split: every part, every track, the curves."""
    if not split.startswith("test"):
        return (query.id for query in dataset.split(split).queries())
    splits = ["test-all", CURVES] if dataset.summary["config"]["curve_scenes"] else ["test-all"]
    return (query.id for name in splits for query in dataset.split(name).queries())


def _stated(submission: Submission, dataset: Dataset, protocol: Protocol, split: str, judge: str) -> dict[str, Any]:
    """What a score says of where it comes from."""
    return {
        "protocol": protocol.name,
        "status": protocol.status,
        "metric_versions": dict(protocol.metric_versions),
        "dataset_id": dataset.id,
        "split": split,
        "judge": judge,
        "commit": commit(),
        "evaluator": evaluator(),
        "method": submission.manifest.method,
        "manifest": asdict(submission.manifest),
        "predictions_sha256": sha256(submission.folder / FILE),
    }
