"""The tasks of a study: scenes of two and of three kits that the robot is known to manage with the true motions.

A part without a spot for a cup, or upside down in its slot, would fail whoever says where it goes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.editor.edited_queries import editable_queries
from kit1000.errors import InputError
from kit1000.kits.seating import UP
from kit1000.planner.execute import MAX_TURN, SEATED, Bench, run_scene
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion
from kit1000.rng import stream
from kit1000.values import Truth

SIZES = (2, 2, 3, 3)
"""Kits of the tasks of a condition, in their order: as in the paper."""
SPLIT = "test-all"


@dataclass(frozen=True)
class Task:
    """A scene, all of whose parts go into their slots."""

    scene: str
    kits: int
    """Also the number of parts: p0, p1, ..."""


@dataclass(frozen=True)
class Tasks:
    """What a study asks."""

    practice: Task
    sets: tuple[tuple[Task, ...], ...]
    """As many sets as conditions; a participant meets each once."""


Manages = Callable[[RecordedScene], bool]


def choose_tasks(dataset: Dataset, sets: int, sensor: str, seed: int, manages: Manages | None = None) -> Tasks:
    """Draw the tasks among the scenes that the robot manages.

    Args:
        dataset: with ground truth.
        sets: number of sets.
        sensor: by whose depth image parts are seen and grasped.
        seed: of the draw.
        manages: says whether the robot seats all parts of a scene; by default it is let try, which takes seconds.
    """
    manages = manages or (lambda scene: can_be_asked(scene, sensor) and robot_manages(scene, sensor, seed))
    needed = {size: sets * SIZES.count(size) + (size == min(SIZES)) for size in SIZES}  # and one to practise
    found: dict[int, list[Task]] = {size: [] for size in needed}
    for scene in _scenes(dataset, seed):
        size = len(scene.scene.bodies) - 1
        if len(found.get(size, ())) < needed.get(size, 0) and manages(scene):
            found[size].append(Task(scene.id, size))
        if all(len(found[size]) == count for size, count in needed.items()):
            return _dealt(found, sets)
    missing = ", ".join(f"{len(found[size])} of {count} scenes with {size} kits" for size, count in needed.items())
    raise InputError(
        f"{dataset.root}: the robot manages {missing}; compare fewer --conditions, or generate the preset study"
    )


def can_be_asked(scene: RecordedScene, sensor: str) -> bool:
    """Whether every part of a scene can be edited, has a spot for a cup, and a goal with its upper side up."""
    bench, truths = Bench(scene, sensor), part_truths(scene, sensor)
    return len(truths) == len(bench.parts) and all(
        any(bench.seal_height(part, grasp) is not None for grasp in bench.grasps(part))
        and true_motion(truth).rotate(UP)[2] > np.cos(MAX_TURN)
        for part, truth in truths.items()
    )


def robot_manages(scene: RecordedScene, sensor: str, seed: int) -> bool:
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


def _dealt(found: dict[int, list[Task]], sets: int) -> Tasks:
    practice = found[min(SIZES)].pop()
    decks: dict[int, Sequence[Task]] = dict(found)
    taken = dict.fromkeys(decks, 0)
    dealt: list[list[Task]] = [[] for _ in range(sets)]
    for size in SIZES:
        for task_set in dealt:
            task_set.append(decks[size][taken[size]])
            taken[size] += 1
    return Tasks(practice, tuple(map(tuple, dealt)))
