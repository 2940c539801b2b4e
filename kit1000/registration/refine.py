"""Refinement of a candidate against the bounds of the part, by robust Levenberg-Marquardt steps on SE(3).

The true part contains what is surely solid and lies within what is possible. So for every point of the cavity the
distance from the part's wall or floor is known to lie in an interval. If the interval contains the clearance, the point
adds no residual. The filled part is a weak prior beside the bounds, which decides if they leave the pose open.

The steps amplify a difference in the last bit to millimetres if a fit is loose. So they use no BLAS or LAPACK and no
sine or cosine, whose last bit depends on the processor: small rotations are Rodrigues vectors, which need neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from kit1000.numerics.compiled import compiled
from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.observed.parts import PartBounds
from kit1000.pose import Pose
from kit1000.registration.geometry.cavity import Cavity, cells_at
from kit1000.registration.geometry.sweeps import (
    Sweep,
    cell_at,
    distance_at,
    envelope_about,
    floors_under,
    in_sweep,
    nearer,
    rotation_matrices,
)
from kit1000.registration.search import Candidate

STEPS = 6  # Levenberg-Marquardt steps at each scale
LEVER = 0.02  # [m] a tilt moves the edge of a part by about its angle times this
DIFFERENCES = np.array([1e-3, 1e-3, 1e-3, 5e-5, 5e-5, 5e-5])  # [rad, m] steps of the numerical derivatives
METRIC = np.array([LEVER, LEVER, LEVER, 1, 1, 1]) ** 2
STIFFNESS = 1.0  # weight of a tilt of the part's lower face against the floor: how far it moves a point at LEVER
MOST_POINTS = 1500  # points of a cavity that are read
MAX_RESIDUAL = 2e-3  # [m] at which residuals are clipped in a cost
HOLD = 0.5  # weight of the coarse height if no floor is observed, beside a point of the cavity
SEEN_FLOOR = 0.05  # least share of a cavity's points on a level floor for which its depth is observed
LEVEL = 1e-3  # [m] within which a floor is level, and at the cavity's depth
START = 2e-3  # [m] below the filled part, from where on the sure one is searched: it lies within
BASE = 2e-3  # [m] below the filled part, where slices begin: the possible part may reach lower


class Intervals(NamedTuple):
    """A refined pose and what is left of its residuals."""

    plate_from_now: Pose
    outside: float
    """[m] RMS of the distances from the intervals."""
    filled: float
    """[m] RMS of the residuals of the filled part."""


def refine_within(
    bounds: PartBounds,
    pivot: np.ndarray,
    candidate: Candidate,
    clearance: float,
    prior: float,
    scales: Sequence[float],
) -> Intervals:
    """The best plate_from_now near a candidate.

    Args:
        bounds: of the part.
        pivot: (3,) [m] world, of the part.
        candidate: where it starts.
        clearance: [m]
        prior: weight of the filled part beside the bounds.
        scales: see `descend`.
    """
    cavity, rotation = candidate.cavity, Pose(candidate.plate_from_now.wxyz, np.zeros(3))
    start = candidate.plate_from_now.apply(pivot)
    problem = IntervalProblem(
        points=np.ascontiguousarray(cavity.points[:: -(-len(cavity.points) // MOST_POINTS) or 1]),
        sweeps=sweeps_of(bounds, pivot, rotation, cavity.depth, clearance),
        down_normal=rotation.rotate(candidate.down_normal),
        clearance=clearance,
        prior=prior,
        height=float(start[2]),
        hold=0.0 if floor_is_seen(cavity) else HOLD,
    )
    twist = descend(problem, np.concatenate([np.zeros(3), start]), scales)
    (outside,), (filled,) = problem.distances(twist[None], problem.floors_at(twist))
    return Intervals(pose_at(twist, rotation, pivot), clipped_rms(outside), clipped_rms(filled))


def floor_is_seen(cavity: Cavity) -> bool:
    """Whether enough of the cavity's points lie on a level floor at its depth."""
    heights = np.where(cavity.region, cavity.certain_heights, np.nan)
    filled = np.where(np.isnan(heights), 0.0, heights)
    level = np.asarray(maximum_filter(filled, 3)) - np.asarray(minimum_filter(filled, 3)) < LEVEL
    floor = level & (np.abs(filled + cavity.depth) < LEVEL)
    i, j = cells_at(cavity.points, len(heights))
    return bool(floor[i, j].mean() >= SEEN_FLOOR) if len(cavity.points) else False


def sweeps_of(
    bounds: PartBounds, pivot: np.ndarray, rotation: Pose, depth: float, clearance: float
) -> tuple[Sweep, Sweep, Sweep]:
    """The sweeps of the filled, the sure and the possible part, in the same slices."""
    filled, possible = (envelope_about(part, pivot, rotation, clearance) for part in (bounds.filled, bounds.possible))
    sure = envelope_about(bounds.sure, pivot, rotation, clearance, filled - START)
    base = float(filled.min()) - BASE
    sweeps = (
        Sweep.from_envelope(envelope, rotation, base, depth + BASE, clearance)
        for envelope in (filled, np.maximum(sure, filled), np.minimum(possible, filled))
    )
    first, second, third = sweeps
    return first, second, third


