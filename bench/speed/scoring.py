"""Time of scoring: our pose errors beside plain loops as in the BOP toolkit, and the seating test in its three modes.

    python bench/speed/scoring.py data/kit1000

Without a folder a tiny dataset is generated first. Predictions are the sampled goals of its test split with random
errors. The plain loops take all vertices of the mesh, all goals one after another, and 315 angles about a free axis.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.spatial import ConvexHull

from bench.measured import measured_dataset, run, spread, timed
from benchmark.measurements import Column, Measurement, Table, estimate
from kit1000.dataset.reader import Dataset
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion, goal_pose
from kit1000.values import Truth

STEPS = 315  # angles about a free axis: ceil(pi / 0.01)
ERRORS = {"small": (1e-3, 0.01), "large": (3e-3, 0.05)}
"""By name: standard deviations of the position [m] and rotation [rad] errors, in each coordinate."""
MODES = {"never": "closed form", "near": "exact near a limit, as in scoring", "all": "always exact"}
MS = 1e3  # milliseconds in a second
POSE_COLUMNS = (
    Column("way", "computation"),
    Column("n", "queries"),
    Column("ms", "CPU, ms a query", 4),
    Column("ratio", "times ours", 0),
    Column("least", "least difference, mm", 6),
    Column("most", "largest difference, mm", 3),
)
SEATING_COLUMNS = (
    Column("errors", "errors"),
    Column("mode", "test"),
    Column("n", "queries"),
    Column("wall", "ms a query", 2),
    Column("ms", "CPU, ms", 2),
    Column("ratio", "times the closed form", 1),
    Column("seated", "seated, %", 1, True),
    Column("exact", "tested exactly, %", 1, True),
    Column("disagree", "verdicts that differ", 0),
)


@dataclass(frozen=True)
class Scoring:
    """Measure how fast predictions are scored."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder; a tiny one is generated when absent."""
    predictions: int = 100_000
    """For the pose errors: the queries of the split, repeated."""
    plain: int = 300
    """How many of them are scored by plain loops too."""
    queries: int = 200
    """For the seating test, spread evenly over the split."""
    seed: int = 0
    """Seed of the errors."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-scoring.json."""


def main(options: Scoring) -> None:
    """Print the tables."""
    with measured_dataset(options.data) as (dataset, _):
        split = dataset.split("test", truth=True)
        truths = [truth for scene in split for truth in scene.truths.values()]
        measurement = Measurement.begin(dataset)
        free = np.mean([truth.slot.free_axis is not None for truth in truths])
        title = f"Pose errors, {len(truths)} queries of test repeated, {free:.0%} with a free axis"
        _add_pose_errors(measurement.table("errors", title, *POSE_COLUMNS), dataset, truths, options)
        title = "Seating test of predictions with random errors"
        table = measurement.table("seating", title, *SEATING_COLUMNS)
        some = spread(truths, options.queries)
        for name in ERRORS:
            _add_seatings(table, dataset, some, name, options.seed)
        measurement.report(options.out)


def with_errors(truths: list[Truth], rng: np.random.Generator, offset: float, angle: float) -> Pose:
    """Sampled goals (n,) with normal offsets [m] and rotations [rad] about the target of the anchor."""
    n = len(truths)
    goals = Pose.stack([truth.goal_drawn for truth in truths])
    target = goals.apply(np.array([truth.anchor for truth in truths]))
    rotated = Pose.from_rotvec(rng.normal(size=(n, 3)) * angle) @ Pose.from_translation(-target) @ goals
    return Pose.from_translation(target + rng.normal(size=(n, 3)) * offset) @ rotated


def _add_pose_errors(table: Table, dataset: Dataset, truths: list[Truth], options: Scoring) -> None:
    """Add a line for all errors by us, and one for MSSD by plain loops."""
    vertices = {t.part_id: dataset.geometry.part(t.part_id).mesh.vertices for t in truths}

    def hull_of(part_id: str) -> np.ndarray:
        return vertices[part_id][ConvexHull(vertices[part_id]).vertices]

    predicted = with_errors(truths, np.random.default_rng(options.seed), *ERRORS["large"])
    targets = Targets.of(truths, hull_of)
    errors = pose_errors(predicted, targets)  # the first call compiles
    index = np.arange(options.predictions) % len(truths)
    many, motions = targets[index], predicted[index]
    ours = timed(lambda: pose_errors(motions, many), time.process_time)[0] / options.predictions
    sample = np.random.default_rng(options.seed).permutation(len(truths))[: options.plain].tolist()
    plain = [_timed_mssd(predicted[i], truths[i], vertices[truths[i].part_id]) for i in sample]
    seconds, found = np.array(plain).T
    theirs = estimate(MS * seconds, [truths[i].part_id for i in sample])
    difference = MS * (found - errors.mssd[sample])  # [mm]
    table.add(way="ours, all errors", n=options.predictions, ms=MS * ours, ratio=1.0)
    table.add(
        way="plain loops, MSSD",
        n=len(sample),
        ms=theirs,
        ratio=theirs["mean"] / (MS * ours),
        least=difference.min(),
        most=difference.max(),
    )


def _timed_mssd(predicted: Pose, truth: Truth, vertices: np.ndarray) -> tuple[float, float]:
    """CPU seconds of `plain_mssd`, and its value [m]."""
    return timed(lambda: plain_mssd(predicted, truth, vertices), time.process_time)


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


def _add_seatings(table: Table, dataset: Dataset, truths: list[Truth], name: str, seed: int) -> None:
    """Add a line for each of MODES, with the errors of a name."""
    offset, angle = ERRORS[name]
    predicted = with_errors(truths, np.random.default_rng(seed), offset, angle)
    seatings(predicted[:1], truths[:1], dataset.geometry, "all")  # compiles
    seatings(predicted, truths, dataset.geometry, "never")  # reads the meshes
    reference = None
    for exact, mode in MODES.items():
        started = time.process_time()
        seconds, results = timed(lambda exact=exact: seatings(predicted, truths, dataset.geometry, exact))
        ms = MS * (time.process_time() - started) / len(truths)
        reference = reference or ms
        table.add(
            errors=f"{name}: {offset * 1e3:g} mm, {np.degrees(angle):.1f}°",
            mode=mode,
            n=len(truths),
            wall=MS * seconds / len(truths),
            ms=ms,
            ratio=ms / reference,
            seated=results.seated.mean(),
            exact=results.exact.mean(),
            disagree=results.disagrees.sum(),
        )


if __name__ == "__main__":
    run(main, Scoring, __doc__)
