"""Simulated operators: what they aim at, how far they miss, how long it takes. They test the machine, not people.

Times are those of the keystroke-level model (Card, Moran and Newell 1980) and of Fitts' law with a mouse (MacKenzie,
Sellen and Buxton 1991); the scatter of an aimed movement is its target's width over 4.133 (ISO 9241-9), cast through
the camera; deciding on a rotation takes longer the larger it is (Shepard and Metzler 1971). Lapses and the differences
between people are assumptions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.errors import InputError, did_you_mean
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.numerics.trigonometry import sine
from kit1000.pose import Pose, unit_vector
from kit1000.queries.guesses import draw_ball_error
from kit1000.queries.motions import apply_error
from kit1000.study.conditions import Condition

KEY, HOME, MENTAL, BUTTON = 0.28, 0.40, 1.35, 0.1  # [s]
POINT_START, POINT_SLOPE = -0.107, 0.223  # [s], [s/bit] to point with a mouse
DRAG_START, DRAG_SLOPE = 0.135, 0.249  # [s], [s/bit] to drag with it
DECIDE_START, DECIDE_SLOPE = 1.9, 0.021  # [s], [s/degree] to decide on a rotation
SCATTER = 4.133  # width of a target over the standard deviation of where a movement ends
VIEW_SLOPE = 45.0  # [degrees] of the page's view to the table
GRAB_WIDTH = 30e-3  # [m] of a part, as a target of the pointer
CUP_WIDTH = 10e-3  # [m] of a spot for a cup
SNAP_WIDTH = 20e-3  # [m] within which a snapping person lets go
EXACT_WIDTH = 5e-3  # [m] the same where nothing snaps: twice the clearance
TURN_STEP_DEG = 5.0  # of a key that turns
EYE_DEG = 3.0  # standard deviation of a rotation judged by eye: assumed
ALIGNED_DEG = 0.5  # the same of a plane to which a part is aligned
WRONG_CAVITY, WRONG_GHOST = 0.05, 0.20  # chances: assumed, to be varied
SPREAD = 0.15  # of the logarithm of a person's pace: assumed
PAPER_SCENE, PAPER_HAND = 20.0, 31.0  # [s] a part in a draft of the paper


@dataclass(frozen=True)
class OperatorModel:
    """A model of a person."""

    name: str
    scatters: bool
    """Whether aimed movements scatter."""
    lapses: float
    """Factor on the chances of lapses."""
    error_ball: bool = False
    """Whether the hand errs as the guesses of the benchmark do, and takes the paper's time."""


OPERATORS = {
    operator.name: operator
    for operator in (
        OperatorModel("exact", False, 0.0),
        OperatorModel("paper", False, 0.0, error_ball=True),
        OperatorModel("fitts", True, 1.0),
        OperatorModel("careless", True, 2.0),
    )
}


def operator_of(name: str) -> OperatorModel:
    """The operator of this name."""
    if name not in OPERATORS:
        raise InputError(f"--simulate {name}: {did_you_mean(name, OPERATORS)}there are {', '.join(OPERATORS)}")
    return OPERATORS[name]


@dataclass(frozen=True, eq=False)
class Aim:
    """What an operator knows of one part: where it should go."""

    goal: Pose
    """goal_from_now"""
    pivot: np.ndarray
    """(3,) [m] world, about which the hand turns it."""
    normal: np.ndarray
    """(3,) unit, world: out of the cavity."""
    others: Sequence[np.ndarray] = ()
    """(3,) [m] each, world: where the pivots of the scene's other parts belong."""

    @property
    def target(self) -> np.ndarray:
        """(3,) [m] world: where the pivot belongs."""
        return self.goal.apply(self.pivot)

    @property
    def distance(self) -> float:
        """[m] to carry the part."""
        return float(length(self.target - self.pivot))

    @property
    def turn_deg(self) -> float:
        """[degrees] to turn it by."""
        return float(np.degrees(self.goal.angle()))


@dataclass(frozen=True, eq=False)
class Put:
    """Where a hand has put a part, and what it cost."""

    motion: Pose
    seconds: float
    lapse: bool = False
    """Whether it is over the wrong cavity."""


