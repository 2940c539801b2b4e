"""Whether a predictor answers as the benchmark asks: every query, from itself alone, in the world it is shown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion, Predictor, to_prediction
from kit1000.values import LabelledDepth, Query, Truth

SAME_PLACE, SAME_TURN = 1e-6, 1e-5  # [m], [rad] between two answers to one question: what parallel sums leave open
ELSEWHERE = Pose.from_rotvec((0.0, 0.0, 2.0), (0.4, -0.3, 0.0))
"""A level turn and shift: up stays up and the table stays at z = 0, but nothing else is where it was."""


def check_predictor(
    predictor: Predictor,
    queries: Iterable[Query],
    truths: Sequence[Truth] | None = None,
    name: str = "predictor",
    moves: bool = True,
    moved_mm: float = 0.1,
    moved_deg: float = 0.1,
) -> None:
    """Check a predictor on queries of its tracks, best of several scenes.

    Each is answered by one rigid motion and a confidence from 0 to 1. The query stays as it was. Asked again, in
    another order, it gets the same answer. Where the whole world moves, camera and guess with it, so does the answer.

    Args:
        predictor: the method, as it is to be run.
        queries: a few of them.
        truths: those of the queries, for a method that says that it uses true geometry; without them it gets None.
        name: opens every message.
        moves: whether the last law is to hold; it cannot for a method that draws along fixed axes.
        moved_mm: how far the answer to a moved query may come to lie, at the pivot, beside the moved answer.
        moved_deg: the same for its rotation.
    """
    asked = list(queries)
    known = [None] * len(asked) if truths is None else list(truths)
    assert asked, f"{name}: there are no queries to check it on"
    assert len(asked) == len(known), f"{name}: {len(asked)} queries but {len(known)} truths"
    pairs = list(zip(asked, known, strict=True))
    first = [_answered(predictor, query, truth, name) for query, truth in pairs]
    again = [_answered(predictor, query, truth, name) for query, truth in reversed(pairs)][::-1]
    for query, one, other in zip(asked, first, again, strict=True):
        _check_same(query, one, other, name)
    for (query, truth), answer in zip(pairs, first, strict=True) if moves else ():
        truth_there = None if truth is None else moved_truth(truth, ELSEWHERE)
        there = _answered(predictor, moved_query(query, ELSEWHERE), truth_there, name)
        _check_moved(query, answer, there, (moved_mm, moved_deg), name)


def moved_query(query: Query, pose: Pose) -> Query:
    """The same question in a world moved by a pose: the images are the same, the camera stands elsewhere."""
    guess = None if query.guess is None else pose @ query.guess @ pose.inverse()
    read_image = partial(_moved_image, query, pose)
    return replace(query, pivot=pose.apply(query.pivot), guess=guess, read_image=read_image)


def moved_truth(truth: Truth, pose: Pose) -> Truth:
    """What is true in a world moved by a pose."""
    return replace(
        truth,
        anchor=pose.apply(truth.anchor),
        world_from_part=pose @ truth.world_from_part,
        world_from_kit=pose @ truth.world_from_kit,
        goal_drawn=pose @ truth.goal_drawn @ pose.inverse(),
    )


def _moved_image(query: Query, pose: Pose) -> LabelledDepth:
    view = query.view
    return LabelledDepth(replace(view, world_from_camera=pose @ view.world_from_camera), query.image.labels)


def _answered(predictor: Predictor, query: Query, truth: Truth | None, name: str) -> PredictedMotion:
    """What it says to a query, which it must leave as it was."""
    before = _contents(query)
    try:
        answer = predictor(query, truth)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise AssertionError(f"{name}: writes into query {query.id} ({error})") from error
    changed = [part for part, value in _contents(query).items() if value != before[part]]
    assert not changed, f"{name}: changes {', '.join(changed)} of query {query.id}"
    try:
        made = to_prediction(query, answer, 0.0)
    except InputError as error:
        raise AssertionError(f"{name}: {error}") from error
    return PredictedMotion(made.goal_from_now, made.confidence)


def _contents(query: Query) -> dict[str, bytes]:
    """All that a query holds."""
    poses = {"guess": query.guess, "camera pose": query.view.world_from_camera}
    arrays = {"pivot": query.pivot, "depth": query.view.depth, "masks": query.image.labels}
    told = {part: b"" if pose is None else pose.wxyz.tobytes() + pose.xyz.tobytes() for part, pose in poses.items()}
    return told | {part: array.tobytes() for part, array in arrays.items()}


def _check_same(query: Query, one: PredictedMotion, other: PredictedMotion, name: str) -> None:
    shift, turn = _apart(one.goal_from_now, other.goal_from_now, query.pivot)
    same = shift <= SAME_PLACE and turn <= SAME_TURN and abs(one.confidence - other.confidence) <= SAME_TURN
    assert same, (
        f"{name}: query {query.id} asked again, in another order, gets another answer: "
        f"{shift * 1e3:.3g} mm and {np.degrees(turn):.3g} degrees apart, confidence {one.confidence:g} "
        f"and {other.confidence:g} (draws from a stream of the query's own?)"
    )


def _check_moved(
    query: Query, answer: PredictedMotion, there: PredictedMotion, allowed: tuple[float, float], name: str
) -> None:
    """The answer in the moved world, brought back, is the answer."""
    back = ELSEWHERE.inverse() @ there.goal_from_now @ ELSEWHERE
    shift, turn = _apart(answer.goal_from_now, back, query.pivot)
    beside, turned = shift * 1e3, float(np.degrees(turn))
    moved_along = beside <= allowed[0] and turned <= allowed[1]
    unmoved = _apart(answer.goal_from_now, there.goal_from_now, query.pivot)
    hint = ": it is not in world coordinates" if max(unmoved) < 1e-6 else ""
    assert moved_along, (
        f"{name}: query {query.id} in a world moved and turned gets an answer that did not move along: "
        f"{beside:.3g} mm and {turned:.3g} degrees off{hint}"
    )


def _apart(one: Pose, other: Pose, pivot: np.ndarray) -> tuple[float, float]:
    """How far apart two motions take the pivot [m], and the angle between them [rad]."""
    shift = np.linalg.norm(one.apply(pivot) - other.apply(pivot))
    return float(shift), float((one.inverse() @ other).angle())
