"""The laws of a metric of predicted motions: zero at every goal, invariant to symmetry, frame, batch and order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from kit1000.metrics import Targets, pose_errors
from kit1000.pose import Pose, random_quaternions
from kit1000.testing import moved_truth
from kit1000.values import FreeAxis, Slot, Truth

ZERO = 1e-9  # [m], [rad] largest value that counts as no error
EQUAL = 1e-6  # [m], [rad] largest difference of equal values: a search over angles has a finite resolution
FAR = 1e3  # [m] of a prediction far away
CORNERS = 24  # corners of the round samples: rotations by whole corners map them onto themselves
KEYED_PARTS = ("sample-0", "sample-4")
Z = np.array([0.0, 0.0, 1.0])
Metric = Callable[[Pose, Targets], np.ndarray]


def _named(name: str, motions: Pose, targets: Targets) -> np.ndarray:
    return getattr(pose_errors(motions, targets), name)


symmetric = pytest.mark.parametrize("metric", [partial(_named, name) for name in ("position", "rotation", "mssd")])
every = pytest.mark.parametrize(
    "metric",
    [partial(_named, name) for name in ("position", "rotation", "mssd", "position_plain", "rotation_plain")],
)
seeds = pytest.mark.parametrize("seed", [0, 1])


def sample_truths(rng: np.random.Generator) -> list[Truth]:
    """Ground truth of five parts: one goal; a group of 4; a free axis; an axis and a flip; 3 goals at other places."""
    quarters = Pose.from_rotvec(np.arange(4)[:, None] * np.pi / 2 * Z)
    flip = Pose.stack([Pose.identity(), Pose.from_rotvec(np.array([np.pi, 0, 0]))])
    axis, steps = FreeAxis(np.zeros(3), Z), np.arange(3)[:, None]
    shifted = Pose.from_rotvec(steps * np.array([0.0, 2.0, 0.5]), steps * np.array([1e-3, 0, 2e-3]))
    kinds = ((quarters[:1], None), (quarters, None), (quarters[:1], axis), (flip, axis), (shifted, None))
    return [sample_truth(f"sample-{k}", group, axis, rng) for k, (group, axis) in enumerate(kinds)]


def sample_truth(part_id: str, group: Pose, axis: FreeAxis | None, rng: np.random.Generator) -> Truth:
    goals = Pose.from_translation(np.array([0.0, 0.0, -3e-3])) @ group
    part, kit = random_pose(rng), random_pose(rng)
    slot = Slot(part_id, goals[0], 2.5e-3, 10e-3, goals, axis)
    goal = kit @ goals[0] @ part.inverse()
    return Truth("q", "a", part_id, "wheel", "upright", 1, 1.0, part.xyz, part, kit, slot, goal)


def random_pose(rng: np.random.Generator) -> Pose:
    return Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.3, 0.3, 3))


def sample_hull(part_id: str) -> np.ndarray:
    """(v, 3) [m] hull of a sample part: a wheel of 24 corners, with a knob if its rotation is unique."""
    angles = np.arange(CORNERS) * 2 * np.pi / CORNERS
    rim = np.stack([0.02 * np.cos(angles), 0.02 * np.sin(angles), np.zeros(CORNERS)], axis=1)
    wheel = np.concatenate([rim - [0, 0, 9e-3], rim + [0, 0, 9e-3]])
    return np.concatenate([wheel, [[0.03, 0.004, 0.002]]]) if part_id in KEYED_PARTS else wheel


def targets_of(truths: Sequence[Truth]) -> Targets:
    return Targets.of(truths, sample_hull)


def near_motions(targets: Targets, rng: np.random.Generator) -> Pose:
    """(n,) the drawn goals with errors of about 5 mm and 10 degrees."""
    rotvec = Pose(random_quaternions(rng, len(targets)), np.zeros(3)).rotvec() * 0.05
    target = targets.goals_drawn.apply(targets.anchors)
    there, back = target + rng.normal(size=(len(targets), 3)) * 3e-3, Pose.from_translation(-target)
    return Pose.from_translation(there) @ Pose.from_rotvec(rotvec) @ back @ targets.goals_drawn


@every
@seeds
def test_it_is_zero_at_the_truth_positive_elsewhere_and_finite(metric: Metric, seed: int) -> None:
    rng = np.random.default_rng(seed)
    targets = targets_of(sample_truths(rng))
    n = len(targets)
    assert metric(targets.goals_drawn, targets).max() <= ZERO
    for _ in range(3):
        assert (metric(near_motions(targets, rng), targets) > EQUAL).all()
    far = Pose(random_quaternions(rng, n), rng.uniform(-FAR, FAR, (n, 3)))
    for motions in (far, Pose.identity((n,))):
        errors = metric(motions, targets)
        assert errors.shape == (n,)
        assert np.isfinite(errors).all()
        assert (errors >= 0).all()


@every
@seeds
def test_the_world_frame_does_not_matter(metric: Metric, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truths = sample_truths(rng)
    motions = near_motions(targets_of(truths), rng)
    errors = metric(motions, targets_of(truths))
    for _ in range(4):
        motion = random_pose(rng)
        moved = targets_of([moved_truth(truth, motion) for truth in truths])
        assert np.allclose(metric(motion @ motions @ motion.inverse(), moved), errors, rtol=0, atol=EQUAL)


@symmetric
@seeds
def test_the_order_of_goals_and_their_angles_do_not_matter(metric: Metric, seed: int) -> None:
    rng = np.random.default_rng(seed)
    truths = sample_truths(rng)
    motions = near_motions(targets_of(truths), rng)
    errors = metric(motions, targets_of(truths))
    for _ in range(4):
        again = targets_of([replace(truth, slot=reordered(truth.slot, rng)) for truth in truths])
        assert np.allclose(metric(motions, again), errors, rtol=0, atol=EQUAL)


def reordered(slot: Slot, rng: np.random.Generator) -> Slot:
    """A slot with its goals in another order, each at another angle about the free axis."""
    goals = slot.goals[rng.permutation(len(slot.goals))]
    if slot.free_axis is None:
        return replace(slot, goals=goals)
    point, angles = slot.free_axis.point, rng.uniform(0, 2 * np.pi, (len(goals), 1))
    about = Pose.from_rotvec(angles * slot.free_axis.direction)
    return replace(slot, goals=Pose.from_translation(point) @ about @ Pose.from_translation(-point) @ goals)


@symmetric
def test_a_rotation_of_the_part_by_its_own_symmetry_does_not_matter(metric: Metric) -> None:
    rng = np.random.default_rng(0)
    targets = targets_of(sample_truths(rng))
    motions = near_motions(targets, rng)
    errors = metric(motions, targets)
    for corner in range(0, CORNERS, 2):
        # keyed parts stay; the group of 4 rotates by quarters, a wheel by whole corners
        steps = np.array([0, corner // 6 * 6, corner, corner, 0])
        rotation = Pose.from_rotvec(steps[:, None] * 2 * np.pi / CORNERS * Z)
        symmetry = targets.world_from_part @ rotation @ targets.world_from_part.inverse()
        assert np.allclose(metric(motions @ symmetry, targets), errors, rtol=0, atol=EQUAL)
