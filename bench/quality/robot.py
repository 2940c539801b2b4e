"""Parts that the robot seats with true motions, guesses and submissions, compared with the seating test.

    python bench/quality/robot.py data/kit1000 submissions/registration-completed --scenes 60

A part is possible if a true motion picks it from above and a cup seals on it. Shares seated refer to these parts. The
seconds are those of the robot, not of the processor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np
import tyro
from tqdm import tqdm

from bench.measured import run, spread, timed
from benchmark.measurements import Column, Measurement, estimate, rate
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.planner.execute import NO_SEAL, NOT_FROM_ABOVE, OUTCOMES, SEATED, PartRun, run_scene
from kit1000.planner.runs import outcome_counts
from kit1000.pose import Pose
from kit1000.queries.tracks import TRACKS
from kit1000.submission.predictions import FILE, read_predictions
from kit1000.values import Query, Truth

TRUTH = "true"
MOTIONS = Column("motions", "motions")
SEATED_COLUMNS = (
    MOTIONS,
    Column("n", "parts"),
    Column("seated", "seated by the robot, %", 1, True),
    Column("tested", "by the test, %", 1, True),
    Column("position", "position, mm", 2),
    Column("position_median", "median", 2),
    Column("rotation", "rotation, °", 2),
    Column("rotation_median", "median", 2),
)
AGREEMENT_COLUMNS = (
    MOTIONS,
    Column("n", "picked parts"),
    Column("both", "both seat", 0),
    Column("robot_alone", "robot alone", 0),
    Column("test_alone", "test alone", 0),
    Column("neither", "neither", 0),
    Column("differ", "they differ, %", 1, True),
    Column("seconds", "robot, s", 1),
    Column("median", "median", 1),
)


@dataclass(frozen=True)
class Robot:
    """Let the robot carry out motions, and compare it with the seating test."""

    data: tyro.conf.Positional[Path]
    """Dataset folder, with ground truth."""
    submissions: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Submission folders, carried out beside the true motions and the guesses."""
    track: str = "snap"
    """Track whose queries are carried out."""
    split: str = "test"
    scenes: int = 60
    """Most scenes, spread evenly over the split."""
    out: Path | None = None
    """JSON file of the tables, such as results/robot.json."""


class Case(NamedTuple):
    """A query, what the robot made of a motion, and what the seating test says of it."""

    query: Query
    truth: Truth
    run: PartRun
    tested: bool
    position: float
    """[mm] error to the nearest goal."""
    rotation: float
    """[degrees]"""

    @property
    def seated(self) -> bool:
        """Whether the robot seats the part."""
        return self.run.outcome == SEATED


def main(options: Robot) -> None:
    """Print shares seated, outcomes, and how often robot and test differ."""
    dataset = Dataset(options.data)
    if options.track not in TRACKS:
        raise InputError(f"--track {options.track}: there are {', '.join(TRACKS)}")
    split = dataset.split(options.split)
    chosen = set(spread(split.scene_ids, options.scenes))
    queries = [query for query in split.queries(options.track) if query.scene_id in chosen]
    truths = {query.id: dataset.truth_of(query) for query in queries}
    motions = {TRUTH: {query.id: truths[query.id].goal_drawn for query in queries}}
    motions |= {f"`{path.name}`": _motions_of(path, queries) for path in options.submissions}
    motions["guess"] = {query.id: query.guess for query in queries if query.guess is not None}
    seconds, cases = timed(
        lambda: {name: _execute(dataset, name, queries, truths, moves) for name, moves in motions.items() if moves},
        process_time,
    )
    print(f"{seconds / max(sum(map(len, cases.values())), 1):.2f} CPU s a part")
    measurement = Measurement.begin(dataset)
    title = f"Possible parts of {len(chosen)} scenes of {options.split}, track `{options.track}`"
    add_tables(measurement, cases, title)
    measurement.report(options.out)


