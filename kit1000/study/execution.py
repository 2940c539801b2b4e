"""What becomes of the uploads of a task: carried out by the robot, or, for quick simulations, by the seating test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple, Protocol

import numpy as np

from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.planner.execute import NOT_SEATED, SEATED, Robot, robot_at
from kit1000.pose import Pose
from kit1000.study.study_records import PartResult
from kit1000.study.tasks import part_truths
from kit1000.values import Truth

NOT_UPLOADED = "not uploaded"
ROBOT, TEST = "robot", "test"
JUDGES = (ROBOT, TEST)
NOMINAL_S = 23.0  # [s] of the robot for a part: about the median of the robot, used with the seating test
DECIMALS = 3  # of mm, degrees and seconds in records


class Carried(NamedTuple):
    """What became of one uploaded part."""

    outcome: str
    seconds: float
    """[s] of the robot."""


class Judge(Protocol):
    """Carries out uploads, one after another."""

    def carry_out(self, motions: Mapping[int, Pose]) -> dict[int, Carried]:
        """The outcome of each part, by index; motions: goal_from_now of parts not moved before."""
        ...


class RobotJudge:
    """The simulated robot."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    def carry_out(self, motions: Mapping[int, Pose]) -> dict[int, Carried]:
        """Pick and insert the parts."""
        runs = self._robot.run(motions).parts
        return {run.part: Carried(run.outcome, round(run.seconds, DECIMALS)) for run in runs}


class SeatingJudge:
    """The seating test of the benchmark, with a robot's typical seconds."""

    def __init__(self, dataset: Dataset, truths: Mapping[int, Truth]) -> None:
        self._dataset, self._truths = dataset, truths

    def carry_out(self, motions: Mapping[int, Pose]) -> dict[int, Carried]:
        """Test the motions."""
        found = measured(self._dataset, self._truths, motions)
        return {
            part: Carried(SEATED if found[part].seated_by_test else NOT_SEATED, NOMINAL_S) for part in sorted(motions)
        }


@contextmanager
def judging(kind: str, scene: RecordedScene, sensor: str, seed: int) -> Iterator[Judge]:
    """A judge before a scene, which must have been opened with its truth. kind: robot or test."""
    if kind == ROBOT:
        with robot_at(scene, sensor, seed) as robot:
            yield RobotJudge(robot)
    elif kind == TEST:
        yield SeatingJudge(scene.split.dataset, part_truths(scene, sensor))
    else:
        raise InputError(f"--judge {kind}: expected {' or '.join(JUDGES)}")


def measured(
    dataset: Dataset,
    truths: Mapping[int, Truth],
    motions: Mapping[int, Pose],
    outcomes: Mapping[int, str] | None = None,
) -> dict[int, PartResult]:
    """How good motions are, by part; a part without one was not uploaded."""
    parts, outcomes = sorted(motions), outcomes or {}
    found = {part: PartResult(part, NOT_UPLOADED, False, None, None) for part in sorted(truths)}
    if not parts:
        return found
    stacked, asked = Pose.stack([motions[part] for part in parts]), [truths[part] for part in parts]
    errors = pose_errors(stacked, Targets.of(asked, lambda part_id: dataset.geometry.part(part_id).mesh.vertices))
    seated = seatings(stacked, asked, dataset.geometry).seated
    for i, part in enumerate(parts):
        position, angle = 1e3 * float(errors.position[i]), float(np.degrees(errors.rotation[i]))
        outcome = outcomes.get(part, NOT_UPLOADED)
        found[part] = PartResult(part, outcome, bool(seated[i]), round(position, DECIMALS), round(angle, DECIMALS))
    return found
