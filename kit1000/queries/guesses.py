"""Errors of the simulated user's initial guess: random ones for the tracks, fixed levels for the robustness curves."""

from __future__ import annotations

import numpy as np

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import unit_vector
from kit1000.values import Slot

MAX_OFFSET = 28e-3  # [m] along each world axis: the search range of the paper's matcher around a guess
MAX_ANGLE = float(np.radians(27.5))  # the range of the candidate rotations of the paper
LEVELS = 8  # of a curve: level k is k/7 of MAX_OFFSET and of MAX_ANGLE
FIXED_LEVELS = (1, 4, 7)  # levels of one kind of error while the other varies over all levels
DECIMALS = 12  # of directions and rotation vectors: their last bits come from libm and depend on the processor


def draw_goal(rng: np.random.Generator, slot: Slot) -> tuple[int, float]:
    """A goal, uniform over all: its index, and its angle [rad] about the free axis (0 without one)."""
    goal, angle = rng.integers(len(slot.goals)), rng.uniform(0, 2 * np.pi)
    return int(goal), float(angle) if slot.free_axis is not None else 0.0


def draw_direction(rng: np.random.Generator) -> np.ndarray:
    """(3,) unit vector, uniform on the sphere, rounded to DECIMALS."""
    return np.round(unit_vector(rng.standard_normal(3)), DECIMALS)


def draw_ball_error(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """An offset (3,) [m], uniform in a cube, and a rotation vector (3,) [rad] of uniform angle about a uniform axis."""
    return _draw_offset(rng), draw_direction(rng) * rng.uniform(0, MAX_ANGLE)


def draw_tilt_error(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The same offset, and a rotation vector (3,) [rad] that tilts the vertical without twist.

    The release of the paper draws such rotations; its text has rotations about any axis.
    """
    offset, azimuth = _draw_offset(rng), rng.uniform(0, 2 * np.pi)
    axis = np.array([-sine(azimuth), cosine(azimuth), 0.0])
    return offset, np.round(axis, DECIMALS) * rng.uniform(0, MAX_ANGLE)


def level_offset(level: int) -> float:
    """Length [m] of the offset at a level of a curve: 0, 4 ... 28 mm."""
    return MAX_OFFSET * level / (LEVELS - 1)


def level_angle(level: int) -> float:
    """Angle [rad] of the rotation at a level of a curve: 0, 3.9 ... 27.5 degrees."""
    return MAX_ANGLE * level / (LEVELS - 1)


def _draw_offset(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-MAX_OFFSET, MAX_OFFSET, 3)
