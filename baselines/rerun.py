"""Answering queries of a submission again: does its method still say what is written there?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from baselines.methods import method_of
from baselines.predict import Job, answer_of, splits_of
from kit1000.dataset.reader import Dataset
from kit1000.engines import local
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.submission import read_submission

MILLIMETRES, DEGREES = 0.01, 0.01
"""By which an answer may differ from one machine to another: sums of float32 depend on their order."""


@dataclass(frozen=True)
class Rerun:
    """Answers beside those of a submission."""

    query_ids: tuple[str, ...]
    position_mm: np.ndarray
    """(n,) by which the pivot goes elsewhere."""
    rotation_deg: np.ndarray
    """(n,)"""

    @property
    def same(self) -> np.ndarray:
        """(n,) bool."""
        return (self.position_mm <= MILLIMETRES) & (self.rotation_deg <= DEGREES)


def rerun(folder: Path, data: Path, first: int, workers: int | None = None) -> Rerun:
    """Answer the first queries of a submission again, by the method that its manifest names, with seed 0.

    Args:
        folder: of the submission.
        data: dataset folder.
        first: how many.
        workers: processes; None = one per core.

    Raises:
        InputError: no such method, another dataset, or a query that it does not ask.
    """
    submission, dataset = read_submission(folder), Dataset(data)
    name, stated = submission.manifest.method, submission.manifest.dataset_id
    if stated != dataset.id:
        raise InputError(f"{folder}: answers dataset {stated}, and {dataset.root} is {dataset.id}")
    query_ids = submission.predictions.query_ids[:first]
    method_of(name)  # before anything is read
    jobs, pivots = _asked(dataset, query_ids, folder)
    with local(workers) as spread:
        answers = spread(partial(answer_of, dataset.root, name, 0), jobs)
        shown = tqdm(answers, folder.name, len(jobs), unit="query", disable=None)
        motions = {answer.query_id: answer.goal_from_now for answer in shown}  # they come as they are done
    now = Pose.stack([motions[query_id] for query_id in query_ids])
    there = submission.predictions.motions[: len(jobs)]
    apart = np.linalg.norm(now.apply(pivots) - there.apply(pivots), axis=-1)
    return Rerun(query_ids, 1e3 * apart, np.degrees((now.inverse() @ there).angle()))


def _asked(dataset: Dataset, query_ids: Sequence[str], folder: Path) -> tuple[list[Job], np.ndarray]:
    """Where queries are found, and their pivots (n, 3) [m]."""
    wanted, found = set(query_ids), {}
    for split in splits_of(query_ids):
        for query in dataset.split(split).queries():
            if query.id in wanted:
                found[query.id] = Job(split, query.scene_id, query.id, query.track), query.pivot
    for query_id in query_ids:
        if query_id not in found:
            raise InputError(f"{folder}: query {query_id} is none that {dataset.root} asks")
    jobs, pivots = zip(*(found[query_id] for query_id in query_ids), strict=True)
    return list(jobs), np.stack(pivots)
