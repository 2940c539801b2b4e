"""Scoring side by side: our pose errors with plain loops as in the BOP toolkit, and the seating test with its judge.

    python bench/bench_scoring.py data/kit1000

Without a folder a tiny dataset is made first. Predictions are the drawn goals of its test split, missed at random. The
plain way takes all vertices of the mesh, every goal in turn, and steps a free axis by 315 angles.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from measured_dataset import measured_dataset
from scipy.spatial import ConvexHull

from kit1000.dataset.reader import Dataset
from kit1000.errors import Kit1000Error
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.motions import goal_motion, goal_pose
from kit1000.pose import Pose
from kit1000.values import Truth

STEPS = 315  # turns about a free axis: ceil(pi / 0.01)
KINDS = {"a little off": (1e-3, 0.01), "off": (3e-3, 0.05)}
"""By name: standard deviations of a prediction's shift [m] and turn [rad], each coordinate."""
MS = 1e3  # milliseconds in a second


@dataclass(frozen=True)
class Scoring:
    """Measure how fast predictions are scored."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; a tiny one is made when absent."""
    predictions: int = 100_000
    """For the pose errors: the queries of the split again and again."""
    plain: int = 300
    """How many of them are scored in the plain way too."""
    queries: int = 400
    """For the seating test."""
    seed: int = 0
    """Of the shifts and turns."""


def main(asked: Scoring) -> None:
    """Print the table."""
    with measured_dataset(asked.data) as (dataset, _):
        split = dataset.split("test", truth=True)
        truths = [truth for scene in split for truth in scene.truths.values()]
        free = np.mean([truth.slot.free_axis is not None for truth in truths])
        print(f"{dataset.root.name}: {len(truths)} queries of test, {free:.0%} with a free axis")
        _pose_errors(dataset, truths, asked)
        for name, (shift, turn) in KINDS.items():
            print(f"{name}: {shift * 1e3:g} mm, {np.degrees(turn):.1f} degrees, standard deviations")
            _seatings(dataset, truths[: asked.queries], np.random.default_rng(asked.seed), shift, turn)


def missed(truths: list[Truth], rng: np.random.Generator, shift: float, turn: float) -> Pose:
    """(n,) drawn goals, missed by normal shifts [m] and turns [rad] about where they take the anchor."""
    n = len(truths)
    goals = Pose.stack([truth.goal_drawn for truth in truths])
    home = goals.apply(np.array([truth.anchor for truth in truths]))
    turned = Pose.from_rotvec(rng.normal(size=(n, 3)) * turn) @ Pose.from_translation(-home) @ goals
    return Pose.from_translation(home + rng.normal(size=(n, 3)) * shift) @ turned


def _timed(work: Callable[[], object]) -> float:
    """Seconds of one core."""
    start = time.process_time()
    work()
    return time.process_time() - start


def _pose_errors(dataset: Dataset, truths: list[Truth], asked: Scoring) -> None:
    vertices = {t.part_id: dataset.geometry.part(t.part_id).mesh.vertices for t in truths}

    def hull_of(part_id: str) -> np.ndarray:
        return vertices[part_id][ConvexHull(vertices[part_id]).vertices]

    predicted = missed(truths, np.random.default_rng(asked.seed), *KINDS["off"])
    targets = Targets.of(truths, hull_of)
    found = pose_errors(predicted, targets)  # numba compiles on the first
    index = np.arange(asked.predictions) % len(truths)
    many, motions = targets[index], predicted[index]
    ours = _timed(lambda: pose_errors(motions, many)) / asked.predictions
    sample = np.random.default_rng(asked.seed).permutation(len(truths))[: asked.plain]
    plain = np.empty(len(sample))

    def loops() -> None:
        for k, i in enumerate(sample):
            plain[k] = plain_mssd(predicted[int(i)], truths[i], vertices[truths[i].part_id])

    theirs = _timed(loops) / len(sample)
    beyond = plain - found.mssd[sample]
    print(
        f"pose errors of {asked.predictions} predictions: {ours * asked.predictions:.2f} s, {ours * MS:.4f} ms a query"
    )
    print(f"MSSD by plain loops: {theirs * MS:.2f} ms a query, {theirs / ours:.0f} times as long")
    print(f"they give {beyond.max() * 1e3:.3f} mm more at most, {max(-beyond.min(), 0) * 1e3:.6f} mm less at most")


def plain_mssd(predicted: Pose, truth: Truth, vertices: np.ndarray) -> float:
    """[m] the smallest largest distance over all goals and steps, one after another."""
    points = truth.world_from_part.apply(vertices)
    there, smallest = predicted.apply(points), np.inf
    steps = STEPS if truth.slot.free_axis is not None else 1
    for goal in range(len(truth.slot.goals)):
        turned = goal_pose(truth.slot, goal, np.arange(steps) * 2 * np.pi / steps) if steps > 1 else None
        kit_from_part = truth.slot.goals[goal : goal + 1] if turned is None else turned
        homes = goal_motion(truth.world_from_part, truth.world_from_kit, kit_from_part).matrix()
        for home in homes:
            away = there - (points @ home[:3, :3].T + home[:3, 3])
            smallest = min(smallest, float(np.linalg.norm(away, axis=1).max()))
    return smallest


def _seatings(dataset: Dataset, truths: list[Truth], rng: np.random.Generator, shift: float, turn: float) -> None:
    predicted = missed(truths, rng, shift, turn)
    for judge in ("never", "near", "all"):
        start, started = time.perf_counter(), time.process_time()
        found = seatings(predicted, truths, dataset.geometry, judge)
        wall, cpu = (MS * spent / len(truths) for spent in (time.perf_counter() - start, time.process_time() - started))
        print(
            f"  judge {judge:6}{wall:7.2f} ms a query ({cpu:.2f} of CPU), {found.seated.mean():.1%} seated, "
            f"{found.judged.mean():.1%} judged, said otherwise: {found.differs.sum()}"
        )


if __name__ == "__main__":
    try:
        main(tyro.cli(Scoring, description=__doc__))
    except Kit1000Error as error:
        raise SystemExit(f"bench_scoring: {error}") from error
