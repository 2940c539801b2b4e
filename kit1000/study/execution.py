"""Execution of uploads by the simulated robot, and the errors of what was uploaded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.planner.execute import robot_at
from kit1000.pose import Pose
from kit1000.study.records import PartResult
from kit1000.values import Truth

NOT_UPLOADED = "not uploaded"
DECIMALS = 3  # of mm, degrees and seconds in records


class Executed(NamedTuple):
    """The result of one uploaded part."""

    outcome: str
    seconds: float
    """[s] of the robot."""


Execute = Callable[[Mapping[int, Pose]], dict[int, Executed]]
"""Executes the motions, goal_from_now, of parts that it has not moved before; returns their results by index."""


@contextmanager
def by_robot(scene: RecordedScene, sensor: str, seed: int) -> Iterator[Execute]:
    """The simulated robot before a scene, which must have been opened with its truth."""
    with robot_at(scene, sensor, seed) as robot:

        def execute(motions: Mapping[int, Pose]) -> dict[int, Executed]:
            runs = robot.run(motions).parts
            return {run.part: Executed(run.outcome, round(run.seconds, DECIMALS)) for run in runs}

        yield execute


def measured(
    dataset: Dataset,
    truths: Mapping[int, Truth],
    motions: Mapping[int, Pose],
    outcomes: Mapping[int, str] | None = None,
) -> dict[int, PartResult]:
    """The errors of motions by part; a part without a motion was not uploaded."""
    parts, outcomes = sorted(motions), outcomes or {}
    found = {part: PartResult(part, NOT_UPLOADED, False, None, None) for part in sorted(truths)}
    if not parts:
        return found
    stacked, own = Pose.stack([motions[part] for part in parts]), [truths[part] for part in parts]
    errors = pose_errors(stacked, Targets.of(own, lambda part_id: dataset.geometry.part(part_id).mesh.vertices))
    seated = seatings(stacked, own, dataset.geometry).seated
    for i, part in enumerate(parts):
        position, angle = 1e3 * float(errors.position[i]), float(np.degrees(errors.rotation[i]))
        outcome = outcomes.get(part, NOT_UPLOADED)
        found[part] = PartResult(part, outcome, bool(seated[i]), round(position, DECIMALS), round(angle, DECIMALS))
    return found
