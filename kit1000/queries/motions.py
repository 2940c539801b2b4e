"""Rigid motions of a part to its goal, and the error of an initial guess: applying it and reading it back.

A motion `goal_from_now` maps the points of the part from their current world coordinates to those at the goal. A guess
is such a motion with an error: an offset and a rotation, both along world axes, about the image of the pivot. With
target = goal_from_now(pivot),

    guess = T(target + offset) . R(rotvec) . T(-target) . goal_from_now

so that the guess maps the pivot to target + offset for every rotation.
"""

from __future__ import annotations

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose, quaternion_multiply
from kit1000.values import FreeAxis, Slot


def goal_motion(world_from_part: Pose, world_from_kit: Pose, kit_from_part: Pose) -> Pose:
    """goal_from_now of a part whose goal is kit_from_part; leading axes broadcast."""
    return world_from_kit @ kit_from_part @ world_from_part.inverse()


def goal_pose(slot: Slot, goal: int, angle: float | np.ndarray = 0.0) -> Pose:
    """kit_from_part of a goal, rotated about the free axis by `angle` (...,) [rad], which is 0 without a free axis."""
    if slot.free_axis is not None:
        return _rotation_about(slot.free_axis, np.asarray(angle)) @ slot.goals[goal]
    if np.any(angle):
        raise InputError(f"angle: the slot of {slot.part_id} has no free axis to rotate about")
    return slot.goals[goal]


def apply_error(goal_from_now: Pose, pivot: np.ndarray, offset: np.ndarray, rotvec: np.ndarray) -> Pose:
    """The guess with an error about a goal motion; a zero error gives the goal bit for bit.

    Args:
        goal_from_now: one motion.
        pivot: (3,) [m] world, on the part at its current pose.
        offset: (3,) [m] and rotvec: (3,) [rad], along world axes.
    """
    rotation = Pose.from_rotvec(rotvec)
    arm = goal_from_now.xyz - goal_from_now.apply(pivot)
    arm_change = rotation.rotate(arm) - arm
    return Pose(quaternion_multiply(rotation.wxyz, goal_from_now.wxyz), goal_from_now.xyz + offset + arm_change)


def error_of(guess: Pose, goal_from_now: Pose, pivot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The error of a guess, the inverse of `apply_error`: offset (3,) [m], rotvec (3,) [rad] of length at most pi."""
    return guess.apply(pivot) - goal_from_now.apply(pivot), (guess @ goal_from_now.inverse()).rotvec()


def _rotation_about(axis: FreeAxis, angle: np.ndarray) -> Pose:
    """Rotations by angles (...,) [rad] about a line."""
    rotation = Pose.from_rotvec(angle[..., None] * axis.direction)
    return Pose.from_translation(axis.point) @ rotation @ Pose.from_translation(-axis.point)
