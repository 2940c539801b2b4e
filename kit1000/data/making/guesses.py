"""Motions that bring a part home, and the errors of a person's guess: how both are drawn, put on and read back.

A motion `goal_from_now` maps world coordinates of the part now to where they belong. A guess is such a motion, shifted
and turned, both along world axes, about the place where the pivot belongs. With home = goal_from_now(pivot),

    guess = T(home + offset) . R(rotvec) . T(-home) . goal_from_now

so that the guess takes the pivot to home + offset, whatever it turns by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.data.tables import Row
from kit1000.errors import InputError
from kit1000.pose import Pose, quaternion_multiply, unit_vector
from kit1000.values import FreeAxis, Slot

OFFSET = 28e-3  # [m] most along a world axis: as far as the paper's matcher looks around a guess
ANGLE = float(np.radians(27.5))  # most: as far as the paper's candidate turns reach
LEVELS = 8  # of a curve: level k is k/7 of OFFSET and of ANGLE
FIXED_LEVELS = (1, 4, 7)  # at which one kind of error stays while the other runs through all levels


@dataclass(frozen=True, eq=False)
class GuessDraw:
    """What is drawn of a guess: a goal, and an error about it."""

    goal: int
    """Index among the goals of the slot."""
    turn: float
    """[rad] of that goal about the free axis; 0 where there is none."""
    offset: np.ndarray
    """(3,) [m] along world axes."""
    rotvec: np.ndarray
    """(3,) [rad] along world axes."""

    @property
    def row(self) -> Row:
        """As the truth records it."""
        offset, rotvec = self.offset.tolist(), self.rotvec.tolist()
        return {"goal": self.goal, "turn": self.turn, "offset": offset, "rotvec": rotvec}


def apply_error(goal_from_now: Pose, pivot: np.ndarray, offset: np.ndarray, rotvec: np.ndarray) -> Pose:
    """The guess that misses a goal by an error; no error gives the goal to the bit.

    Args:
        goal_from_now: one motion.
        pivot: (3,) [m] world, where the part is now.
        offset: (3,) [m] and rotvec: (3,) [rad], along world axes.
    """
    turn = Pose.from_rotvec(rotvec)
    arm = goal_from_now.xyz - goal_from_now.apply(pivot)
    swung = turn.rotate(arm) - arm
    return Pose(quaternion_multiply(turn.wxyz, goal_from_now.wxyz), goal_from_now.xyz + offset + swung)


def error_of(guess: Pose, goal_from_now: Pose, pivot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The error that `apply_error` put on a goal: offset (3,) [m] and rotvec (3,) [rad] of at most pi."""
    return guess.apply(pivot) - goal_from_now.apply(pivot), (guess @ goal_from_now.inverse()).rotvec()


def motion(world_from_part: Pose, world_from_kit: Pose, kit_from_part: Pose) -> Pose:
    """goal_from_now of a part that belongs at kit_from_part; leading axes broadcast."""
    return world_from_kit @ kit_from_part @ world_from_part.inverse()


def turned_goal(slot: Slot, goal: int, turn: float | np.ndarray = 0.0) -> Pose:
    """kit_from_part of a goal, turned about the free axis by `turn` (...,) [rad]; without an axis there is no turn."""
    if slot.free_axis is not None:
        return _about(slot.free_axis, np.asarray(turn)) @ slot.goals[goal]
    if np.any(turn):
        raise InputError(f"turn: the slot of {slot.part_id} has no free axis to turn about")
    return slot.goals[goal]


def draw_goal(rng: np.random.Generator, slot: Slot) -> tuple[int, float]:
    """One of all goals, evenly: its index, and its turn [rad] about the free axis."""
    goal, turn = rng.integers(len(slot.goals)), rng.uniform(0, 2 * np.pi)
    return int(goal), float(turn) if slot.free_axis is not None else 0.0


def draw_direction(rng: np.random.Generator) -> np.ndarray:
    """(3,) unit vector, uniform on the sphere."""
    return unit_vector(rng.standard_normal(3))


def draw_ball(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """An offset (3,) [m], uniform in a cube, and a turn (3,) [rad] by an even angle about any axis."""
    return _draw_offset(rng), draw_direction(rng) * rng.uniform(0, ANGLE)


def draw_tilt(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The paper's error: the same offset, and a turn that takes the vertical to a direction the shortest way."""
    offset, azimuth = _draw_offset(rng), rng.uniform(0, 2 * np.pi)
    return offset, np.array([-np.sin(azimuth), np.cos(azimuth), 0.0]) * rng.uniform(0, ANGLE)


def level_offset(level: int) -> float:
    """Length [m] of the offset at a level of a curve: 0, 4 ... 28 mm."""
    return OFFSET * _level(level) / (LEVELS - 1)


def level_angle(level: int) -> float:
    """Angle [rad] of the turn at a level of a curve: 0, 3.9 ... 27.5 degrees."""
    return ANGLE * _level(level) / (LEVELS - 1)


def _level(level: int) -> int:
    if not 0 <= level < LEVELS:
        raise InputError(f"level: expected 0 to {LEVELS - 1}, got {level}")
    return level


def _draw_offset(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-OFFSET, OFFSET, 3)


def _about(axis: FreeAxis, turn: np.ndarray) -> Pose:
    """Turns (...,) [rad] about a line."""
    spun = Pose.from_rotvec(turn[..., None] * axis.direction)
    return Pose.from_translation(axis.point) @ spun @ Pose.from_translation(-axis.point)
