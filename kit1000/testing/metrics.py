"""Whether a metric of predicted motions keeps the laws that make its numbers comparable."""

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

ZERO = 1e-9
"""Most that is taken for no error, in the unit of the metric (SI)."""
SAME = 1e-6
"""Most by which two errors may differ that should be one: a search over turns about an axis ends somewhere."""
FAR = 1e3  # [m] of a prediction that is lost
WHEEL = 24  # corners of the round samples: turns by whole corners keep them
KEYED = ("sample-0", "sample-4")
Z = np.array([0.0, 0.0, 1.0])


def check_metric(metric: Metric, name: str = "metric", symmetric: bool = True, seed: int = 0) -> None:
    """Check a metric of pose errors on sample targets: keyed, of several goals, free about an axis, and all at once.

    One finite number of at least 0 for each prediction, whatever the company it is handed over in; 0 at the truth and
    more elsewhere; the same wherever the world stands. With several goals each is the truth, at any turn about the free
    axis; their order and the turns at which they are listed change nothing, nor does turning a part by its symmetry.

    Args:
        metric: takes motions (n,) and targets of n queries.
        name: opens every message.
        symmetric: whether it claims to be blind to which of several right goals is meant.
        seed: of the samples.
    """
    rng = np.random.default_rng(seed)
    truths = sample_truths(rng)
    targets = Targets.of(truths, sample_hull)
    near, far = near_motions(targets, rng), far_motions(targets, rng)
    for motions in (near, far, Pose.identity((len(targets),))):
        _errors(metric, motions, targets, name)
    _check_zero(metric, targets, symmetric, name, rng)
    _check_company(metric, near, targets, name)
    _check_world(metric, near, truths, name, rng)
    if symmetric:
        _check_listing(metric, near, truths, name, rng)
        _check_turned(metric, near, targets, name)


def sample_truths(rng: np.random.Generator) -> list[Truth]:
    """Queries about five parts, posed at random.

    One goal; a group of 4; a free axis; a free axis and a flip; 3 goals, between which the part is shifted as well.
    """
    turns = Pose.from_rotvec(np.arange(4)[:, None] * np.pi / 2 * Z)
    flip = Pose.stack([Pose.identity(), Pose.from_rotvec(np.array([np.pi, 0, 0]))])
    axis = FreeAxis(np.zeros(3), Z)
    apart = Pose.from_rotvec(
        np.arange(3)[:, None] * np.array([0.0, 2.0, 0.5]), np.arange(3)[:, None] * np.array([1e-3, 0, 2e-3])
    )
    kinds = ((turns[:1], None), (turns, None), (turns[:1], axis), (flip, axis), (apart, None))
    return [_sample(f"sample-{k}", group, axis, rng) for k, (group, axis) in enumerate(kinds)]


def near_motions(targets: Targets, rng: np.random.Generator) -> Pose:
    """(n,) the drawn goals, missed by some 5 mm and 10 degrees."""
    n = len(targets)
    off = Pose(random_quaternions(rng, n), np.zeros(3)).rotvec() * 0.05
    shift = rng.normal(size=(n, 3)) * 3e-3
    return _about_anchor(targets, targets.goals_drawn, off, shift)


def far_motions(targets: Targets, rng: np.random.Generator) -> Pose:
    """(n,) any turn, to a kilometre away."""
    n = len(targets)
    return Pose(random_quaternions(rng, n), rng.uniform(-FAR, FAR, (n, 3)))


def _sample(part_id: str, group: Pose, axis: FreeAxis | None, rng: np.random.Generator) -> Truth:
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
    """(v, 3) [m] hull of the part of a sample: a wheel of 24 corners, with a knob on it where it is keyed."""
    angles = np.arange(WHEEL) * 2 * np.pi / WHEEL
    rim = np.stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), np.zeros(WHEEL)], axis=1)
    wheel = np.concatenate([rim - [0, 0, 9e-3], rim + [0, 0, 9e-3]])
    return np.concatenate([wheel, [[0.03, 0.004, 0.002]]]) if part_id in KEYED else wheel


def _about_anchor(targets: Targets, motions: Pose, rotvec: np.ndarray, shift: np.ndarray) -> Pose:
    """Motions (n,) followed by turns (n, 3) [rad] about where they take the anchor, and shifts (n, 3) [m]."""
    home = motions.apply(targets.anchors)
    return Pose.from_translation(home + shift) @ Pose.from_rotvec(rotvec) @ Pose.from_translation(-home) @ motions


def _errors(metric: Metric, motions: Pose, targets: Targets, name: str) -> np.ndarray:
    found = metric(motions, targets)
    n = len(targets)
    shape = getattr(found, "shape", None)
    assert shape == (n,), f"{name}: gives {type(found).__name__} of shape {shape} for {n} predictions, expected ({n},)"
    assert np.isfinite(found).all(), f"{name}: gives {found[~np.isfinite(found)][0]} for a prediction that is finite"
    assert (found >= 0).all(), f"{name}: gives {found.min():.3g}, expected 0 or more"
    return found


