"""Conformance of a metric of predicted motions: zero at every goal, invariant to symmetry, frame and batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from kit1000.metrics.targets import Targets
from kit1000.pose import Pose, random_quaternions
from kit1000.testing.predictors import moved_truth
from kit1000.values import FreeAxis, Slot, Truth

Metric = Callable[[Pose, Targets], np.ndarray]
"""The error (n,) of n predicted motions, one for each target."""

ZERO_TOLERANCE = 1e-9
"""Largest value that counts as no error, in the unit of the metric (SI)."""
EQUAL_TOLERANCE = 1e-6
"""Largest difference of two values that should be equal: a search over angles has a finite resolution."""
FAR_DISTANCE = 1e3  # [m] of a prediction far away
WHEEL_CORNERS = 24  # corners of the round samples: rotations by whole corners map them onto themselves
KEYED_PARTS = ("sample-0", "sample-4")
Z = np.array([0.0, 0.0, 1.0])


def check_metric(metric: Metric, name: str = "metric", symmetric: bool = True, seed: int = 0) -> None:
    """Check a metric of pose errors on sample targets: keyed, of several goals, free about an axis, and all at once.

    The value is one finite number of at least 0 for each prediction, independent of the batch; 0 at the ground truth
    and larger elsewhere; independent of the world frame. Every goal counts as the ground truth, at any angle about the
    free axis. The order of the goals and the angles at which they are listed do not matter, nor does a rotation of the
    part by its symmetry.

    Args:
        metric: takes motions (n,) and targets of n queries.
        name: begins every message.
        symmetric: whether the metric is symmetry-aware.
        seed: of the samples.
    """
    rng = np.random.default_rng(seed)
    truths = sample_truths(rng)
    targets = Targets.of(truths, sample_hull)
    near, far = near_motions(targets, rng), far_motions(targets, rng)
    for motions in (near, far, Pose.identity((len(targets),))):
        _errors(metric, motions, targets, name)
    _check_zero(metric, targets, symmetric, name, rng)
    _check_batch(metric, near, targets, name)
    _check_world_frame(metric, near, truths, name, rng)
    if symmetric:
        _check_goal_order(metric, near, truths, name, rng)
        _check_symmetry(metric, near, targets, name)


def sample_truths(rng: np.random.Generator) -> list[Truth]:
    """Ground truth of queries about five parts, posed at random.

    One goal; a group of 4; a free axis; a free axis and a flip; 3 goals that differ in position as well.
    """
    quarters = Pose.from_rotvec(np.arange(4)[:, None] * np.pi / 2 * Z)
    flip = Pose.stack([Pose.identity(), Pose.from_rotvec(np.array([np.pi, 0, 0]))])
    axis = FreeAxis(np.zeros(3), Z)
    steps = np.arange(3)[:, None]
    shifted = Pose.from_rotvec(steps * np.array([0.0, 2.0, 0.5]), steps * np.array([1e-3, 0, 2e-3]))
    kinds = ((quarters[:1], None), (quarters, None), (quarters[:1], axis), (flip, axis), (shifted, None))
    return [_sample_truth(f"sample-{k}", group, axis, rng) for k, (group, axis) in enumerate(kinds)]


def near_motions(targets: Targets, rng: np.random.Generator) -> Pose:
    """(n,) the drawn goals with errors of about 5 mm and 10 degrees."""
    n = len(targets)
    rotvec = Pose(random_quaternions(rng, n), np.zeros(3)).rotvec() * 0.05
    offset = rng.normal(size=(n, 3)) * 3e-3
    return _with_errors(targets, targets.goals_drawn, rotvec, offset)


def far_motions(targets: Targets, rng: np.random.Generator) -> Pose:
    """(n,) random rotations, up to a kilometre away."""
    n = len(targets)
    return Pose(random_quaternions(rng, n), rng.uniform(-FAR_DISTANCE, FAR_DISTANCE, (n, 3)))


def _sample_truth(part_id: str, group: Pose, axis: FreeAxis | None, rng: np.random.Generator) -> Truth:
    seat = Pose.from_translation(np.array([0.0, 0.0, -3e-3]))
    world_from_part, world_from_kit = _random_pose(rng), _random_pose(rng)
    goals = seat @ group
    return Truth(
        query_id=f"{part_id}-query",
        assembly_id="sample",
        part_id=part_id,
        family="wheel",
        rest_mode="upright",
        kits=1,
        visible=1.0,
        anchor=world_from_part.xyz,
        world_from_part=world_from_part,
        world_from_kit=world_from_kit,
        slot=Slot(part_id, goals[0], 2.5e-3, 10e-3, goals, axis),
        goal_drawn=world_from_kit @ goals[0] @ world_from_part.inverse(),
    )


def _random_pose(rng: np.random.Generator) -> Pose:
    return Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.3, 0.3, 3))


def sample_hull(part_id: str) -> np.ndarray:
    """(v, 3) [m] hull of a sample part: a wheel of 24 corners, with a knob if its rotation is unique."""
    angles = np.arange(WHEEL_CORNERS) * 2 * np.pi / WHEEL_CORNERS
    rim = np.stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), np.zeros(WHEEL_CORNERS)], axis=1)
    wheel = np.concatenate([rim - [0, 0, 9e-3], rim + [0, 0, 9e-3]])
    return np.concatenate([wheel, [[0.03, 0.004, 0.002]]]) if part_id in KEYED_PARTS else wheel


def _with_errors(targets: Targets, motions: Pose, rotvec: np.ndarray, offset: np.ndarray) -> Pose:
    """Motions (n,) followed by rotations (n, 3) [rad] about where they take the anchor, and offsets (n, 3) [m]."""
    target = motions.apply(targets.anchors)
    return Pose.from_translation(target + offset) @ Pose.from_rotvec(rotvec) @ Pose.from_translation(-target) @ motions


def _errors(metric: Metric, motions: Pose, targets: Targets, name: str) -> np.ndarray:
    errors = metric(motions, targets)
    n = len(targets)
    shape = getattr(errors, "shape", None)
    kind = f"{type(errors).__name__} of shape {shape}"
    assert shape == (n,), f"{name}: returns {kind} for {n} predictions, expected shape ({n},)"
    assert np.isfinite(errors).all(), f"{name}: is {errors[~np.isfinite(errors)][0]} for a finite prediction"
    assert (errors >= 0).all(), f"{name}: is {errors.min():.3g}, expected 0 or more"
    return errors


def _check_zero(metric: Metric, targets: Targets, symmetric: bool, name: str, rng: np.random.Generator) -> None:
    truth = _errors(metric, targets.goals_drawn, targets, name)
    assert truth.max() <= ZERO_TOLERANCE, f"{name}: is {truth.max():.3g} at the ground truth, expected 0"
    wrong = np.array([_errors(metric, near_motions(targets, rng), targets, name) for _ in range(3)])
    positive = (wrong > EQUAL_TOLERANCE).all(axis=0)
    smallest = wrong[:, ~positive].min(initial=np.inf)
    assert positive.all(), f"{name}: is {smallest:.3g} for a prediction about 5 mm and 10 degrees off, expected more"
    for goals in _equivalent_goals(targets, rng) if symmetric else ():
        largest = _errors(metric, goals, targets, name).max()
        assert largest <= ZERO_TOLERANCE, f"{name}: is {largest:.3g} at a goal equivalent to the drawn one, expected 0"


def _equivalent_goals(targets: Targets, rng: np.random.Generator) -> Sequence[Pose]:
    """Batches (n,) of random goals, at random angles about the free axis where there is one."""
    free, counts = targets.has_free_axis[:, None], np.diff(targets.goal_starts)
    points, directions = (np.where(free, array, 0.0) for array in (targets.axis_points, targets.axis_directions))
    batches = []
    for _ in range(8):
        rotation = Pose.from_rotvec(rng.uniform(0, 2 * np.pi, free.shape) * directions)
        about = Pose.from_translation(points) @ rotation @ Pose.from_translation(-points)
        batches.append(about @ targets.goals[targets.goal_starts[:-1] + rng.integers(counts)])
    return batches


def _check_batch(metric: Metric, motions: Pose, targets: Targets, name: str) -> None:
    """Single predictions, another order, and an empty batch."""
    batch = _errors(metric, motions, targets, name)
    reverse = np.arange(len(targets))[::-1]
    reordered = _errors(metric, motions[reverse], targets[reverse], name)[reverse]
    _check_equal(reordered, batch, f"{name}: depends on the order of the predictions")
    single = [_errors(metric, motions[i : i + 1], targets[i : i + 1], name)[0] for i in range(len(targets))]
    _check_equal(np.array(single), batch, f"{name}: depends on the other predictions of the batch")
    _errors(metric, motions[:0], targets[:0], name)


def _check_world_frame(
    metric: Metric, motions: Pose, truths: Sequence[Truth], name: str, rng: np.random.Generator
) -> None:
    errors = _errors(metric, motions, Targets.of(truths, sample_hull), name)
    for _ in range(4):
        motion = _random_pose(rng)
        moved = Targets.of([moved_truth(truth, motion) for truth in truths], sample_hull)
        moved_errors = _errors(metric, motion @ motions @ motion.inverse(), moved, name)
        _check_equal(moved_errors, errors, f"{name}: changes with the world frame")


def _check_goal_order(
    metric: Metric, motions: Pose, truths: Sequence[Truth], name: str, rng: np.random.Generator
) -> None:
    """Goals in another order, each at another angle about the free axis."""
    errors = _errors(metric, motions, Targets.of(truths, sample_hull), name)
    for _ in range(4):
        reordered = [replace(truth, slot=_reordered_goals(truth.slot, rng)) for truth in truths]
        found = _errors(metric, motions, Targets.of(reordered, sample_hull), name)
        _check_equal(
            found, errors, f"{name}: depends on the order of the goals, or on their angles about the free axis"
        )


def _reordered_goals(slot: Slot, rng: np.random.Generator) -> Slot:
    goals = slot.goals[rng.permutation(len(slot.goals))]
    if slot.free_axis is None:
        return replace(slot, goals=goals)
    point, angles = slot.free_axis.point, rng.uniform(0, 2 * np.pi, (len(goals), 1))
    about = Pose.from_rotvec(angles * slot.free_axis.direction)
    return replace(slot, goals=Pose.from_translation(point) @ about @ Pose.from_translation(-point) @ goals)


def _check_symmetry(metric: Metric, motions: Pose, targets: Targets, name: str) -> None:
    """A rotation of the part by its own symmetry, before the predicted motion, changes nothing."""
    errors = _errors(metric, motions, targets, name)
    for corner in range(0, WHEEL_CORNERS, 2):
        # keyed parts stay; the group of 4 rotates by quarters, a wheel by whole corners
        steps = np.array([0, corner // 6 * 6, corner, corner, 0])
        rotation = Pose.from_rotvec(steps[:, None] * 2 * np.pi / WHEEL_CORNERS * Z)
        symmetry = targets.world_from_part @ rotation @ targets.world_from_part.inverse()
        found = _errors(metric, motions @ symmetry, targets, name)
        _check_equal(found, errors, f"{name}: changes when a part is rotated by its own symmetry")


def _check_equal(errors: np.ndarray, expected: np.ndarray, message: str) -> None:
    difference = np.abs(errors - expected)
    worst = difference.argmax()
    assert (difference <= EQUAL_TOLERANCE).all(), f"{message}: {expected[worst]:.6g} becomes {errors[worst]:.6g}"
