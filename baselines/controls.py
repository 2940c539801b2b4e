"""Methods whose score is known beforehand: the truth in three disguises, the guess left alone, and chance.

Their rows show that the benchmark measures what it says. All draws come from a stream named by the seed, the control
and the query.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.points import seen_points
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.guesses import draw_ball, draw_direction, draw_goal
from kit1000.motions import apply_error, goal_motion, goal_pose
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.rng import stream
from kit1000.values import Query, Truth

SURE, UNSURE = 1.0, 0.5  # confidences: a control knows no better
NOISE = 2e-3  # [m] by which truth-noise moves the anchor
NOISE_ANGLE = float(np.radians(2))


@dataclass(frozen=True)
class TrueGoal:
    """The goal that the guess was drawn around; where nobody guesses, the design pose. Every error is 0."""

    dataset: Dataset
    uses_true_geometry = True

    def __call__(self, query: Query, truth: Truth | None) -> PredictedMotion:
        """The goal."""
        return PredictedMotion(_known(query, truth).goal_drawn, SURE)


@dataclass(frozen=True)
class SymmetricGoal:
    """Any goal of the slot, all alike, and where the part may turn about an axis, at any turn.

    Every error but the plain ones is 0.
    """

    dataset: Dataset
    seed: int = 0
    uses_true_geometry = True

    def __call__(self, query: Query, truth: Truth | None) -> PredictedMotion:
        """A goal."""
        known = _known(query, truth)
        goal, turn = draw_goal(stream(self.seed, "truth-symmetric", query.id), known.slot)
        seated = goal_pose(known.slot, goal, turn)
        return PredictedMotion(goal_motion(known.world_from_part, known.world_from_kit, seated), SURE)


@dataclass(frozen=True)
class NoisyGoal:
    """The drawn goal, missed at the anchor by NOISE in any direction and by NOISE_ANGLE about any axis through it.

    So the plain errors are exactly these. The others are too where no other goal is near; about a free axis
    the part of the turn that lies along it is no error.
    """

    dataset: Dataset
    seed: int = 0
    uses_true_geometry = True

    def __call__(self, query: Query, truth: Truth | None) -> PredictedMotion:
        """A goal missed."""
        known, rng = _known(query, truth), stream(self.seed, "truth-noise", query.id)
        offset, rotvec = NOISE * draw_direction(rng), NOISE_ANGLE * draw_direction(rng)
        return PredictedMotion(apply_error(known.goal_drawn, known.anchor, offset, rotvec), SURE)


def guess(query: Query, truth: Truth | None) -> PredictedMotion:
    """The guess, left as it is."""
    if query.guess is None:
        raise InputError(f"{query.id}: nobody guesses in track {query.track}")
    return PredictedMotion(query.guess, UNSURE)


@dataclass(frozen=True)
class Chance:
    """Any motion among those that are to be expected.

    With a guess: the guess, missed once more by the same kind of error, a place in the cube of ± 28 mm and a turn of up
    to 27.5 degrees. Without: the pivot goes to any point that is seen of the kits, the part at any yaw.
    """

    dataset: Dataset
    seed: int = 0

    def __call__(self, query: Query, truth: Truth | None) -> PredictedMotion:
        """A motion."""
        rng = stream(self.seed, "chance", query.id)
        if query.guess is not None:
            return PredictedMotion(apply_error(query.guess, query.pivot, *draw_ball(rng)), UNSURE)
        points = seen_points(query, query.kit_region)
        if len(points) == 0:
            raise InputError(f"{query.id}: its image shows nothing of the kits")
        there, yaw = points[rng.integers(len(points))], rng.uniform(0, 2 * np.pi)
        turned = Pose.from_translation(there) @ Pose.from_rotvec((0.0, 0.0, yaw))
        return PredictedMotion(turned @ Pose.from_translation(-query.pivot), UNSURE)


def _known(query: Query, truth: Truth | None) -> Truth:
    if truth is None:
        raise InputError(f"{query.id}: this control is made from the truth, which was not handed over")
    return truth