@dataclass
class Hand:
    """An operator as one person, at work in one condition."""

    operator: OperatorModel
    condition: Condition
    pace: float
    """Factor on all times of this person."""
    rng: np.random.Generator

    def put(self, aim: Aim) -> Put:
        """Put a part where it seems to belong."""
        seconds = self._seconds(aim)
        if self.operator.error_ball:
            return Put(apply_error(aim.goal, aim.pivot, *draw_ball_error(self.rng)), seconds)
        lapse = bool(aim.others) and self._happens(WRONG_CAVITY)
        motion = aim.goal
        if lapse:
            wrong = aim.others[int(self.rng.integers(len(aim.others)))]
            motion = Pose.from_translation(wrong - aim.target) @ motion
        if self.operator.scatters:
            motion = apply_error(motion, aim.pivot, self._offset(aim), self._rotvec(aim))
        return Put(motion, seconds, lapse)

    def accepts(self, right: bool) -> bool:
        """Whether a proposal is taken; a right one always, a wrong one by a lapse; the ball's hand takes any."""
        return right or self.operator.error_ball or self._happens(WRONG_GHOST)

    def look_seconds(self) -> float:
        """[s] to look at a proposal and press a key."""
        return self.pace * (MENTAL + KEY)

    def upload_seconds(self) -> float:
        """[s] to press the button that uploads."""
        return self.pace * (MENTAL + point(0.3, 0.02) + 2 * BUTTON)

    def _happens(self, chance: float) -> bool:
        return bool(self.rng.random() < chance * self.operator.lapses)

    def _seconds(self, aim: Aim) -> float:
        if self.operator.error_ball:
            return PAPER_SCENE if self.condition.interface == "scene" else PAPER_HAND
        width, turns = self._width, aim.turn_deg / TURN_STEP_DEG
        decide = DECIDE_START + DECIDE_SLOPE * aim.turn_deg
        if self.condition.interface == "hand-bare":  # two gizmos: three axes each, and three angles of the second
            axis = MENTAL + point(0.05, 0.01) + drag(aim.distance / 2, width)
            angle = MENTAL + point(0.05, 0.01) + drag(0.05, 0.05 / SCATTER)
            return self.pace * (2 * point(aim.distance, CUP_WIDTH) + 6 * axis + 3 * angle + decide + MENTAL)
        place = MENTAL + drag(aim.distance, width) + decide + 2 * HOME + turns * KEY + MENTAL
        if self.condition.interface == "hand":
            grab = 2 * MENTAL + point(aim.distance, CUP_WIDTH) + drag(aim.distance, CUP_WIDTH)
            return self.pace * (grab + point(aim.distance, CUP_WIDTH) + place)
        return self.pace * (point(aim.distance, GRAB_WIDTH) + place)

    @property
    def _width(self) -> float:
        return SNAP_WIDTH if self.condition.snaps else EXACT_WIDTH

    def _offset(self, aim: Aim) -> np.ndarray:
        """(3,) [m] by which the hand misses: on the plate, stretched by the view's slant; off it by gizmo alone."""
        sigma = self._width / SCATTER
        across, along = _axes_of(aim.normal)
        slant = 1 / float(sine(np.radians(VIEW_SLOPE)))
        offset = sigma * (self.rng.standard_normal() * across + slant * self.rng.standard_normal() * along)
        if self.condition.interface == "hand-bare":
            offset = offset + sigma * slant * self.rng.standard_normal() * aim.normal
        return offset

    def _rotvec(self, aim: Aim) -> np.ndarray:
        """(3,) [rad] by which it is turned wrongly: about the normal by eye and key; tilted by a gizmo alone."""
        across, along = _axes_of(aim.normal)
        tilt = EYE_DEG if self.condition.interface == "hand-bare" else ALIGNED_DEG
        step = 0.0 if self.condition.interface == "hand-bare" else TURN_STEP_DEG
        turn = EYE_DEG * self.rng.standard_normal() + step * self.rng.uniform(-0.5, 0.5)
        tilts = tilt * self.rng.standard_normal(2)
        return np.radians(turn * aim.normal + tilts[0] * across + tilts[1] * along)


def point(distance: float, width: float) -> float:
    """[s] to point over a distance [m] at a target of a width [m]."""
    return max(POINT_START + POINT_SLOPE * difficulty(distance, width), 0.0) + BUTTON


def drag(distance: float, width: float) -> float:
    """[s] to drag over a distance [m] to a target of a width [m]."""
    return DRAG_START + DRAG_SLOPE * difficulty(distance, width)


def difficulty(distance: float, width: float) -> float:
    """[bit] of a movement, in the form of Shannon."""
    return float(np.log2(distance / width + 1))


def _axes_of(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3,) of a plane with this normal: across the view, and along it."""
    across = np.array([1.0, 0.0, 0.0])
    across = unit_vector(across - float(matmul(across, normal)) * normal)
    return across, np.cross(normal, across)
