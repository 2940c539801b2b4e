"""What counts as a prediction, and the check for implementers: a good method passes, a broken one gets the reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion, Predictor, to_prediction
from kit1000.testing import check_predictor, moved_geometry, moved_query, moved_truth
from kit1000.testing.predictors import WORLD_MOTION
from kit1000.values import Query, TrueGeometry

HALF_TURN = Pose.from_rotvec((0.0, 0.0, np.pi))


@pytest.fixture(scope="module")
def queries(data: Dataset) -> list[Query]:
    """Queries with a guess."""
    return list(data.split("train").queries("snap"))


@pytest.fixture(scope="module")
def geometries(data: Dataset, queries: list[Query]) -> list[TrueGeometry]:
    return [data.geometry.true_geometry(data.truth_of(query)) for query in queries]


def guess_of(query: Query) -> Pose:
    assert query.guess is not None
    return query.guess


def from_image(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """A method that keeps the rules: from the image and the guess."""
    return PredictedMotion(guess_of(query), float(query.part_mask.mean()))


def from_geometry(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """Moves the part's frame onto the assembly's."""
    assert geometry is not None
    return PredictedMotion(geometry.world_from_assembly @ geometry.world_from_part.inverse(), 1.0)


def test_a_method_that_keeps_the_rules_passes(queries: list[Query]) -> None:
    check_predictor(from_image, queries)


def test_the_true_geometry_is_moved_with_the_world(queries: list[Query], geometries: list[TrueGeometry]) -> None:
    check_predictor(from_geometry, queries, geometries)
    with pytest.raises(AssertionError, match=f"mine: {len(queries)} queries but 1 geometries"):
        check_predictor(from_geometry, queries, geometries[:1], "mine")


def remembering() -> Predictor:
    """Predicts from the number of its calls."""
    calls: list[str] = []

    def predict(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        calls.append(query.id)
        return PredictedMotion(Pose.from_translation((0.0, 0.0, 1e-3 * len(calls))) @ guess_of(query), 1.0)

    return predict


def writing(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    query.view.depth[0, 0] = 1.0
    return from_image(query, geometry)


def forcing(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """Shifts the pivot of a frozen query."""
    object.__setattr__(query, "pivot", query.pivot + 1e-3)
    return from_image(query, geometry)


BROKEN: dict[str, tuple[Callable[[Query, TrueGeometry | None], Any], str]] = {
    "remembers": (remembering(), "differ between two runs in different orders: .* mm"),
    "writes": (writing, "writes into query .* read-only"),
    "forces": (forcing, "changes pivot of query"),
    "a number": (
        lambda query, geometry: 1.0,
        r"expected a PredictedMotion.*, got float",
    ),
    "a tuple": (lambda query, geometry: (1.0, guess_of(query)), r"expected a PredictedMotion.*, got \(float, Pose\)"),
    "nothing": (lambda query, geometry: None, "expected a PredictedMotion.*, got NoneType"),
    "a batch": (
        lambda query, geometry: PredictedMotion(Pose.identity((2,)), 1.0),
        r"one motion, got a batch of shape \(2,\)",
    ),
    "percent": (lambda query, geometry: PredictedMotion(guess_of(query), 50.0), "expected 0 to 1, got 50"),
    "NaN": (lambda query, geometry: PredictedMotion(guess_of(query), float("nan")), "expected 0 to 1, got nan"),
    "words": (lambda query, geometry: (guess_of(query), "high"), "expected a number, got str"),
    "fixed": (
        lambda query, geometry: PredictedMotion(HALF_TURN, 1.0),
        "does not move along: .* degrees off: it is not in world",
    ),
    "camera": (
        lambda query, geometry: PredictedMotion(query.view.world_from_camera.inverse() @ guess_of(query), 1.0),
        "does not move along",
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_each_broken_method_gets_the_reason(fault: str, queries: list[Query]) -> None:
    predictor, message = BROKEN[fault]
    with pytest.raises(AssertionError, match=f"^mine: .*{message}"):
        check_predictor(predictor, queries, name="mine")


def test_a_method_with_axes_of_its_own_passes_without_the_moved_world(queries: list[Query]) -> None:
    check_predictor(lambda query, geometry: PredictedMotion(HALF_TURN, 1.0), queries, moves=False)


def test_a_check_without_queries_fails() -> None:
    with pytest.raises(AssertionError, match="no queries"):
        check_predictor(from_image, [])


def test_a_moved_query_shows_the_same_image_elsewhere(data: Dataset, queries: list[Query]) -> None:
    for query in queries:
        truth = data.truth_of(query)
        moved, moved_goal = moved_query(query, WORLD_MOTION), moved_truth(truth, WORLD_MOTION)
        assert moved.id == query.id
        np.testing.assert_array_equal(moved.view.depth, query.view.depth)
        # The goal in the moved world is the moved goal.
        there, goal = moved_goal.goal_drawn.apply(moved_goal.anchor), truth.goal_drawn.apply(truth.anchor)
        np.testing.assert_allclose(there, WORLD_MOTION.apply(goal), atol=1e-12)
        assert moved.guess is not None
        guessed = WORLD_MOTION.apply(guess_of(query).apply(query.pivot))
        np.testing.assert_allclose(moved.guess.apply(moved.pivot), guessed, atol=1e-12)


def test_a_moved_geometry_is_that_of_the_moved_truth(data: Dataset, queries: list[Query]) -> None:
    truth = data.truth_of(queries[0])
    one = moved_geometry(data.geometry.true_geometry(truth), WORLD_MOTION)
    other = data.geometry.true_geometry(moved_truth(truth, WORLD_MOTION))
    assert one.part is other.part
    assert one.assembly is other.assembly
    np.testing.assert_allclose(one.world_from_part.matrix(), other.world_from_part.matrix(), atol=1e-12)
    np.testing.assert_allclose(one.world_from_assembly.matrix(), other.world_from_assembly.matrix(), atol=1e-12)


@pytest.mark.parametrize("name", ["train", "val", "test", "test-all", "curves"])
def test_the_truth_and_the_true_geometry_of_a_query_are_those_recorded(data: Dataset, name: str) -> None:
    for scene in data.split(name, truth=True):
        assembly, *parts = scene.scene.bodies
        for query in scene.queries:
            truth, recorded = data.truth_of(query), scene.truth_of(query.id)
            assert (truth.query_id, truth.part_id) == (query.id, recorded.part_id)
            np.testing.assert_array_equal(truth.goal_drawn.matrix(), recorded.goal_drawn.matrix())
            geometry = data.geometry.true_geometry(truth)
            poses = (geometry.world_from_part, geometry.world_from_assembly)
            for pose, body in zip(poses, (parts[query.part], assembly), strict=True):
                np.testing.assert_allclose(pose.matrix(), body.world_from_body.matrix(), atol=1e-6)
            assert geometry.part is data.geometry.part(truth.part_id).mesh
            assert not [field for field in vars(geometry) if "goal" in field or "slot" in field]


def test_a_motion_becomes_a_prediction(queries: list[Query]) -> None:
    query = queries[0]
    prediction = to_prediction(query, PredictedMotion(guess_of(query), np.float32(0.25)), 1.5)  # pyright: ignore[reportArgumentType]
    assert (prediction.query_id, prediction.confidence, prediction.seconds) == (query.id, 0.25, 1.5)
    assert prediction.goal_from_now is query.guess
    with pytest.raises(InputError, match=rf"^{query.id}: expected a PredictedMotion"):
        to_prediction(query, (guess_of(query),), 0.0)  # pyright: ignore[reportArgumentType]
