"""What each special case of registration gains: queries predicted with it and without it, compared one by one.

    python bench/quality/special_cases.py data/kit1000 --split val --workers 8 --out results/special-cases.json

A case is switched off by neutral constants. It wins a query that is seated only with it, and loses one that is seated
only without it; p is that of McNemar's exact test.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import tyro
from scipy.optimize import linear_sum_assignment

from bench.measured import run
from benchmark.compare import mcnemar_p
from benchmark.measurements import Column, Measurement
from kit1000.dataset.reader import Dataset
from kit1000.metrics import seatings
from kit1000.perception import image_kinds
from kit1000.perception.image_kinds import COST
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor, method_of
from kit1000.registration import kit_volume, method, rank, search
from kit1000.registration.rank import Fit

METHOD = "registration-completed"
SEEN = replace(image_kinds.PHOTONEO, noise=image_kinds.PHOTONEO.noise._replace(no_return=False))
Change = Callable[[], contextlib.AbstractContextManager[Any]]


def constant(module: Any, name: str, value: Any) -> Change:
    """A module's constant with a neutral value."""
    return partial(patch.object, module, name, value)


def refinement(kind: str, **values: Any) -> Change:
    """Settings of the refinement of a kind of image with neutral values; a restored image is one of the D415."""
    old = getattr(image_kinds, kind)
    new = replace(old, refinement=replace(old.refinement, **values))
    if kind == "RESTORED":
        return constant(image_kinds, "D415", replace(image_kinds.D415, denoised=new))
    return constant(image_kinds, kind, new)


def likeliest_assignment(fits: Sequence[Fit], others: Iterable[Sequence[Fit]], curve: image_kinds.Curve) -> list[Fit]:
    """As `rank.assigned`, by the one likeliest assignment of parts to plates."""
    with patch.object(rank, "plate_posterior", _of_likeliest):
        return rank.assigned(fits, others, curve)


def _of_likeliest(odds: np.ndarray) -> np.ndarray:
    """(plates,) 1 for the plate of the first part in the likeliest assignment; each part may have no plate."""
    nowhere = np.where(np.eye(len(odds), dtype=bool), 0.0, -np.inf)
    gain = np.hstack([odds, np.maximum(nowhere, -1e3)])
    parts, plates = linear_sum_assignment(gain, maximize=True)
    return (np.arange(odds.shape[1]) == plates[list(parts).index(0)]).astype(float)


CASES: dict[str, tuple[tuple[str, ...], Change]] = {
    "tilt by 8 degrees": (("snap",), refinement("IDEAL", tilt=0.0)),
    "cavities without a return": (("snap-photoneo", "place-photoneo"), constant(image_kinds, "PHOTONEO", SEEN)),
    "outline / 4": (("snap", "place", "snap-d415", "place-d415"), constant(method, "COST", COST._replace(outline=0.0))),
    "coarse weight": (("snap", "place", "snap-d415", "place-d415"), constant(method, "COARSE_WEIGHT", 0.0)),
    "own part weight of the choice": (
        ("snap", "place", "snap-d415"),
        constant(search, "CHOICE_PART_WEIGHT", search.PART_WEIGHT),
    ),
    "posterior over assignments": (("place", "place-d415"), constant(method, "assigned", likeliest_assignment)),
    "learned placement": (("snap-d415", "place-d415"), constant(method.PartRegistration, "_placed", lambda s, f, i: f)),
    "more candidates": (("snap", "place", "snap-d415"), constant(method, "MOST_TRIED", 0)),
    "deeper cuts": (("snap-d415", "place-d415"), constant(kit_volume, "DEEPER", ())),
    "choice by the image": (("snap-d415", "place-d415"), refinement("RESTORED", image_cost=0.0)),
    "raised goals": (("snap-d415", "place-d415"), refinement("RESTORED", raise_goal=0.0)),
}
"""The tracks on which each special case may matter, and what switches it off."""


@dataclass(frozen=True)
class SpecialCases:
    """Measure what special cases of registration gain."""

    data: tyro.conf.Positional[Path]
    """Dataset folder."""
    split: str = "val"
    cases: tuple[str, ...] = tuple(CASES)
    """Special cases to switch off, each in turn."""
    limit: int | None = None
    """Most queries a track."""
    workers: int = 1
    """Processes."""
    out: Path | None = None
    """JSON file of the table, such as results/special-cases.json."""


def main(options: SpecialCases) -> None:
    """Print the wins and losses of each special case."""
    dataset = Dataset(options.data)
    measurement = Measurement.begin(dataset)
    columns = (*(Column(key, key) for key in ("case", "track", "n", "wins", "losses")), Column("p", "p", 3))
    table = measurement.table(
        "cases", f"Seated with each special case only, or without it only: {options.split}", *columns
    )
    seated: dict[tuple[str | None, str], np.ndarray] = {}
    with ProcessPoolExecutor(options.workers) as pool:
        for case in options.cases:
            for track in CASES[case][0]:
                for switched in {None, case}:
                    if (switched, track) not in seated:
                        seated[switched, track] = _seated(dataset, options, track, switched, pool)
                with_case, without = seated[None, track], seated[case, track]
                wins, losses = int((with_case & ~without).sum()), int((without & ~with_case).sum())
                row = {"n": len(without), "wins": wins, "losses": losses, "p": mcnemar_p(wins, losses)}
                table.add(case=case, track=track, **row)
                print(case, track, row, flush=True)
    measurement.report(options.out)


def _seated(
    dataset: Dataset, options: SpecialCases, track: str, case: str | None, pool: ProcessPoolExecutor
) -> np.ndarray:
    """(n,) bool: which queries of a track are seated, with a special case switched off or None."""
    split = dataset.split(options.split, truth=True)
    queries = list(split.queries(track))[: options.limit]
    jobs = [(options.data, options.split, query.scene_id, query.id, case) for query in queries]
    motions = Pose.stack(list(pool.map(_predicted, *zip(*jobs, strict=True))))
    truths = [split.scene(query.scene_id).truth_of(query.id) for query in queries]
    return seatings(motions, truths, dataset.geometry).seated


def _predicted(data: Path, split: str, scene_id: str, query_id: str, case: str | None) -> Pose:
    """The predicted motion of a query."""
    dataset = Dataset(data)
    query = next(query for query in dataset.split(split).scene(scene_id).queries if query.id == query_id)
    with CASES[case][1]() if case else contextlib.nullcontext():
        return _predictor(data)(query, None).goal_from_now


@lru_cache(maxsize=1)
def _predictor(data: Path) -> Any:
    return make_predictor(method_of(METHOD), Dataset(data), 0)


if __name__ == "__main__":
    run(main, SpecialCases, __doc__)
