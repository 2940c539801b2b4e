"""Rigid motions that take a part to a goal, and the error of a guess about one: how it is applied and read back.

A motion `goal_from_now` maps world coordinates of the part now to where they belong. A guess is such a motion with an
offset and a rotation added, both along world axes, about the place where the motion takes the pivot. With
target = goal_from_now(pivot),

    guess = T(target + offset) . R(rotvec) . T(-target) . goal_from_now

so that the guess takes the pivot to target + offset, whatever the rotation.
"""

from __future__ import annotations

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose, quaternion_multiply
from kit1000.values import FreeAxis, Slot


def goal_motion(world_from_part: Pose, world_from_kit: Pose, kit_from_part: Pose) -> Pose:
    """goal_from_now of a part that belongs at kit_from_part; leading axes broadcast."""
    return world_from_kit @ kit_from_part @ world_from_part.inverse()


def goal_pose(slot: Slot, goal: int, turn: float | np.ndarray = 0.0) -> Pose:
    """kit_from_part of a goal, turned about the free axis by `turn` (...,) [rad]; without an axis there is no turn."""
    if slot.free_axis is not None:
        return _about(slot.free_axis, np.asarray(turn)) @ slot.goals[goal]
    if np.any(turn):
        raise InputError(f"turn: the slot of {slot.part_id} has no free axis to turn about")
    return slot.goals[goal]


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


def _about(axis: FreeAxis, turn: np.ndarray) -> Pose:
    """Turns (...,) [rad] about a line."""
    spun = Pose.from_rotvec(turn[..., None] * axis.direction)
    return Pose.from_translation(axis.point) @ spun @ Pose.from_translation(-axis.point)
