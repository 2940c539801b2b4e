"""From questions and predictions to one row a query: answers are put beside what is asked, and measured."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmark.per_query import PerQuery
from benchmark.truths import Questions
from kit1000.metrics import Seatings, Targets, pose_errors, seatings
from kit1000.pose import Pose
from kit1000.submission import Predictions
from kit1000.tracks import CURVES
from kit1000.values import Slot, Truth

MM = 1e3  # millimetres in a metre
UP = np.array([0.0, 0.0, 1.0])


class Answers(NamedTuple):
    """What a submission answers to n questions."""

    motions: Pose
    """(n,) goal_from_now; no motion where there is no answer."""
    covered: np.ndarray
    """(n,) bool: whether there is an answer."""
    confidence: np.ndarray
    """(n,)"""
    seconds: np.ndarray
    """(n,) NaN where it is not told."""


def answers_to(questions: Questions, predictions: Predictions) -> Answers:
    """The predictions in the order of the questions."""
    found = {query_id: i for i, query_id in enumerate(predictions.query_ids)}
    rows = np.array([found.get(query_id, -1) for query_id in questions.query_ids])
    covered = rows >= 0
    given = rows[covered]
    wxyz, xyz = np.tile((1.0, 0.0, 0.0, 0.0), (len(rows), 1)), np.zeros((len(rows), 3))
    wxyz[covered], xyz[covered] = predictions.motions.wxyz[given], predictions.motions.xyz[given]
    confidence, seconds = np.zeros(len(rows)), np.full(len(rows), np.nan)
    confidence[covered], seconds[covered] = predictions.confidence[given], predictions.seconds[given]
    seconds[seconds < 0] = np.nan  # -1 says that nobody measured
    return Answers(Pose(wxyz, xyz), covered, confidence, seconds)


def measured(
    questions: Questions, answers: Answers, rotations: bool = False, judge: str = "near", workers: int = 1
) -> PerQuery:
    """Measure every answer.

    Args:
        questions: n of them.
        answers: to them, in the same order.
        rotations: whether the method predicts rotations alone; then nothing is said of positions and seating.
        judge: near, all or never; whom the exact judge of seating is asked about.
        workers: processes for the seating test.
    """
    targets, motions = questions.targets, answers.motions
    errors = pose_errors(centred(motions, targets) if rotations else motions, targets)
    nothing = np.full(len(questions), np.nan)
    seated = _seated(questions, motions, rotations, judge, workers)
    return PerQuery(
        query_id=np.array(questions.query_ids),
        track=np.array(questions.tracks),
        scene_id=np.array(questions.scene_ids),
        assembly_id=np.array([truth.assembly_id for truth in questions.truths]),
        covered=answers.covered,
        position_mm=nothing if rotations else errors.position * MM,
        rotation_deg=np.degrees(errors.rotation),
        mssd_mm=nothing if rotations else errors.mssd * MM,
        position_plain_mm=nothing if rotations else errors.position_plain * MM,
        rotation_plain_deg=np.degrees(errors.rotation_plain),
        confidence=answers.confidence,
        seconds=answers.seconds,
        **seated,
        **_described(questions),
    )


def centred(motions: Pose, targets: Targets) -> Pose:
    """Motions (n,) that turn as given and take each part's centroid to where the drawn goal has it.

    So the rotation alone decides which goal judges a method that predicts no positions.
    """
    home = targets.goals_drawn.apply(targets.anchors)
    return Pose(motions.wxyz, home - motions.rotate(targets.anchors))


def _seated(questions: Questions, motions: Pose, rotations: bool, judge: str, workers: int) -> dict[str, np.ndarray]:
    """The columns of the seating test, filled in where it is made."""
    n = len(questions)
    columns = {name: np.zeros(n, bool) for name in ("seated", "seated_strict", "judged", "differs")}
    columns["penetration_mm"] = np.full(n, np.nan)
    tested = np.flatnonzero(np.array(questions.tracks) != CURVES)
    if rotations or not len(tested):
        return columns
    truths = [questions.truths[i] for i in tested]
    found: Seatings = seatings(motions[tested], truths, questions.geometry, judge, workers)  # type: ignore[arg-type]
    columns["seated"][tested], columns["seated_strict"][tested] = found.seated, found.strict
    columns["judged"][tested], columns["differs"][tested] = found.judged, found.differs
    columns["penetration_mm"][tested] = found.penetration * MM
    return columns


def _described(questions: Questions) -> dict[str, np.ndarray]:
    """The columns that say what the queries are like."""
    truths = questions.truths
    held_out = questions.geometry.summary.get("held_out_families", ())
    kits = questions.geometry.kits
    return {
        "rest_mode": np.array([truth.rest_mode for truth in truths]),
        "tilt_deg": _tilt_deg(truths),
        "kits": np.array([truth.kits for truth in truths]),
        "held_out": np.array([truth.family in held_out for truth in truths]),
        "visible": np.array([truth.visible for truth in truths]),
        "symmetry": np.array([symmetry_of(truth.slot) for truth in truths]),
        "loose": np.array([bool(kits[truth.part_id].get("loose", False)) for truth in truths]),
    }


def _tilt_deg(truths: tuple[Truth, ...]) -> np.ndarray:
    """(n,) angle between the axis of each slot and the vertical."""
    world_from_kit = Pose(np.array([truth.world_from_kit.wxyz for truth in truths]), np.zeros(3))
    x, y, z = world_from_kit.rotate(UP).T
    return np.degrees(np.arctan2(np.hypot(x, y), z))


def symmetry_of(slot: Slot) -> str:
    """How a part may turn in its slot and be right."""
    if slot.free_axis is not None:
        return "free axis"
    return "several goals" if len(slot.goals) > 1 else "one goal"
