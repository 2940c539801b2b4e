"""Robust Levenberg-Marquardt on SE(3), from coarse to fine scales of the Geman-McClure weights.

The steps amplify a difference in the last bit to millimetres where a fit is loose. So they use no BLAS or LAPACK and no
sine or cosine, whose last bit depends on the processor: small rotations are Rodrigues vectors, which need neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import matmul
from kit1000.pose import Pose

SCALES = (4e-3, 2e-3, 1e-3, 0.5e-3)  # [m] of the Geman-McClure weights, from far to near
STEPS = 6  # of Levenberg-Marquardt at each scale
LEVER = 0.02  # [m] a tilt moves the edge of a part by about its angle times this
DIFFERENCES = np.array([1e-3, 1e-3, 1e-3, 5e-5, 5e-5, 5e-5])  # [rad, m] of the numerical derivatives
METRIC = np.array([LEVER, LEVER, LEVER, 1, 1, 1]) ** 2


class LeastSquares(Protocol):
    """A least-squares problem over a Rodrigues vector and a position of the pivot (6,).

    A Rodrigues vector is the axis times twice the tangent of half the angle: the angle, up to its third power.
    """

    @property
    def priors(self) -> int:
        """How many of the last residuals are no observations: their weight is always 1."""
        ...

    def floors_at(self, twist: np.ndarray) -> np.ndarray:
        """(m, n) [m]: the floor under each point at a twist, of each sweep."""
        ...

    def residuals(self, twists: np.ndarray, floors: np.ndarray) -> np.ndarray:
        """(m, n + priors) [m] at twists (m, 6).

        floors: those at one twist. That all share them keeps the steps of the floor out of derivatives: floors fix
        height and tilt, walls position and yaw.
        """
        ...


class Linear(NamedTuple):
    """A least-squares problem about a twist."""

    residuals: np.ndarray
    """(n + priors,)"""
    normal: np.ndarray
    """(6, 6) of the normal equations."""
    gradient: np.ndarray
    """(6,)"""


def descend(
    problem: LeastSquares,
    twist: np.ndarray,
    scales: Sequence[float] = SCALES,
    differences: np.ndarray = DIFFERENCES,
) -> np.ndarray:
    """(6,) the twist of the nearest minimum that is found.

    Args:
        problem: of residuals in some unit.
        twist: (6,) where it starts.
        scales: of the weights in that unit, one after the other.
        differences: (6,) of the numerical derivatives.
    """
    for scale in scales:
        twist = _levenberg(problem, twist, scale, differences)
    return twist


def tilt_of(normal: np.ndarray, twists: np.ndarray) -> np.ndarray:
    """(m, 2) horizontal part of a normal (3,), after the small rotations of twists (m, 6)."""
    (x, y, z), (a, b, c) = normal, twists[:, :3].T
    return np.stack([x + b * z - c * y, y + c * x - a * z], axis=1)


def pose_at(twist: np.ndarray, rotation: Pose, pivot: np.ndarray) -> Pose:
    """plate_from_now at a twist (6,) after a rotation; pivot (3,) [m] now."""
    refined = Pose(np.append(1.0, twist[:3] / 2), np.zeros(3)) @ rotation
    return Pose(refined.wxyz, twist[3:] - refined.rotate(pivot))


def linearised(
    problem: LeastSquares, twist: np.ndarray, floors: np.ndarray, scale: float, differences: np.ndarray
) -> Linear:
    """A problem at a twist (6,), its residuals weighted at a scale. floors: see `LeastSquares`."""
    aside = np.diag(differences)
    neighbours = np.concatenate([np.zeros((1, 6)), aside, -aside])  # of a twist, and itself
    residuals, *beside = problem.residuals(twist + neighbours, floors)
    jacobian = (np.stack(beside[:6], axis=1) - np.stack(beside[6:], axis=1)) / (2 * differences)
    weights = (scale**2 / (scale**2 + residuals**2)) ** 2
    weights[-problem.priors :] = 1
    weighted = (jacobian * weights[:, None]).T
    return Linear(residuals, matmul(weighted, jacobian), matmul(weighted, residuals))


def _levenberg(problem: LeastSquares, twist: np.ndarray, scale: float, differences: np.ndarray) -> np.ndarray:
    """(6,) Rodrigues vector and position of the pivot, after some steps at one scale of the weights."""
    damping = 1e-3
    for _ in range(STEPS):
        floors = problem.floors_at(twist)
        residuals, normal, gradient = linearised(problem, twist, floors, scale, differences)
        cost = _cost(residuals, problem.priors, scale)
        mean = np.trace(normal[3:, 3:]) / 3 + 1e-9
        for _ in range(4):
            move = -solve_positive(normal + damping * mean * np.diag(METRIC), gradient)
            if _cost(problem.residuals((twist + move)[None], floors)[0], problem.priors, scale) < cost:
                twist, damping = twist + move, damping / 3
                break
            damping *= 5
        else:
            break
        if np.abs(move[:3]).max() < 2e-5 and np.abs(move[3:]).max() < 1e-6:
            break
    return twist


def _cost(residuals: np.ndarray, priors: int, scale: float) -> float:
    square = residuals[:-priors] ** 2
    return float((square / (scale**2 + square)).sum() + (residuals[-priors:] ** 2).sum() / scale**2)