def _check_zero(metric: Metric, targets: Targets, symmetric: bool, name: str, rng: np.random.Generator) -> None:
    truth = _errors(metric, targets.goals_drawn, targets, name)
    assert truth.max() <= ZERO, f"{name}: gives {truth.max():.3g} at the truth, expected 0"
    wrong = np.array([_errors(metric, near_motions(targets, rng), targets, name) for _ in range(3)])
    told = (wrong > SAME).all(axis=0)
    assert told.all(), f"{name}: gives {wrong[:, ~told].min():.3g} for a prediction some 5 mm and 10 degrees off"
    for goals in _right_goals(targets, rng) if symmetric else ():
        found = _errors(metric, goals, targets, name)
        assert found.max() <= ZERO, f"{name}: gives {found.max():.3g} at a goal that is as right as the drawn one"


def _right_goals(targets: Targets, rng: np.random.Generator) -> Sequence[Pose]:
    """Batches (n,) of goals drawn evenly, turned about the free axis where there is one."""
    free, counts = targets.free[:, None], np.diff(targets.goal_starts)
    points, directions = (np.where(free, array, 0.0) for array in (targets.axis_points, targets.axis_directions))
    batches = []
    for _ in range(8):
        turn = Pose.from_rotvec(rng.uniform(0, 2 * np.pi, free.shape) * directions)
        about = Pose.from_translation(points) @ turn @ Pose.from_translation(-points)
        batches.append(about @ targets.goals[targets.goal_starts[:-1] + rng.integers(counts)])
    return batches


def _check_company(metric: Metric, motions: Pose, targets: Targets, name: str) -> None:
    """Alone, in another order, and none at all."""
    together = _errors(metric, motions, targets, name)
    back = np.arange(len(targets))[::-1]
    found = _errors(metric, motions[back], targets[back], name)[back]
    _check_same(found, together, f"{name}: depends on the order of the predictions")
    alone = [_errors(metric, motions[i : i + 1], targets[i : i + 1], name)[0] for i in range(len(targets))]
    _check_same(np.array(alone), together, f"{name}: depends on what else is measured")
    _errors(metric, motions[:0], targets[:0], name)


def _check_world(metric: Metric, motions: Pose, truths: Sequence[Truth], name: str, rng: np.random.Generator) -> None:
    here = _errors(metric, motions, Targets.of(truths, sample_hull), name)
    for _ in range(4):
        motion = _random_pose(rng)
        there = Targets.of([moved_truth(truth, motion) for truth in truths], sample_hull)
        found = _errors(metric, motion @ motions @ motion.inverse(), there, name)
        _check_same(found, here, f"{name}: changes when the world is moved")


def _check_listing(metric: Metric, motions: Pose, truths: Sequence[Truth], name: str, rng: np.random.Generator) -> None:
    """Goals in another order, each listed at another turn about the free axis."""
    here = _errors(metric, motions, Targets.of(truths, sample_hull), name)
    for _ in range(4):
        listed = [replace(truth, slot=_listed_anew(truth.slot, rng)) for truth in truths]
        found = _errors(metric, motions, Targets.of(listed, sample_hull), name)
        _check_same(found, here, f"{name}: depends on how the goals are listed")


def _listed_anew(slot: Slot, rng: np.random.Generator) -> Slot:
    goals = slot.goals[rng.permutation(len(slot.goals))]
    if slot.free_axis is None:
        return replace(slot, goals=goals)
    point, turns = slot.free_axis.point, rng.uniform(0, 2 * np.pi, (len(goals), 1))
    about = Pose.from_rotvec(turns * slot.free_axis.direction)
    return replace(slot, goals=Pose.from_translation(point) @ about @ Pose.from_translation(-point) @ goals)


def _check_turned(metric: Metric, motions: Pose, targets: Targets, name: str) -> None:
    """A part turned by its own symmetry, before it is moved as predicted, is the same part."""
    here = _errors(metric, motions, targets, name)
    for corner in range(0, WHEEL, 2):
        # Keyed parts stay; a group of 4 turns by quarters; a wheel by whole corners
        steps = np.array([0, corner // 6 * 6, corner, corner, 0])
        turn = Pose.from_rotvec(steps[:, None] * 2 * np.pi / WHEEL * Z)
        now = targets.world_from_part @ turn @ targets.world_from_part.inverse()
        found = _errors(metric, motions @ now, targets, name)
        _check_same(found, here, f"{name}: changes when a part is turned by its own symmetry")


def _check_same(found: np.ndarray, wanted: np.ndarray, said: str) -> None:
    off = np.abs(found - wanted)
    assert (off <= SAME).all(), f"{said}: {wanted[off.argmax()]:.6g} becomes {found[off.argmax()]:.6g}"
