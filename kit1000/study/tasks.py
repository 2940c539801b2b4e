"""The tasks of a study: scenes of two and of three kits that the robot solves with the true motions.

Scenes that the robot cannot solve are left out: every participant would fail there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
import numpy as np

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.editor.scene import editable_queries
from kit1000.errors import InputError
from kit1000.kits.seating import UP
from kit1000.planner.execute import MAX_TURN, SEATED, Bench, run_scene
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion
from kit1000.rng import stream
from kit1000.values import Truth

SIZES = (2, 2, 3, 3)
"""Number of kits of the tasks of a condition, in order, as in the paper."""
SETS = 2  # one for each condition
SPLIT = "test-all"


class Task(msgspec.Struct, frozen=True):
    """A scene, all of whose parts go into their slots."""

    scene: str
    kits: int  # also the number of parts: p0, p1, ..


class Tasks(msgspec.Struct, frozen=True):
    """All tasks of a study."""

    practice: Task
    sets: tuple[tuple[Task, ...], ...]  # A participant meets each set once


SceneTest = Callable[[RecordedScene], bool]


def choose_tasks(dataset: Dataset, sensor: str, seed: int, solvable: SceneTest | None = None) -> Tasks:
    """Draw the tasks from the scenes of a dataset with ground truth that the robot solves.

    sensor: whose depth image shows the parts. solvable: whether the robot seats all parts of a scene; by default it
    tries, which takes seconds.
    """
    solvable = solvable or (lambda scene: is_reachable(scene, sensor) and robot_solves(scene, sensor, seed))
    needed = {size: SETS * SIZES.count(size) for size in SIZES}
    needed[min(SIZES)] += 1  # to practise
    found: dict[int, list[Task]] = {size: [] for size in needed}
    for scene in _scenes(dataset, seed):
        size = len(scene.scene.bodies) - 1
        if len(found.get(size, ())) < needed.get(size, 0) and solvable(scene):
            found[size].append(Task(scene.id, size))
        if all(len(found[size]) == count for size, count in needed.items()):
            practice = found[min(SIZES)].pop()
            dealt = {size: iter(tasks) for size, tasks in found.items()}
            rounds = [[next(dealt[size]) for _ in range(SETS)] for size in SIZES]
            return Tasks(practice, tuple(zip(*rounds, strict=True)))
    missing = ", ".join(f"{len(found[size])} of {count} scenes with {size} kits" for size, count in needed.items())
    raise InputError(f"{dataset.root}: the robot solves {missing}; generate the preset study")


def is_reachable(scene: RecordedScene, sensor: str) -> bool:
    """Whether every part of a scene can be edited and gripped, and has a goal with its upper side up."""
    bench, truths = Bench(scene, sensor), part_truths(scene, sensor)
    return len(truths) == len(bench.parts) and all(
        any(bench.seal_height(part, grasp) is not None for grasp in bench.grasps(part))
        and true_motion(truth).rotate(UP)[2] > np.cos(MAX_TURN)
        for part, truth in truths.items()
    )


def robot_solves(scene: RecordedScene, sensor: str, seed: int) -> bool:
    """Whether the robot seats every part of a scene by the true motions."""
    motions = {part: true_motion(truth) for part, truth in part_truths(scene, sensor).items()}
    return all(part.outcome == SEATED for part in run_scene(scene, motions, sensor, seed).parts)


def part_truths(scene: RecordedScene, sensor: str) -> dict[int, Truth]:
    """The truth about each part that can be edited, by index."""
    return {part: scene.truth_of(query.id) for part, query in editable_queries(scene, sensor).items()}


def true_motion(truth: Truth) -> Pose:
    """The motion, goal_from_now, to the goal with the part's upper side uppermost."""
    motions = goal_motion(truth.world_from_part, truth.world_from_kit, truth.slot.goals)
    return motions[int(motions.rotate(UP)[:, 2].argmax())]


def _scenes(dataset: Dataset, seed: int) -> Iterator[RecordedScene]:
    """The scenes in a drawn order."""
    split = dataset.split(SPLIT, truth=True)
    for i in stream(seed, "study-tasks").permutation(len(split)):
        yield split.scene(split.scene_ids[int(i)])
