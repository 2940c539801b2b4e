"""Time of scoring: our pose errors beside plain loops as in the BOP toolkit, and the seating test in its three modes.

    python bench/speed/scoring.py data/kit1000

Without a folder a tiny dataset is generated first. Predictions are the drawn goals of its test split with random
errors. The plain loops take all vertices of the mesh, all goals one after another, and 315 angles about a free axis.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.spatial import ConvexHull

from bench.measured_dataset import measured_dataset
from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion, goal_pose
from kit1000.values import Truth

STEPS = 315  # angles about a free axis: ceil(pi / 0.01)
ERRORS = {"small errors": (1e-3, 0.01), "large errors": (3e-3, 0.05)}
"""By name: standard deviations of the position [m] and rotation [rad] errors, in each coordinate."""
MS = 1e3  # milliseconds in a second


@dataclass(frozen=True)
class Scoring:
    """Measure how fast predictions are scored."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; a tiny one is generated when absent."""
    predictions: int = 100_000
    """For the pose errors: the queries of the split, repeated."""
    plain: int = 300
    """How many of them are scored by plain loops too."""
    queries: int = 400
    """For the seating test."""
    seed: int = 0
    """Of the errors."""


def main(options: Scoring) -> None:
    """Print the table."""
    with measured_dataset(options.data) as (dataset, _):
        split = dataset.split("test", truth=True)
        truths = [truth for scene in split for truth in scene.truths.values()]
        free = np.mean([truth.slot.free_axis is not None for truth in truths])
        print(f"{dataset.root.name}: {len(truths)} queries of test, {free:.0%} with a free axis")
        _pose_errors(dataset, truths, options)
        for name, (offset, angle) in ERRORS.items():
            print(f"{name}: {offset * 1e3:g} mm, {np.degrees(angle):.1f} degrees, standard deviations")
            _seatings(dataset, truths[: options.queries], np.random.default_rng(options.seed), offset, angle)


def with_errors(truths: list[Truth], rng: np.random.Generator, offset: float, angle: float) -> Pose:
    """(n,) drawn goals with normal offsets [m] and rotations [rad] about where they take the anchor."""
    n = len(truths)
    goals = Pose.stack([truth.goal_drawn for truth in truths])
    target = goals.apply(np.array([truth.anchor for truth in truths]))
    rotated = Pose.from_rotvec(rng.normal(size=(n, 3)) * angle) @ Pose.from_translation(-target) @ goals
    return Pose.from_translation(target + rng.normal(size=(n, 3)) * offset) @ rotated


def _timed(work: Callable[[], object]) -> float:
    """CPU seconds."""
    start = time.process_time()
    work()
    return time.process_time() - start


def _pose_errors(dataset: Dataset, truths: list[Truth], options: Scoring) -> None:
    vertices = {t.part_id: dataset.geometry.part(t.part_id).mesh.vertices for t in truths}

    def hull_of(part_id: str) -> np.ndarray:
        return vertices[part_id][ConvexHull(vertices[part_id]).vertices]

    predicted = with_errors(truths, np.random.default_rng(options.seed), *ERRORS["large errors"])
    targets = Targets.of(truths, hull_of)
    errors = pose_errors(predicted, targets)  # the first call compiles
    index = np.arange(options.predictions) % len(truths)
    many, motions = targets[index], predicted[index]
    ours = _timed(lambda: pose_errors(motions, many)) / options.predictions
    sample = np.random.default_rng(options.seed).permutation(len(truths))[: options.plain]
    plain = np.empty(len(sample))

    def loops() -> None:
        for k, i in enumerate(sample):
            plain[k] = plain_mssd(predicted[int(i)], truths[i], vertices[truths[i].part_id])

    theirs = _timed(loops) / len(sample)
    difference = plain - errors.mssd[sample]
    count = options.predictions
    print(f"pose errors of {count} predictions: {ours * count:.2f} s, {ours * MS:.4f} ms a query")
    print(f"MSSD by plain loops: {theirs * MS:.2f} ms a query, {theirs / ours:.0f} times our time")
    print(f"plain loops minus ours: {difference.min() * 1e3:.6f} to {difference.max() * 1e3:.3f} mm")


def plain_mssd(predicted: Pose, truth: Truth, vertices: np.ndarray) -> float:
    """[m] the smallest largest vertex distance over all goals and angles, one after another."""
    points = truth.world_from_part.apply(vertices)
    predicted_points, smallest = predicted.apply(points), np.inf
    steps = STEPS if truth.slot.free_axis is not None else 1
    for goal in range(len(truth.slot.goals)):
        rotated = goal_pose(truth.slot, goal, np.arange(steps) * 2 * np.pi / steps) if steps > 1 else None
        kit_from_part = truth.slot.goals[goal : goal + 1] if rotated is None else rotated
        motions = goal_motion(truth.world_from_part, truth.world_from_kit, kit_from_part).matrix()
        for motion in motions:
            distances = predicted_points - (points @ motion[:3, :3].T + motion[:3, 3])
            smallest = min(smallest, float(np.linalg.norm(distances, axis=1).max()))
    return smallest


def _seatings(dataset: Dataset, truths: list[Truth], rng: np.random.Generator, offset: float, angle: float) -> None:
    predicted = with_errors(truths, rng, offset, angle)
    for exact in ("never", "near", "all"):
        start, started = time.perf_counter(), time.process_time()
        results = seatings(predicted, truths, dataset.geometry, exact)
        wall, cpu = (MS * spent / len(truths) for spent in (time.perf_counter() - start, time.process_time() - started))
        print(
            f"  exact {exact:6}{wall:7.2f} ms a query ({cpu:.2f} of CPU), {results.seated.mean():.1%} seated, "
            f"{results.exact.mean():.1%} tested exactly, {results.disagrees.sum()} disagree"
        )


if __name__ == "__main__":
    try:
        main(tyro.cli(Scoring, description=__doc__))
    except Kit1000Error as error:
        raise SystemExit(f"scoring: {error}") from error