def _motions_of(path: Path, queries: Sequence[Query]) -> dict[str, Pose]:
    """The predicted motions of queries by id; without a prediction the part stays."""
    predictions = read_predictions(path / FILE)
    rows = {query.id: predictions.row(query.id) for query in queries}
    if all(row is None for row in rows.values()):
        raise InputError(f"{path}: no prediction for any of {len(rows)} queries")
    return {i: Pose.identity() if row is None else predictions.motions[row] for i, row in rows.items()}


def _execute(
    dataset: Dataset, name: str, queries: Sequence[Query], truths: Mapping[str, Truth], motions: Mapping[str, Pose]
) -> list[Case]:
    """Let the robot carry out motions scene by scene, and evaluate them by the seating test."""
    runs: dict[str, PartRun] = {}
    for scene_id in tqdm(dict.fromkeys(query.scene_id for query in queries), desc=name, unit="", disable=None):
        own = {query.part: query for query in queries if query.scene_id == scene_id}
        moves = {part: motions[query.id] for part, query in own.items()}
        scene = dataset.recorded_scene(scene_id, truth=True)
        runs |= {own[run.part].id: run for run in run_scene(scene, moves, TRACKS[queries[0].track].sensor).parts}
    ground_truths = [truths[query.id] for query in queries]
    stacked = Pose.stack([motions[query.id] for query in queries])
    errors = pose_errors(
        stacked, Targets.of(ground_truths, lambda part_id: dataset.geometry.part(part_id).mesh.vertices)
    )
    tested = seatings(stacked, ground_truths, dataset.geometry).seated
    return [
        Case(query, truth, runs[query.id], bool(tested[i]), 1e3 * errors.position[i], np.degrees(errors.rotation[i]))
        for i, (query, truth) in enumerate(zip(queries, ground_truths, strict=True))
    ]


def add_tables(measurement: Measurement, cases: Mapping[str, Sequence[Case]], title: str) -> None:
    """Add the tables of cases by the name of their motions, the true ones among them."""
    possible = {case.query.id for case in cases[TRUTH] if case.run.outcome not in (NO_SEAL, NOT_FROM_ABOVE)}
    seated = measurement.table("seated", title, *SEATED_COLUMNS)
    outcome_columns = [Column(outcome, outcome, 0) for outcome in OUTCOMES]
    outcomes = measurement.table("outcomes", "All parts by outcome", MOTIONS, Column("n", "parts"), *outcome_columns)
    agreement = measurement.table("agreement", "Robot and seating test on picked parts", *AGREEMENT_COLUMNS)
    for motions, found in cases.items():
        own = [case for case in found if case.query.id in possible]
        if own:
            seated.add(motions=motions, n=len(own), **_shares(own))
        outcomes.add(motions=motions, n=len(found), **outcome_counts(case.run for case in found))
        picked = [case for case in found if case.run.physics]
        if picked:
            agreement.add(motions=motions, n=len(picked), **_agreement(picked))


def _shares(cases: Sequence[Case]) -> dict[str, Any]:
    clusters = [case.truth.assembly_id for case in cases]
    position = estimate([case.position for case in cases], clusters)
    rotation = estimate([case.rotation for case in cases], clusters)
    medians = {"position_median": position["median"], "rotation_median": rotation["median"]}
    seated, tested = rate([case.seated for case in cases]), rate([case.tested for case in cases])
    return {"seated": seated, "tested": tested, "position": position, "rotation": rotation} | medians


def _agreement(picked: Sequence[Case]) -> dict[str, Any]:
    seated, tested = (np.array([getattr(case, key) for case in picked]) for key in ("seated", "tested"))
    counts = {"both": seated & tested, "robot_alone": seated & ~tested, "test_alone": ~seated & tested}
    counts["neither"] = ~seated & ~tested
    seconds = estimate([case.run.seconds for case in picked])
    spent = {"seconds": seconds, "median": seconds["median"]}
    return {key: int(which.sum()) for key, which in counts.items()} | {"differ": rate(seated != tested)} | spent


if __name__ == "__main__":
    run(main, Robot, __doc__)
