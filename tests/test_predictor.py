"""What counts as an answer, and the check for implementers: a good method passes, each broken one is told why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.motions import goal_motion
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion, Predictor, to_prediction
from kit1000.testing import check_predictor, moved_query, moved_truth
from kit1000.testing.predictors import ELSEWHERE
from kit1000.values import Query, Truth

HALF_TURN = Pose.from_rotvec((0.0, 0.0, np.pi))
Asked = list[tuple[Query, Truth]]


@pytest.fixture(scope="module")
def asked(mini: Path) -> Asked:
    """Queries with a guess, with their truths."""
    split = Dataset(mini).split("train", truth=True)
    return [(query, scene.truth_of(query.id)) for scene in split for query in scene.queries if query.track == "snap"]


def guessed(query: Query) -> Pose:
    assert query.guess is not None
    return query.guess


def steady(query: Query, truth: Truth | None) -> PredictedMotion:
    """A method without a fault: what it sees of the part decides, and the guess."""
    return PredictedMotion(guessed(query), float(query.part_mask.mean()))


def knowing(query: Query, truth: Truth | None) -> PredictedMotion:
    assert truth is not None
    return PredictedMotion(goal_motion(truth.world_from_part, truth.world_from_kit, truth.slot.kit_from_part), 1.0)


def test_a_method_without_a_fault_passes(asked: Asked) -> None:
    check_predictor(steady, [query for query, _ in asked])


def test_a_method_that_uses_true_geometry_gets_it_moved_along(asked: Asked) -> None:
    check_predictor(knowing, [query for query, _ in asked], [truth for _, truth in asked])


def remembering() -> Predictor:
    """Answers by how often it was asked."""
    calls: list[str] = []

    def answer(query: Query, truth: Truth | None) -> PredictedMotion:
        calls.append(query.id)
        return PredictedMotion(Pose.from_translation((0.0, 0.0, 1e-3 * len(calls))) @ guessed(query), 1.0)

    return answer


def writing(query: Query, truth: Truth | None) -> PredictedMotion:
    query.view.depth[0, 0] = 1.0
    return steady(query, truth)


def forcing(query: Query, truth: Truth | None) -> PredictedMotion:
    """Shifts the pivot of a frozen query."""
    object.__setattr__(query, "pivot", query.pivot + 1e-3)
    return steady(query, truth)


BROKEN: dict[str, tuple[Callable[[Query, Truth | None], Any], str]] = {
    "remembers": (remembering(), "asked again, in another order, gets another answer: .* mm"),
    "writes": (writing, "writes into query .* read-only"),
    "forces": (forcing, "changes pivot of query"),
    "a number": (
        lambda query, truth: 1.0,
        r"expected a PredictedMotion\(goal_from_now: Pose, confidence: float\), got float",
    ),
    "a tuple": (lambda query, truth: (1.0, guessed(query)), r"expected a PredictedMotion.*, got \(float, Pose\)"),
    "nothing": (lambda query, truth: None, "expected a PredictedMotion.*, got NoneType"),
    "a batch": (
        lambda query, truth: PredictedMotion(Pose.identity((2,)), 1.0),
        r"one motion, got a batch of shape \(2,\)",
    ),
    "percent": (lambda query, truth: PredictedMotion(guessed(query), 50.0), "expected 0 to 1, got 50"),
    "NaN": (lambda query, truth: PredictedMotion(guessed(query), float("nan")), "expected 0 to 1, got nan"),
    "words": (lambda query, truth: (guessed(query), "high"), "expected a number, got str"),
    "fixed": (
        lambda query, truth: PredictedMotion(HALF_TURN, 1.0),
        "did not move along: .* degrees off: it is not in world",
    ),
    "camera": (
        lambda query, truth: PredictedMotion(query.view.world_from_camera.inverse() @ guessed(query), 1.0),
        "did not move along",
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_each_broken_method_is_told_what_is_wrong(fault: str, asked: Asked) -> None:
    predictor, said = BROKEN[fault]
    with pytest.raises(AssertionError, match=f"^mine: .*{said}"):
        check_predictor(predictor, [query for query, _ in asked], name="mine")


def test_a_method_with_axes_of_its_own_may_stay_where_it_is(asked: Asked) -> None:
    check_predictor(lambda query, truth: PredictedMotion(HALF_TURN, 1.0), [query for query, _ in asked], moves=False)


def test_a_check_on_nothing_is_no_check() -> None:
    with pytest.raises(AssertionError, match="no queries"):
        check_predictor(steady, [])


def test_a_moved_query_shows_the_same_parts_elsewhere(asked: Asked) -> None:
    for query, truth in asked:
        moved, known = moved_query(query, ELSEWHERE), moved_truth(truth, ELSEWHERE)
        assert moved.id == query.id
        np.testing.assert_array_equal(moved.view.depth, query.view.depth)
        # Whatever carries the part home carries it home there: what moves and then goes, goes and then moves.
        went, moved_on = known.goal_drawn.apply(known.anchor), ELSEWHERE.apply(truth.goal_drawn.apply(truth.anchor))
        np.testing.assert_allclose(went, moved_on, atol=1e-12)
        assert moved.guess is not None
        np.testing.assert_allclose(
            moved.guess.apply(moved.pivot), ELSEWHERE.apply(guessed(query).apply(query.pivot)), atol=1e-12
        )


def test_an_answer_becomes_a_prediction(asked: Asked) -> None:
    query, _ = asked[0]
    prediction = to_prediction(query, PredictedMotion(guessed(query), np.float32(0.25)), 1.5)  # pyright: ignore[reportArgumentType]
    assert (prediction.query_id, prediction.confidence, prediction.seconds) == (query.id, 0.25, 1.5)
    assert prediction.goal_from_now is query.guess
    with pytest.raises(InputError, match=rf"^{query.id}: expected a PredictedMotion"):
        to_prediction(query, (guessed(query),), 0.0)  # pyright: ignore[reportArgumentType]
