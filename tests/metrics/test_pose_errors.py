"""Pose errors: closed form and brute force; zero at the truth, unchanged by symmetry and by moving the world."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import kit1000.metrics as metrics
from kit1000.errors import InputError, ShapeError
from kit1000.metrics import METRIC_VERSIONS, PoseErrors, Targets, nearest_goal_motions, pose_errors
from kit1000.pose import Pose, quaternion_angle, random_quaternions
from kit1000.queries.motions import goal_motion, goal_pose
from kit1000.testing import moved_truth
from kit1000.values import FreeAxis, Slot, Truth
from tests.samples.strategies import directions, poses, vectors

EXACT = 1e-9  # [m], [rad] largest error at a right goal
FINE = 2 * np.pi / 3600  # [rad] between the angles that brute force tries
FIELDS = [field.name for field in fields(PoseErrors)]


def truth_of(
    goals: int, free: bool, seed: int = 0, axis: np.ndarray | None = None, part_id: str = "part", drawn: int = 0
) -> Truth:
    """A query with random goals and poses; a free axis passes beside the part."""
    rng = np.random.default_rng([seed, goals, free])
    listed = Pose(random_quaternions(rng, goals), rng.uniform(-0.02, 0.02, (goals, 3)))
    direction = np.array([0.0, 0.6, 0.8]) if axis is None else axis
    slot = Slot(
        part_id, listed[0], 2.5e-3, 9e-3, listed, FreeAxis(np.array([3e-3, 0, 1e-3]), direction) if free else None
    )
    part, kit = (Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.4, 0.4, 3)) for _ in range(2))
    angle = rng.uniform(0, 2 * np.pi) if free else 0.0
    goal_drawn = goal_motion(part, kit, goal_pose(slot, drawn, angle))
    return Truth("q", "a", part_id, "family", "upright", 2, 0.9, part.xyz, part, kit, slot, goal_drawn)


@cache
def corners(part_id: str) -> np.ndarray:
    """(v, 3) [m] the hull of a synthetic part, about 50 mm long, another for each length of the id."""
    rng = np.random.default_rng(len(part_id))
    return rng.normal(size=(20 + 5 * len(part_id), 3)) * [16e-3, 10e-3, 6e-3]


def targets_of(*truths: Truth) -> Targets:
    return Targets.of(truths, corners)


def displaced(goal: Pose, offset: np.ndarray, rotvec: np.ndarray, anchor: np.ndarray) -> Pose:
    """A goal motion with a position error [m] and a rotation error [rad] about where it takes the anchor."""
    target = goal.apply(anchor)
    return Pose.from_translation(target + offset) @ Pose.from_rotvec(rotvec) @ Pose.from_translation(-target) @ goal


def brute_force(predicted: Pose, truth: Truth) -> tuple[float, int, float]:
    """MSSD [m], goal and angle over all goals, angles and vertices: 3600 angles, then 3600 about the best."""
    smallest = (np.inf, 0, 0.0)
    for k in range(len(truth.slot.goals)):
        best = 0.0
        if truth.slot.free_axis is not None:
            for angles in (np.arange(3600) * FINE, np.linspace(-FINE, FINE, 3600)):
                angles = best + angles
                best = float(angles[np.argmin(largest_distances(predicted, truth, k, angles))])
        smallest = min(smallest, (float(largest_distances(predicted, truth, k, np.array([best]))[0]), k, best))
    return smallest


def largest_distances(predicted: Pose, truth: Truth, goal: int, angles: np.ndarray) -> np.ndarray:
    """(n,) [m] the largest vertex distance to one goal, at n angles about the free axis."""
    kit_from_part = goal_pose(truth.slot, goal, angles if truth.slot.free_axis is not None else 0.0)
    batch = Pose(*map(np.atleast_2d, (kit_from_part.wxyz, kit_from_part.xyz)))
    motions = goal_motion(truth.world_from_part, truth.world_from_kit, batch)
    points = truth.world_from_part.apply(corners(truth.part_id))
    return np.linalg.norm(predicted.apply(points) - motions[:, None].apply(points), axis=2).max(axis=1)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("goals", "free"), [(1, False), (4, False), (1, True), (2, True)])
def test_pose_errors_equal_brute_force(goals: int, free: bool, seed: int) -> None:
    truth = truth_of(goals, free, seed)
    rng = np.random.default_rng(seed)
    size = (1e-3, 5e-3, 30e-3, 0.2)[seed]
    near = displaced(truth.goal_drawn, rng.normal(size=3) * size, rng.normal(size=3) * size * 30, truth.anchor)
    errors = pose_errors(near[None], targets_of(truth))
    mssd, goal, angle = brute_force(near, truth)
    assert errors.mssd[0] == pytest.approx(mssd, abs=3e-8)
    assert errors.goal[0] == goal
    nearest = goal_motion(truth.world_from_part, truth.world_from_kit, goal_pose(truth.slot, goal, angle))
    # where the largest distance is flat about its minimum, the angle itself is less precise
    assert errors.position[0] == pytest.approx(
        np.linalg.norm(near.apply(truth.anchor) - nearest.apply(truth.anchor)), abs=1e-6
    )
    assert errors.rotation[0] == pytest.approx(float(quaternion_angle(near.wxyz, nearest.wxyz)), abs=1e-4)


def test_the_search_over_angles_is_never_worse_than_3600_samples() -> None:
    """For a round part, where many vertices are about equally far, and errors from 1e-6 to 0.3."""
    angles = np.arange(48) * 2 * np.pi / 48
    rim = np.stack([20e-3 * np.cos(angles), 20e-3 * np.sin(angles), np.full(48, 20e-3)], axis=1)
    hull = np.concatenate([rim, rim * [1, 1, -1]])
    truth = replace(truth_of(1, True, axis=np.array([0.0, 0.0, 1.0])))
    rng = np.random.default_rng(0)
    n = 60
    sizes = 10 ** rng.uniform(-6, -0.5, (n, 1))
    predicted = displaced(
        truth.goal_drawn, rng.normal(size=(n, 3)) * sizes, rng.normal(size=(n, 3)) * sizes * 30, truth.anchor
    )
    errors = pose_errors(predicted, Targets.of([truth] * n, lambda part_id: hull)).mssd
    assert (errors <= least_of_samples(predicted, truth, hull) + 1e-12).all()


def test_the_search_over_angles_finds_the_least_of_several_minima() -> None:
    """A few corners in any pose take turns in being the farthest: three angles to start from would miss the least."""
    rng = np.random.default_rng(0)
    truth, n = truth_of(1, True), 300
    hull = rng.uniform(-30e-3, 30e-3, (8, 3))
    predicted = Pose(random_quaternions(rng, n), truth.goal_drawn.apply(truth.anchor) + rng.uniform(-0.1, 0.1, (n, 3)))
    predicted = predicted @ Pose.from_translation(-truth.anchor)
    errors = pose_errors(predicted, Targets.of([truth] * n, lambda part_id: hull)).mssd
    assert (errors <= least_of_samples(predicted, truth, hull) + 1e-5).all()


def least_of_samples(predicted: Pose, truth: Truth, hull: np.ndarray) -> np.ndarray:
    """(n,) [m] the least MSSD of motions (n, ...) to the goal at any of 3600 angles about the free axis."""
    angles = np.arange(3600) * FINE
    motions = goal_motion(truth.world_from_part, truth.world_from_kit, goal_pose(truth.slot, 0, angles))
    points = truth.world_from_part.apply(hull)
    at_goals = motions[:, None].apply(points)
    least = np.empty(len(predicted.xyz))
    for k in range(len(least)):
        difference = at_goals - predicted[k].apply(points)
        least[k] = np.sqrt(np.einsum("avk,avk->av", difference, difference).max(axis=1).min())
    return least


@given(st.integers(1, 5), st.booleans(), st.integers(0, 20), st.floats(-10, 10), poses())
def test_every_right_goal_has_no_error(goals: int, free: bool, seed: int, angle: float, world: Pose) -> None:
    """To 1e-9 m and rad, at any angle about the free axis, in any world frame."""
    truth = truth_of(goals, free, seed)
    truth = replace(
        truth, anchor=world.apply(truth.anchor), world_from_part=world @ truth.world_from_part,
        world_from_kit=world @ truth.world_from_kit, goal_drawn=world @ truth.goal_drawn @ world.inverse(),
    )  # fmt: skip
    right = [goal_pose(truth.slot, k, angle if free else 0.0) for k in range(goals)]
    predicted = goal_motion(truth.world_from_part, truth.world_from_kit, Pose.stack(right))
    errors = pose_errors(predicted, targets_of(*[truth] * goals))
    for error in (errors.position, errors.rotation, errors.mssd):
        assert error.max() <= EXACT
    assert free or (errors.goal == np.arange(goals)).all()


@given(vectors(0.02), directions(), st.floats(0, np.pi))
def test_errors_against_one_goal_equal_their_closed_form(shift: np.ndarray, axis: np.ndarray, angle: float) -> None:
    truth = truth_of(1, False)
    predicted = displaced(truth.goal_drawn, shift, angle * axis, truth.anchor)
    errors = pose_errors(predicted[None], targets_of(truth))
    assert errors.position[0] == pytest.approx(np.linalg.norm(shift), abs=1e-12)
    assert errors.rotation[0] == pytest.approx(angle, abs=1e-7)
    assert errors.position_plain[0] == errors.position[0]
    assert errors.rotation_plain[0] == errors.rotation[0]
    assert errors.mssd[0] >= errors.position[0] - 3e-3 or angle > 0.1  # the anchor lies inside the hull, or near it


def test_position_and_rotation_are_measured_against_the_same_goal() -> None:
    """Nearest in position is not nearest in MSSD: a part at the right position the wrong way round."""
    truth = truth_of(1, False)
    flipped = displaced(truth.slot.goals[0], np.array([5e-3, 0, 0]), np.array([0, 0, np.pi]), np.zeros(3))
    slot = replace(truth.slot, goals=Pose.stack([truth.slot.goals[0], flipped]))
    truth = replace(truth, slot=slot)
    flipped_motion = goal_motion(truth.world_from_part, truth.world_from_kit, flipped)
    first_motion = goal_motion(truth.world_from_part, truth.world_from_kit, slot.goals[0])
    to_first = first_motion.apply(truth.anchor) - flipped_motion.apply(truth.anchor)
    predicted = Pose(flipped_motion.wxyz, flipped_motion.xyz + to_first)
    errors = pose_errors(predicted[None], targets_of(truth))
    assert errors.goal[0] == 1
    assert errors.position[0] == pytest.approx(5e-3)
    assert errors.rotation[0] == pytest.approx(0, abs=EXACT)
    assert errors.position_plain[0] == pytest.approx(0, abs=EXACT)
    assert errors.rotation_plain[0] == pytest.approx(np.pi)


def test_the_nearest_goals_are_those_of_the_errors() -> None:
    truths = [truth_of(goals, free, seed) for seed, (goals, free) in enumerate([(3, False), (2, True), (1, True)])]
    targets = targets_of(*truths)
    predicted = displaced(targets.goals_drawn, np.full((3, 3), 2e-3), np.full((3, 3), 0.1), targets.anchors)
    errors = pose_errors(predicted, targets)
    nearest = nearest_goal_motions(targets, errors)
    assert np.array_equal(quaternion_angle(predicted.wxyz, nearest.wxyz), errors.rotation)
    again = pose_errors(nearest, targets)
    assert max(again.mssd.max(), again.position.max(), again.rotation.max()) <= EXACT
    for i, truth in enumerate(truths):
        goal = goal_pose(truth.slot, int(errors.goal[i]), float(errors.angle[i]))
        expected = goal_motion(truth.world_from_part, truth.world_from_kit, goal)
        assert np.allclose(nearest[i].matrix(), expected.matrix(), atol=1e-12)


def mixed() -> Targets:
    kinds = [(1, False, "a"), (3, True, "bb"), (2, False, "a"), (1, True, "ccc"), (5, False, "bb")]
    return targets_of(*(truth_of(goals, free, k, part_id=part) for k, (goals, free, part) in enumerate(kinds)))


@given(st.lists(st.integers(0, 4), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_some_queries_have_the_errors_that_they_have_among_all(rows: list[int], seed: int) -> None:
    targets, rng = mixed(), np.random.default_rng(seed)
    predicted = Pose(random_quaternions(rng, len(targets)), rng.uniform(-0.4, 0.4, (len(targets), 3)))
    every = pose_errors(predicted, targets)
    some = pose_errors(predicted[np.array(rows)], targets[np.array(rows)])
    assert all(np.array_equal(getattr(some, name), getattr(every, name)[rows]) for name in FIELDS)
    assert (np.abs(every.angle) <= np.pi).all()


def test_no_queries_have_no_errors() -> None:
    errors = pose_errors(Pose.identity((0,)), Targets.of([], corners))
    assert all(getattr(errors, name).shape == (0,) for name in FIELDS)


@pytest.mark.parametrize("shape", [(), (4,), (5, 1)])
def test_predictions_of_another_number_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError, match=r"predicted: expected a batch of shape \(5,\)"):
        pose_errors(Pose.identity(shape), mixed())


def test_arrays_in_place_of_poses_are_refused() -> None:
    with pytest.raises(ShapeError, match="predicted: expected a Pose of 5, got ndarray"):
        pose_errors(np.zeros((5, 7)), mixed())  # pyright: ignore[reportArgumentType]


WRONG = {
    "goal_starts": (np.array([0, 1, 4, 4, 7, 12]), "goal_starts: expected increasing numbers"),
    "hull_starts": (np.array([0, 5]), "hull_starts: expected increasing numbers from 0 to"),
    "hull_index": (np.array([0, 1, 0, 7, 1]), "hull_index: expected 0 to 2, got 0 to 7"),
    "anchors": (np.zeros((5, 2)), "anchors: expected float64 of shape"),
    "goals": (Pose.identity((3,)), r"goals: expected a batch of shape \(12,\)"),
    "axis_directions": (np.full((5, 3), 0.7), "axis_directions: expected unit vectors"),
    "axis_points": (np.zeros((4, 3)), "axis_points"),
    "hulls": (np.full((2, 3), np.nan), "hulls: .*not finite"),
}


@pytest.mark.parametrize("name", WRONG)
def test_targets_that_do_not_fit_together_are_refused(name: str) -> None:
    value, message = WRONG[name]
    targets = mixed()
    with_axes = {"axis_points": np.zeros((5, 3))} if name == "axis_directions" else {}
    with pytest.raises(InputError, match=message):
        replace(targets, **with_axes, **{name: value})


def test_every_metric_has_a_version() -> None:
    assert all(version >= 1 for version in METRIC_VERSIONS.values())
    assert {"position", "rotation", "mssd", "seated", "penetration"} <= set(METRIC_VERSIONS)
    assert all(hasattr(metrics, name) for name in metrics.__all__)


@pytest.mark.parametrize("seed", range(4))
def test_the_world_frame_does_not_matter(seed: int) -> None:
    kinds = [(1, False), (4, False), (1, True), (2, True), (3, False)]
    truths, rng = [truth_of(goals, free, seed) for goals, free in kinds], np.random.default_rng(seed)
    targets = targets_of(*truths)
    motions = displaced(targets.goals_drawn, rng.normal(0, 3e-3, (5, 3)), rng.normal(0, 0.1, (5, 3)), targets.anchors)
    world = Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.3, 0.3, 3))
    moved = targets_of(*(moved_truth(truth, world) for truth in truths))
    errors, again = pose_errors(motions, targets), pose_errors(world @ motions @ world.inverse(), moved)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(again, name), getattr(errors, name), atol=1e-6)
