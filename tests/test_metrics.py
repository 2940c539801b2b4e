"""Pose errors: zero at every right goal, equal to brute force over angles and vertices; what is no input is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kit1000.metrics as metrics
from kit1000.errors import InputError, ShapeError
from kit1000.metrics import METRIC_VERSIONS, PoseErrors, Targets, nearest_goal_motions, pose_errors
from kit1000.motions import goal_motion, goal_pose
from kit1000.pose import Pose, quaternion_angle, random_quaternions
from kit1000.testing import check_metric
from kit1000.values import FreeAxis, Slot, Truth
from tests.strategies import directions, poses, vectors

laws = settings(max_examples=40)
EXACT = 1e-9  # [m], [rad] most at a right goal
FINE = 2 * np.pi / 3600  # [rad] between the angles that the plain loop tries
FIELDS = [field.name for field in fields(PoseErrors)]


def truth_of(
    goals: int, free: bool, seed: int = 0, axis: np.ndarray | None = None, part_id: str = "part", drawn: int = 0
) -> Truth:
    """A query with made-up goals, an axis beside the part where there is one, everything posed at random."""
    rng = np.random.default_rng([seed, goals, free])
    listed = Pose(random_quaternions(rng, goals), rng.uniform(-0.02, 0.02, (goals, 3)))
    direction = np.array([0.0, 0.6, 0.8]) if axis is None else axis
    slot = Slot(
        part_id, listed[0], 2.5e-3, 9e-3, listed, FreeAxis(np.array([3e-3, 0, 1e-3]), direction) if free else None
    )
    part, kit = (Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.4, 0.4, 3)) for _ in range(2))
    turn = rng.uniform(0, 2 * np.pi) if free else 0.0
    home = goal_motion(part, kit, goal_pose(slot, drawn, turn))
    return Truth("q", "a", part_id, "family", "upright", 2, 0.9, part.xyz, part, kit, slot, home)


@cache
def corners(part_id: str) -> np.ndarray:
    """(v, 3) [m] the hull of a made-up part, about 50 mm long; each id has another."""
    rng = np.random.default_rng(len(part_id))
    return rng.normal(size=(20 + 5 * len(part_id), 3)) * [16e-3, 10e-3, 6e-3]


def target_of(*truths: Truth) -> Targets:
    return Targets.of(truths, corners)


def missed(goal: Pose, shift: np.ndarray, rotvec: np.ndarray, anchor: np.ndarray) -> Pose:
    """A motion that misses a goal by a shift [m] and a turn [rad] about where it takes the anchor."""
    home = goal.apply(anchor)
    return Pose.from_translation(home + shift) @ Pose.from_rotvec(rotvec) @ Pose.from_translation(-home) @ goal


def looped(predicted: Pose, truth: Truth) -> tuple[float, int, float]:
    """MSSD [m], goal and turn by brute force over goals, angles and vertices: 3600 angles, 3600 about the best."""
    found = (np.inf, 0, 0.0)
    for k in range(len(truth.slot.goals)):
        best = 0.0
        if truth.slot.free_axis is not None:
            for turns in (np.arange(3600) * FINE, np.linspace(-FINE, FINE, 3600)):
                turns = best + turns
                best = float(turns[np.argmin(distances(predicted, truth, k, turns))])
        found = min(found, (float(distances(predicted, truth, k, np.array([best]))[0]), k, best))
    return found


def distances(predicted: Pose, truth: Truth, goal: int, turns: np.ndarray) -> np.ndarray:
    """(n,) [m] the largest distance of a vertex to its place at one goal, at n turns."""
    kit_from_part = goal_pose(truth.slot, goal, turns if truth.slot.free_axis is not None else 0.0)
    home = goal_motion(
        truth.world_from_part, truth.world_from_kit, Pose(*map(np.atleast_2d, (kit_from_part.wxyz, kit_from_part.xyz)))
    )
    points = truth.world_from_part.apply(corners(truth.part_id))
    return np.linalg.norm(predicted.apply(points) - home[:, None].apply(points), axis=2).max(axis=1)


@pytest.mark.parametrize("name", ["position", "rotation", "mssd"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_errors_keep_the_laws_of_a_metric(name: str, seed: int) -> None:
    check_metric(lambda predicted, targets: getattr(pose_errors(predicted, targets), name), name, seed=seed)


@pytest.mark.parametrize("name", ["position_plain", "rotation_plain"])
def test_plain_errors_keep_them_all_but_that_of_symmetry(name: str) -> None:
    def plain(predicted: Pose, targets: Targets) -> np.ndarray:
        return getattr(pose_errors(predicted, targets), name)

    check_metric(plain, name, symmetric=False)
    with pytest.raises(AssertionError, match="as right as the drawn one"):
        check_metric(plain, name)


def first_goal(predicted: Pose, targets: Targets) -> np.ndarray:
    """Blind to symmetry."""
    home = targets.goals[targets.goal_starts[:-1]]
    return np.linalg.norm(predicted.apply(targets.anchors) - home.apply(targets.anchors), axis=1)


def whole_degrees(predicted: Pose, targets: Targets) -> np.ndarray:
    return np.round(np.degrees(pose_errors(predicted, targets).rotation)) - 1.0


def relative(predicted: Pose, targets: Targets) -> np.ndarray:
    """To the worst of those handed over."""
    mssd = pose_errors(predicted, targets).mssd
    return mssd / max(mssd.max(initial=0), 1e-6)


def one_axis(predicted: Pose, targets: Targets) -> np.ndarray:
    """Along x alone."""
    home = nearest_goal_motions(targets, pose_errors(predicted, targets))
    return np.abs((predicted.apply(targets.anchors) - home.apply(targets.anchors))[:, 0])


BAD: dict[str, tuple[Callable[[Pose, Targets], np.ndarray], str]] = {
    "nothing": (lambda predicted, targets: np.zeros(len(targets)), "for a prediction some 5 mm"),
    "one number": (lambda predicted, targets: np.zeros(()), "of shape .* expected"),
    "negative": (whole_degrees, "expected 0 or more"),
    "where it lands": (lambda predicted, targets: np.linalg.norm(predicted.xyz, axis=1), "at the truth"),
    "relative": (relative, "what else|truth"),
    "overflow": (lambda p, t: np.where(pose_errors(p, t).mssd > 1, np.inf, pose_errors(p, t).mssd), "finite"),
    "one axis": (one_axis, "world"),
    "first goal": (first_goal, "as right as the drawn one|at the truth|listed"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_metric_is_found_out(name: str) -> None:
    bad, said = BAD[name]
    with pytest.raises(AssertionError, match=said):
        check_metric(bad, name)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("goals", "free"), [(1, False), (4, False), (1, True), (2, True)])
def test_they_equal_plain_loops_over_goals_angles_and_vertices(goals: int, free: bool, seed: int) -> None:
    truth = truth_of(goals, free, seed)
    rng = np.random.default_rng(seed)
    size = (1e-3, 5e-3, 30e-3, 0.2)[seed]
    near = missed(truth.goal_drawn, rng.normal(size=3) * size, rng.normal(size=3) * size * 30, truth.anchor)
    found = pose_errors(near[None], target_of(truth))
    mssd, goal, turn = looped(near, truth)
    assert found.mssd[0] == pytest.approx(mssd, abs=3e-8)
    assert found.goal[0] == goal
    home = goal_motion(truth.world_from_part, truth.world_from_kit, goal_pose(truth.slot, goal, turn))
    # where the largest distance is flat about its least, the turn itself is known less well
    assert found.position[0] == pytest.approx(
        np.linalg.norm(near.apply(truth.anchor) - home.apply(truth.anchor)), abs=1e-6
    )
    assert found.rotation[0] == pytest.approx(float(quaternion_angle(near.wxyz, home.wxyz)), abs=1e-4)


def test_the_search_over_turns_is_never_worse_than_3600_angles() -> None:
    """At errors from none to lost, for a round part: the case in which many vertices compete."""
    angles = np.arange(48) * 2 * np.pi / 48
    rim = np.stack([20e-3 * np.cos(angles), 20e-3 * np.sin(angles), np.full(48, 20e-3)], axis=1)
    hull = np.concatenate([rim, rim * [1, 1, -1]])
    truth = replace(truth_of(1, True, axis=np.array([0.0, 0.0, 1.0])))
    rng = np.random.default_rng(0)
    n = 60
    sizes = 10 ** rng.uniform(-6, -0.5, (n, 1))
    predicted = missed(
        truth.goal_drawn, rng.normal(size=(n, 3)) * sizes, rng.normal(size=(n, 3)) * sizes * 30, truth.anchor
    )
    found = pose_errors(predicted, Targets.of([truth] * n, lambda part_id: hull)).mssd
    turned = goal_motion(truth.world_from_part, truth.world_from_kit, goal_pose(truth.slot, 0, np.arange(3600) * FINE))
    points = truth.world_from_part.apply(hull)
    there = turned[:, None].apply(points)
    for k in range(n):
        looped = np.linalg.norm(there - predicted[k].apply(points), axis=2).max(axis=1).min()
        assert found[k] <= looped + 1e-12


@laws
@given(st.integers(1, 5), st.booleans(), st.integers(0, 20), st.floats(-10, 10), poses())
def test_every_right_goal_scores_nothing(goals: int, free: bool, seed: int, turn: float, world: Pose) -> None:
    """To 1e-9 m and rad, at any turn, wherever the world stands."""
    truth = truth_of(goals, free, seed)
    truth = replace(
        truth, anchor=world.apply(truth.anchor), world_from_part=world @ truth.world_from_part,
        world_from_kit=world @ truth.world_from_kit, goal_drawn=world @ truth.goal_drawn @ world.inverse(),
    )  # fmt: skip
    right = [goal_pose(truth.slot, k, turn if free else 0.0) for k in range(goals)]
    predicted = goal_motion(truth.world_from_part, truth.world_from_kit, Pose.stack(right))
    found = pose_errors(predicted, target_of(*[truth] * goals))
    for errors in (found.position, found.rotation, found.mssd):
        assert errors.max() <= EXACT
    assert free or (found.goal == np.arange(goals)).all()


@laws
@given(vectors(0.02), directions(), st.floats(0, np.pi))
def test_one_goal_is_measured_in_closed_form(shift: np.ndarray, axis: np.ndarray, angle: float) -> None:
    truth = truth_of(1, False)
    predicted = missed(truth.goal_drawn, shift, angle * axis, truth.anchor)
    found = pose_errors(predicted[None], target_of(truth))
    assert found.position[0] == pytest.approx(np.linalg.norm(shift), abs=1e-12)
    assert found.rotation[0] == pytest.approx(angle, abs=1e-7)
    assert found.position_plain[0] == found.position[0]
    assert found.rotation_plain[0] == found.rotation[0]
    assert found.mssd[0] >= found.position[0] - 3e-3 or angle > 0.1  # the anchor lies inside the hull, or near it


def test_one_goal_judges_position_and_rotation_alike() -> None:
    """Nearest in position is not nearest in MSSD: a part that landed in its place the wrong way round."""
    truth = truth_of(1, False)
    turned = missed(truth.slot.goals[0], np.array([5e-3, 0, 0]), np.array([0, 0, np.pi]), np.zeros(3))
    slot = replace(truth.slot, goals=Pose.stack([truth.slot.goals[0], turned]))
    truth = replace(truth, slot=slot)
    there = goal_motion(truth.world_from_part, truth.world_from_kit, turned)
    home = goal_motion(truth.world_from_part, truth.world_from_kit, slot.goals[0])
    predicted = Pose(there.wxyz, there.xyz + home.apply(truth.anchor) - there.apply(truth.anchor))
    found = pose_errors(predicted[None], target_of(truth))
    assert found.goal[0] == 1
    assert found.position[0] == pytest.approx(5e-3)
    assert found.rotation[0] == pytest.approx(0, abs=EXACT)
    assert found.position_plain[0] == pytest.approx(0, abs=EXACT)
    assert found.rotation_plain[0] == pytest.approx(np.pi)


def test_golden_values() -> None:
    """One made-up query of each kind, missed by 4 mm and 0.2 rad."""
    truths = [truth_of(1, False), truth_of(4, False), truth_of(1, True), truth_of(2, True)]
    targets = target_of(*truths)
    off = np.tile([2e-3, -2e-3, 2.8284e-3], (4, 1)), np.tile([0.1, -0.1, 0.1414], (4, 1))
    found = pose_errors(missed(targets.goals_drawn, *off, targets.anchors), targets)
    golden = {
        # 2026-11-21: first version of the metrics
        "position": [0.003999981, 0.003999981, 0.004869826, 0.004387856],
        "rotation": [0.1999849, 0.1999849, 0.1933784, 0.1687036],
        "mssd": [0.0073651, 0.00915996, 0.006819885, 0.008454633],
        "angle": [0, 0, -0.9119003, 1.929566],
    }
    for name, values in golden.items():
        assert getattr(found, name) == pytest.approx(values, rel=1e-5, abs=1e-9), name


def test_the_judging_goals_are_those_the_errors_are_read_against() -> None:
    truths = [truth_of(goals, free, seed) for seed, (goals, free) in enumerate([(3, False), (2, True), (1, True)])]
    targets = target_of(*truths)
    predicted = missed(targets.goals_drawn, np.full((3, 3), 2e-3), np.full((3, 3), 0.1), targets.anchors)
    found = pose_errors(predicted, targets)
    home = nearest_goal_motions(targets, found)
    assert np.array_equal(quaternion_angle(predicted.wxyz, home.wxyz), found.rotation)
    again = pose_errors(home, targets)
    assert max(again.mssd.max(), again.position.max(), again.rotation.max()) <= EXACT
    for i, truth in enumerate(truths):
        goal = goal_pose(truth.slot, int(found.goal[i]), float(found.angle[i]))
        wanted = goal_motion(truth.world_from_part, truth.world_from_kit, goal)
        assert np.allclose(home[i].matrix(), wanted.matrix(), atol=1e-12)


def mixed() -> Targets:
    kinds = [(1, False, "a"), (3, True, "bb"), (2, False, "a"), (1, True, "ccc"), (5, False, "bb")]
    return target_of(*(truth_of(goals, free, k, part_id=part) for k, (goals, free, part) in enumerate(kinds)))


@pytest.mark.parametrize("index", [[3, 0, 3], slice(1, 4), [False, True, True, False, True], []])
def test_some_of_the_targets_are_measured_as_among_all(index: list | slice) -> None:
    targets = mixed()
    predicted = missed(targets.goals_drawn, np.full((5, 3), 3e-3), np.full((5, 3), 0.2), targets.anchors)
    chosen = np.arange(5)[np.array(index, dtype=int) if index == [] else index]
    every, some = pose_errors(predicted, targets), pose_errors(predicted[chosen], targets[chosen])
    assert len(targets[chosen]) == len(chosen)
    for name in FIELDS:
        assert np.array_equal(getattr(some, name), getattr(every, name)[chosen]), name


def test_a_hull_is_asked_for_once_a_part() -> None:
    asked: list[str] = []

    def hull_of(part_id: str) -> np.ndarray:
        asked.append(part_id)
        return corners(part_id)

    Targets.of([truth_of(1, False, k, part_id=part) for k, part in enumerate(["x", "y", "x", "x"])], hull_of)
    assert asked == ["x", "y"]


def test_no_queries_have_no_errors() -> None:
    found = pose_errors(Pose.identity((0,)), Targets.of([], corners))
    assert all(getattr(found, name).shape == (0,) for name in FIELDS)


def test_what_is_measured_is_read_only() -> None:
    targets = mixed()
    found = pose_errors(targets.goals_drawn, targets)
    with pytest.raises(ValueError, match="read-only"):
        found.mssd[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        targets.axis_points[0] = 1


@pytest.mark.parametrize("shape", [(), (4,), (5, 1)])
def test_predictions_of_another_number_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ShapeError, match=r"predicted: expected a batch of shape \(5,\)"):
        pose_errors(Pose.identity(shape), mixed())


def test_arrays_for_poses_are_refused() -> None:
    with pytest.raises(ShapeError, match="predicted: expected a Pose of 5, got ndarray"):
        pose_errors(np.zeros((5, 7)), mixed())  # pyright: ignore[reportArgumentType]


WRONG = {
    "goal_starts": (np.array([0, 1, 4, 4, 7, 12]), "goal_starts: expected numbers that rise"),
    "hull_starts": (np.array([0, 5]), "hull_starts: expected numbers that rise from 0 to"),
    "shape": (np.array([0, 1, 0, 7, 1]), "shape: expected indices of 3 shapes, got 7"),
    "anchors": (np.zeros((5, 2)), "anchors: expected float64 of shape"),
    "goals": (Pose.identity((3,)), r"goals: expected a batch of shape \(12,\)"),
    "axis_directions": (np.full((5, 3), 0.7), "axis_directions: expected unit vectors"),
    "axis_points": (np.zeros((4, 3)), "axis_points"),
    "hulls": (np.full((2, 3), np.nan), "hulls: .*not finite"),
}


@pytest.mark.parametrize("name", WRONG)
def test_targets_that_do_not_fit_together_are_refused(name: str) -> None:
    value, said = WRONG[name]
    targets = mixed()
    with_axes = {"axis_points": np.zeros((5, 3))} if name == "axis_directions" else {}
    with pytest.raises(InputError, match=said):
        replace(targets, **with_axes, **{name: value})


def test_every_metric_has_a_version() -> None:
    assert all(version >= 1 for version in METRIC_VERSIONS.values())
    assert {"position", "rotation", "mssd", "seated", "penetration"} <= set(METRIC_VERSIONS)
    assert all(hasattr(metrics, name) for name in metrics.__all__)
