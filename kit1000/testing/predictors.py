"""Whether a predictor keeps the rules of the benchmark: repeatable, from one query alone, in world coordinates."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion, Predictor, to_prediction
from kit1000.values import LabelledDepth, Query, TrueGeometry, Truth

SAME_POSITION, SAME_ROTATION = 1e-6, 1e-5  # [m], [rad] between two runs on one query: the rounding of parallel sums
WORLD_MOTION = Pose.from_rotvec((0.0, 0.0, 2.0), (0.4, -0.3, 0.0))
"""A yaw and a level shift of the whole world: up stays up and the table stays at z = 0."""


def check_predictor(
    predictor: Predictor,
    queries: Iterable[Query],
    geometries: Sequence[TrueGeometry] | None = None,
    name: str = "predictor",
    moves: bool = True,
    moved_mm: float = 0.1,
    moved_deg: float = 0.1,
) -> None:
    """Check a predictor on queries of its tracks, best of several scenes.

    It predicts one rigid motion for each, with a confidence from 0 to 1, and leaves the query as it was. A second run
    in another order gives the same. Where the whole world is moved, with camera and guess, so is the prediction.

    Args:
        predictor: the method, as it is to be run.
        queries: a few of them.
        geometries: the true geometry of each, for a method that sets `uses_true_geometry`; without them it gets None.
        name: opens every message.
        moves: whether the last rule is checked; a method that draws along fixed axes cannot keep it.
        moved_mm: largest distance, at the pivot, between the prediction in the moved world and the moved prediction.
        moved_deg: the same for the rotation.
    """
    queries = list(queries)
    given = [None] * len(queries) if geometries is None else list(geometries)
    assert queries, f"{name}: there are no queries to check it on"
    assert len(queries) == len(given), f"{name}: {len(queries)} queries but {len(given)} geometries"
    pairs = list(zip(queries, given, strict=True))
    first = [_motion(predictor, query, geometry, name) for query, geometry in pairs]
    second = [_motion(predictor, query, geometry, name) for query, geometry in reversed(pairs)][::-1]
    for query, one, other in zip(queries, first, second, strict=True):
        _check_repeatable(query, one, other, name)
    for (query, geometry), predicted in zip(pairs, first, strict=True) if moves else ():
        moved = None if geometry is None else moved_geometry(geometry, WORLD_MOTION)
        there = _motion(predictor, moved_query(query, WORLD_MOTION), moved, name)
        _check_moves_along(query, predicted, there, (moved_mm, moved_deg), name)


def moved_query(query: Query, pose: Pose) -> Query:
    """The query in a world moved by a pose: the same images, from a camera that stands elsewhere."""
    guess = None if query.guess is None else pose @ query.guess @ pose.inverse()
    read_image = partial(_moved_image, query, pose)
    return replace(query, pivot=pose.apply(query.pivot), guess=guess, read_image=read_image)


def moved_geometry(geometry: TrueGeometry, pose: Pose) -> TrueGeometry:
    """The true geometry in a world moved by a pose."""
    return replace(
        geometry,
        world_from_part=pose @ geometry.world_from_part,
        world_from_assembly=pose @ geometry.world_from_assembly,
    )


def moved_truth(truth: Truth, pose: Pose) -> Truth:
    """The ground truth in a world moved by a pose."""
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


def _motion(predictor: Predictor, query: Query, geometry: TrueGeometry | None, name: str) -> PredictedMotion:
    """What it predicts for a query, which it must leave as it was."""
    before = _contents(query)
    try:
        predicted = predictor(query, geometry)
    except ValueError as error:
        if "read-only" not in str(error):
            raise
        raise AssertionError(f"{name}: writes into query {query.id} ({error})") from error
    changed = [field for field, value in _contents(query).items() if value != before[field]]
    assert not changed, f"{name}: changes {', '.join(changed)} of query {query.id}"
    try:
        prediction = to_prediction(query, predicted, 0.0)
    except InputError as error:
        raise AssertionError(f"{name}: {error}") from error
    return PredictedMotion(prediction.goal_from_now, prediction.confidence)


def _contents(query: Query) -> dict[str, bytes]:
    """The bytes of all that a query holds, by name."""
    poses = {"guess": query.guess, "camera pose": query.view.world_from_camera}
    arrays = {"pivot": query.pivot, "depth": query.view.depth, "masks": query.image.labels}
    raw = {field: b"" if pose is None else pose.wxyz.tobytes() + pose.xyz.tobytes() for field, pose in poses.items()}
    return raw | {field: array.tobytes() for field, array in arrays.items()}


def _check_repeatable(query: Query, one: PredictedMotion, other: PredictedMotion, name: str) -> None:
    shift, angle = _difference(one.goal_from_now, other.goal_from_now, query.pivot)
    confidence = abs(one.confidence - other.confidence)
    repeatable = shift <= SAME_POSITION and angle <= SAME_ROTATION and confidence <= SAME_ROTATION
    assert repeatable, (
        f"{name}: predictions for query {query.id} differ between two runs in different orders: "
        f"{shift * 1e3:.3g} mm and {np.degrees(angle):.3g} degrees apart, confidence {one.confidence:g} "
        f"and {other.confidence:g} (draws from a stream of the query's own?)"
    )


def _check_moves_along(
    query: Query, predicted: PredictedMotion, there: PredictedMotion, allowed: tuple[float, float], name: str
) -> None:
    """The prediction in the moved world, moved back, is the prediction."""
    back = WORLD_MOTION.inverse() @ there.goal_from_now @ WORLD_MOTION
    shift, angle = _difference(predicted.goal_from_now, back, query.pivot)
    shift_mm, angle_deg = shift * 1e3, float(np.degrees(angle))
    unmoved = _difference(predicted.goal_from_now, there.goal_from_now, query.pivot)
    hint = ": it is not in world coordinates" if max(unmoved) < 1e-6 else ""
    moves_along = shift_mm <= allowed[0] and angle_deg <= allowed[1]
    assert moves_along, (
        f"{name}: in a moved and rotated world the prediction for query {query.id} does not move along: "
        f"{shift_mm:.3g} mm and {angle_deg:.3g} degrees off{hint}"
    )


def _difference(one: Pose, other: Pose, pivot: np.ndarray) -> tuple[float, float]:
    """How far apart two motions take the pivot [m], and the angle between them [rad]."""
    shift = np.linalg.norm(one.apply(pivot) - other.apply(pivot))
    return float(shift), float((one.inverse() @ other).angle())