@dataclass(frozen=True, eq=False)
class IntervalProblem:
    """The least-squares problem; its priors are the tilt of the lower face and the height."""

    points: np.ndarray
    """(n, 3) [m] plate frame: points of the cavity."""
    sweeps: tuple[Sweep, Sweep, Sweep]
    """Sweeps of the filled, the sure and the possible part."""
    down_normal: np.ndarray
    """(3,) plate frame: normal of the lower face in the rotation of the sweeps."""
    clearance: float
    prior: float
    """Weight of the filled part beside the bounds."""
    height: float
    """[m] of the pivot as the coarse search found it."""
    hold: float
    """Weight of that height."""

    @property
    def priors(self) -> int:
        """Tilt and height."""
        return 3

    def floors_at(self, twist: np.ndarray) -> np.ndarray:
        """(3, n) [m]: floors of the filled, the sure and the possible part."""
        return np.stack([floors_under(self.points, twist, sweep.floor) for sweep in self.sweeps])

    def residuals(self, twists: np.ndarray, floors: np.ndarray) -> np.ndarray:
        """(m, 2 n + 3) [m] at twists (m, 6); floors (3, n) [m] of `floors_at`."""
        outside, filled = self.distances(twists, floors)
        root = np.sqrt(len(self.points))
        tilt = STIFFNESS * root * LEVER * tilt_of(self.down_normal, twists)
        held = self.hold * root * (twists[:, 5:] - self.height)
        return np.concatenate([outside, self.prior * filled, tilt, held], axis=1)

    def distances(self, twists: np.ndarray, floors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(m, n) [m] of each point from its interval, and (m, n) from the filled part."""
        fields = [sweep.distance for sweep in self.sweeps]
        outside, filled = np.empty((2, len(twists), len(self.points)))
        lowest = self.sweeps[0].lowest
        _distances(self.points, twists, *fields, *floors, lowest, self.clearance, outside, filled)
        return outside, filled


@compiled
def _distances(points, twists, filled, sure, possible, f0, f1, f2, lowest, clearance, outside, from_filled):
    """Fill the signed distances (m, n) of points from their intervals and from the filled part, at twists (m, 6).

    f0, f1, f2: (n,) the floors of the filled, the sure and the possible part.
    """
    r = rotation_matrices(twists)
    for p in range(len(points)):
        for t in range(len(twists)):  # innermost: twists nearby read the same cells
            x, y, z = in_sweep(points[p], twists[t], r[t])
            u, v, w = cell_at(x, y, z - lowest, filled.shape)
            wall = distance_at(filled, u, v, w) - clearance
            from_filled[t, p] = nearer(wall, f0[p] - z)
            walls = distance_outside(distance_at(possible, u, v, w) - clearance, distance_at(sure, u, v, w) - clearance)
            outside[t, p] = nearer(walls, distance_outside(f2[p] - z, f1[p] - z))


@compiled
def distance_outside(low, high):
    """Signed distance of 0 from the interval of two numbers: positive below it, negative above it."""
    return max(min(low, high), 0.0) + min(max(low, high), 0.0)


def clipped_rms(residuals: np.ndarray) -> float:
    """[m] root mean square of residuals (n,), each at most MAX_RESIDUAL; MAX_RESIDUAL if there are none."""
    if len(residuals) == 0:
        return MAX_RESIDUAL
    return float(np.sqrt(np.mean(np.minimum(residuals**2, MAX_RESIDUAL**2))))


class LeastSquares(Protocol):
    """A least-squares problem over a twist (6,): a Rodrigues vector and a position of the pivot [m].

    A Rodrigues vector is the axis times twice the tangent of half the angle; it equals the rotation vector up to the
    third power of the angle.
    """

    @property
    def priors(self) -> int:
        """Number of residuals at the end that are no observations; their weight is always 1."""
        ...

    def floors_at(self, twist: np.ndarray) -> np.ndarray:
        """(m, n) [m]: the floor under each point at a twist, of each sweep."""
        ...

    def residuals(self, twists: np.ndarray, floors: np.ndarray) -> np.ndarray:
        """(m, n + priors) [m] at twists (m, 6).

        floors: those at one twist. All twists share them, which keeps the steps of the floor out of the derivatives:
        floors fix height and tilt, walls fix position and yaw.
        """
        ...


class Linear(NamedTuple):
    """A linearised least-squares problem."""

    residuals: np.ndarray
    """(n + priors,)"""
    normal: np.ndarray
    """(6, 6) matrix of the normal equations."""
    gradient: np.ndarray
    """(6,) their right side, negated."""


def descend(
    problem: LeastSquares,
    twist: np.ndarray,
    scales: Sequence[float],
    differences: np.ndarray = DIFFERENCES,
) -> np.ndarray:
    """(6,) the twist of the nearest local minimum.

    Args:
        problem: of residuals in some unit.
        twist: (6,) where it starts.
        scales: of the weights in that unit, one after the other.
        differences: (6,) steps of the numerical derivatives.
    """
    for scale in scales:
        twist = _levenberg(problem, twist, scale, differences)
    return twist


def tilt_of(normal: np.ndarray, twists: np.ndarray) -> np.ndarray:
    """(m, 2) horizontal part of a normal (3,) after the small rotations of twists (m, 6)."""
    (x, y, z), (a, b, c) = normal, twists[:, :3].T
    return np.stack([x + b * z - c * y, y + c * x - a * z], axis=1)


def pose_at(twist: np.ndarray, rotation: Pose, pivot: np.ndarray) -> Pose:
    """plate_from_now at a twist (6,) after a rotation; pivot (3,) [m] now."""
    refined = Pose(np.append(1.0, twist[:3] / 2), np.zeros(3)) @ rotation
    return Pose(refined.wxyz, twist[3:] - refined.rotate(pivot))


def linearised(
    problem: LeastSquares, twist: np.ndarray, floors: np.ndarray, scale: float, differences: np.ndarray
) -> Linear:
    """A problem linearised at a twist (6,), with robust weights of a scale. floors: see `LeastSquares`."""
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
