"""Repeating predictions of a submission: does its method still predict the same?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from baselines.catalog import method_of, run_config
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.parallel import local_engine
from kit1000.prediction.predict import Job, predict_job, splits_of
from kit1000.submission import Predictions, read_submission

MILLIMETRES, DEGREES = 0.01, 0.05
"""Most that a prediction may differ between processors: sums of float32 in a network depend on their order.

A second pass reads a volume about the pose of the first one, whose voxels take the nearest pixel: there 1e-5 degrees
become up to 0.025 (100 predictions of `snapnet-2pass` and `snapnet-gtvol-2pass`, on two processors).
"""


@dataclass(frozen=True)
class Rerun:
    """Repeated predictions against those of a submission."""

    query_ids: tuple[str, ...]
    position_mm: np.ndarray
    """(n,) difference in where the pivot goes."""
    rotation_deg: np.ndarray
    """(n,)"""
    identical: np.ndarray
    """(n,) bool: motion and confidence are the same to the last digit."""

    @property
    def same(self) -> np.ndarray:
        """(n,) bool: within MILLIMETRES and DEGREES."""
        return (self.position_mm <= MILLIMETRES) & (self.rotation_deg <= DEGREES)

    def summary(self) -> str:
        """One line: the same to the last digit, or the largest difference beside the one that is allowed."""
        n = len(self.query_ids)
        if self.identical.all():
            return f"{n} predictions, the same to the last digit"
        most = f"at most {self.position_mm.max():.2g} mm and {self.rotation_deg.max():.2g}° from those submitted"
        line = f"{n} predictions, {int(self.identical.sum())} of them the same to the last digit; {most}"
        if self.same.all():
            return f"{line}, within the {MILLIMETRES:g} mm and {DEGREES:g}° allowed for networks"
        first = self.query_ids[int(np.argmin(self.same))]
        others = int((~self.same).sum())
        return f"{line}; {others} beyond the allowed {MILLIMETRES:g} mm or {DEGREES:g}°, the first {first}"


def rerun(folder: Path, data: Path, first: int, workers: int | None = None) -> Rerun:
    """Predict the first queries of a submission again, by the method that its manifest names, with seed 0.

    Args:
        folder: of the submission.
        data: dataset folder.
        first: how many queries.
        workers: processes; None = one per core.

    Raises:
        InputError: no such method, another dataset, or a query that the dataset does not have.
    """
    submission, dataset = read_submission(folder), Dataset(data)
    name, stated = submission.manifest.method, submission.manifest.dataset_id
    if stated != dataset.id:
        raise InputError(f"{folder}: is about dataset {stated}, and {dataset.root} is {dataset.id}")
    query_ids = submission.predictions.query_ids[:first]
    method_of(name)  # before anything is read
    jobs, pivots = _jobs_and_pivots(dataset, query_ids, folder)
    with local_engine(workers) as spread:
        predictions = spread(partial(predict_job, dataset.root, run_config(name)), jobs)
        bar = tqdm(predictions, folder.name, len(jobs), unit="query", disable=None)
        found = {prediction.query_id: prediction for prediction in bar}  # in the order of completion
    again = Predictions.of([found[query_id] for query_id in query_ids])
    now, submitted = again.motions, submission.predictions.motions[: len(jobs)]
    shift = np.linalg.norm(now.apply(pivots) - submitted.apply(pivots), axis=-1)
    identical = (now.wxyz == submitted.wxyz).all(-1) & (now.xyz == submitted.xyz).all(-1)
    identical &= again.confidence == submission.predictions.confidence[: len(jobs)]
    return Rerun(query_ids, 1e3 * shift, np.degrees((now.inverse() @ submitted).angle()), identical)


def _jobs_and_pivots(dataset: Dataset, query_ids: Sequence[str], folder: Path) -> tuple[list[Job], np.ndarray]:
    """The jobs of queries, and their pivots (n, 3) [m]."""
    wanted, known = set(query_ids), {}
    for split in splits_of(query_ids):
        for query in dataset.split(split).queries():
            if query.id in wanted:
                known[query.id] = Job(split, query.scene_id, query.id, query.track), query.pivot
    for query_id in query_ids:
        if query_id not in known:
            raise InputError(f"{folder}: {dataset.root} has no query {query_id}")
    jobs, pivots = zip(*(known[query_id] for query_id in query_ids), strict=True)
    return list(jobs), np.stack(pivots)
