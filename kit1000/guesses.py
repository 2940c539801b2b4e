"""Initial guesses of a simulated user: how far they are off, as drawn for the tracks and as set for the curves."""

from __future__ import annotations

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import unit_vector
from kit1000.values import Slot

MAX_OFFSET = 28e-3  # [m] most along a world axis: as far as the paper's matcher looks around a guess
MAX_ANGLE = float(np.radians(27.5))  # most: as far as the paper's candidate turns reach
LEVELS = 8  # of a curve: level k is k/7 of OFFSET and of ANGLE
FIXED_LEVELS = (1, 4, 7)  # at which one kind of error stays while the other runs through all levels


def draw_goal(rng: np.random.Generator, slot: Slot) -> tuple[int, float]:
    """One of all goals, evenly: its index, and its turn [rad] about the free axis."""
    goal, turn = rng.integers(len(slot.goals)), rng.uniform(0, 2 * np.pi)
    return int(goal), float(turn) if slot.free_axis is not None else 0.0


def draw_direction(rng: np.random.Generator) -> np.ndarray:
    """(3,) unit vector, uniform on the sphere."""
    return unit_vector(rng.standard_normal(3))


def draw_ball_error(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """An offset (3,) [m], uniform in a cube, and a turn (3,) [rad] by an even angle about any axis."""
    return _draw_offset(rng), draw_direction(rng) * rng.uniform(0, MAX_ANGLE)


def draw_tilt_error(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The paper's error: the same offset, and a turn that takes the vertical to a direction the shortest way."""
    offset, azimuth = _draw_offset(rng), rng.uniform(0, 2 * np.pi)
    return offset, np.array([-np.sin(azimuth), np.cos(azimuth), 0.0]) * rng.uniform(0, MAX_ANGLE)


def level_offset(level: int) -> float:
    """Length [m] of the offset at a level of a curve: 0, 4 ... 28 mm."""
    return MAX_OFFSET * _level(level) / (LEVELS - 1)


def level_angle(level: int) -> float:
    """Angle [rad] of the turn at a level of a curve: 0, 3.9 ... 27.5 degrees."""
    return MAX_ANGLE * _level(level) / (LEVELS - 1)


def _level(level: int) -> int:
    if not 0 <= level < LEVELS:
        raise InputError(f"level: expected 0 to {LEVELS - 1}, got {level}")
    return level


def _draw_offset(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-MAX_OFFSET, MAX_OFFSET, 3)
