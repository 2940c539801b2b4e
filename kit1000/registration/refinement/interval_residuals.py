"""Refinement against what is certain of the part: residuals are distances from intervals, not from a guess.

The true part contains what is surely solid and lies within what is possible. So of every point of the cavity the
distance from the part's wall or floor is known to lie in an interval, and where that contains the clearance the point
says nothing. The filled part is a weak prior beside it, which decides where nothing is certain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from kit1000.numerics.compiled import compiled
from kit1000.perception.observed.parts import PartEvidence
from kit1000.pose import Pose
from kit1000.registration.geometry.observed_cavity import Cavity, cells_at
from kit1000.registration.geometry.swept_slices import (
    Sweep,
    cell_at,
    distance_at,
    envelope_about,
    floors_under,
    in_sweep,
    nearer,
    rotation_matrices,
)
from kit1000.registration.refinement.levenberg_marquardt import LEVER, SCALES, descend, pose_at, tilt_of
from kit1000.registration.refinement.walls import clipped_rms
from kit1000.registration.search.correlation import Candidate

MOST_POINTS = 1500  # of a cavity
HOLD = 0.5  # weight of the coarse height where no floor is observed, beside a point of the cavity
SEEN_FLOOR = 0.05  # share of a cavity's points on a level floor from which on its depth is observed
LEVEL = 1e-3  # [m] within which a floor is level, and at the cavity's depth
START = 2e-3  # [m] below the filled part, from where on the surely solid one is searched: it lies within
BASE = 2e-3  # [m] below the filled part, where slices begin: the possible part may reach lower


class Intervals(NamedTuple):
    """A refined pose and what is left of its residuals."""

    plate_from_now: Pose
    outside: float
    """[m] RMS of the distances from the intervals."""
    filled: float
    """[m] RMS of the residuals of the filled part."""


def refine_within(
    evidence: PartEvidence,
    pivot: np.ndarray,
    candidate: Candidate,
    clearance: float,
    stiffness: float,
    prior: float,
    scales: Sequence[float] = SCALES,
) -> Intervals:
    """The best plate_from_now near a candidate.

    Args:
        evidence: of the part.
        pivot: (3,) [m] world, of the part.
        candidate: where it starts.
        clearance: [m]
        stiffness: see `refine`.
        prior: weight of the filled part beside what is certain.
        scales: see `descend`.
    """
    cavity, rotation = candidate.cavity, Pose(candidate.plate_from_now.wxyz, np.zeros(3))
    start = candidate.plate_from_now.apply(pivot)
    problem = IntervalProblem(
        points=np.ascontiguousarray(cavity.points[:: -(-len(cavity.points) // MOST_POINTS) or 1]),
        sweeps=sweeps_of(evidence, pivot, rotation, cavity.depth, clearance),
        down_normal=rotation.rotate(candidate.down_normal),
        clearance=clearance,
        stiffness=stiffness,
        prior=prior,
        height=float(start[2]),
        hold=0.0 if floor_is_seen(cavity) else HOLD,
    )
    twist = descend(problem, np.concatenate([np.zeros(3), start]), scales)
    (outside,), (filled,) = problem.distances(twist[None], problem.floors_at(twist))
    return Intervals(pose_at(twist, rotation, pivot), clipped_rms(outside), clipped_rms(filled))


def floor_is_seen(cavity: Cavity) -> bool:
    """Whether enough of the cavity's points lie on a level floor at its depth."""
    relief = np.where(cavity.region, cavity.certain_relief, np.nan)
    filled = np.where(np.isnan(relief), 0.0, relief)
    level = np.asarray(maximum_filter(filled, 3)) - np.asarray(minimum_filter(filled, 3)) < LEVEL
    floor = level & (np.abs(filled + cavity.depth) < LEVEL)
    i, j = cells_at(cavity.points, len(relief))
    return bool(floor[i, j].mean() >= SEEN_FLOOR) if len(cavity.points) else False


def sweeps_of(
    evidence: PartEvidence, pivot: np.ndarray, rotation: Pose, depth: float, clearance: float
) -> tuple[Sweep, Sweep, Sweep]:
    """The sweeps of the filled, the surely solid and the possible part, in the same slices."""
    filled, possible = (
        envelope_about(part, pivot, rotation, clearance) for part in (evidence.filled, evidence.possible)
    )
    sure = envelope_about(evidence.surely_solid, pivot, rotation, clearance, filled - START)
    base = float(filled.min()) - BASE
    sweeps = (
        Sweep.from_envelope(envelope, rotation, base, depth + BASE, clearance)
        for envelope in (filled, np.maximum(sure, filled), np.minimum(possible, filled))
    )
    first, second, third = sweeps
    return first, second, third


@dataclass(frozen=True, eq=False)
class IntervalProblem:
    """The least-squares problem; its priors are the tilt of the lower face and, where it is held, the height."""

    points: np.ndarray
    """(n, 3) [m] plate frame: of the cavity."""
    sweeps: tuple[Sweep, Sweep, Sweep]
    """Sweeps of the filled, the surely solid and the possible part."""
    down_normal: np.ndarray
    """(3,) plate frame: normal of the lower face in the rotation of the sweeps."""
    clearance: float
    stiffness: float
    prior: float
    """Weight of the filled part beside what is certain."""
    height: float
    """[m] of the pivot, by the coarse search."""
    hold: float
    """How firmly the height is held."""

    @property
    def priors(self) -> int:
        """Tilt and height."""
        return 3

    def floors_at(self, twist: np.ndarray) -> np.ndarray:
        """(3, n) [m]: of the filled, the surely solid and the possible part."""
        return np.stack([floors_under(self.points, twist, sweep.floor) for sweep in self.sweeps])

    def residuals(self, twists: np.ndarray, floors: np.ndarray) -> np.ndarray:
        """(m, 2 n + 3) [m] at twists (m, 6); floors (3, n) [m] of `floors_at`."""
        outside, filled = self.distances(twists, floors)
        root = np.sqrt(len(self.points))
        tilt = self.stiffness * root * LEVER * tilt_of(self.down_normal, twists)
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

    f0, f1, f2: (n,) the floors of the filled, the surely solid and the possible part.
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
