"""Refinement against one volume of the part: its walls stand one clearance away from the part.

Every point of a cavity lies either on a wall, one clearance beside what the part sweeps at its height, or on the
floor, under the dilated part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.numerics.compiled import compiled
from kit1000.pose import Pose
from kit1000.registration.geometry.swept_slices import (
    Sweep,
    cell_at,
    distance_at,
    floors_under,
    in_sweep,
    nearer,
    rotation_matrices,
)
from kit1000.registration.refinement.levenberg_marquardt import LEVER, descend, pose_at, tilt_of
from kit1000.registration.search.correlation import Candidate
from kit1000.voxels import Volume

POINTS = 1500
MAX_RESIDUAL = 2e-3  # [m] at which residuals are clipped


def refine(
    part: Volume, pivot: np.ndarray, candidate: Candidate, clearance: float, stiffness: float
) -> tuple[Pose, float]:
    """The best plate_from_now near a candidate, and the RMS [m] of its residuals, clipped at MAX_RESIDUAL.

    stiffness: how firmly the lower face lies on the floor; 1 weighs a tilt by how far it moves a point at LEVER.
    """
    cavity, rotation = candidate.cavity, Pose(candidate.plate_from_now.wxyz, np.zeros(3))
    sweep = Sweep.from_part(part, pivot, rotation, cavity.depth, clearance)
    problem = Problem(sampled(cavity.points), sweep, rotation.rotate(candidate.down_normal), clearance, stiffness)
    twist = descend(problem, np.concatenate([np.zeros(3), candidate.plate_from_now.apply(pivot)]))
    left = problem.residuals(twist[None], problem.floors_at(twist))[0, : -problem.priors]
    return pose_at(twist, rotation, pivot), clipped_rms(left)


def sampled(points: np.ndarray) -> np.ndarray:
    """About POINTS of the points (n, 3), evenly spaced in their order."""
    return np.ascontiguousarray(points[:: max(1, len(points) // POINTS)])


def clipped_rms(residuals: np.ndarray) -> float:
    """[m] root mean square of residuals (n,), each at most MAX_RESIDUAL; that where there are none: nothing fits."""
    if len(residuals) == 0:
        return MAX_RESIDUAL
    return float(np.sqrt(np.mean(np.minimum(residuals**2, MAX_RESIDUAL**2))))


@dataclass(frozen=True, eq=False)
class Problem:
    """The least-squares problem: the distances of the points from walls and floor, and the tilt of the lower face."""

    points: np.ndarray
    """(n, 3) [m] plate frame: of the cavity."""
    sweep: Sweep
    down_normal: np.ndarray
    """(3,) plate frame: normal of the lower face in the rotation of the sweep."""
    clearance: float
    stiffness: float

    @property
    def priors(self) -> int:
        """The last two residuals are the tilt."""
        return 2

    def floors_at(self, twist: np.ndarray) -> np.ndarray:
        """(1, n) [m]"""
        return floors_under(self.points, twist, self.sweep.floor)[None]

    def residuals(self, twists: np.ndarray, floors: np.ndarray) -> np.ndarray:
        """(m, n + 2) [m] at twists (m, 6); floors (1, n) [m] of `floors_at`."""
        sweep, (floor,) = self.sweep, floors
        distances = _distances(self.points, twists, sweep.distance, floor, sweep.lowest, self.clearance)
        tilt = tilt_of(self.down_normal, twists)
        return np.concatenate([distances, self.stiffness * np.sqrt(len(self.points)) * LEVER * tilt], axis=1)


@compiled
def _distances(points, twists, distance, floors, lowest, clearance):
    """(m, n) [m]: signed distance of each point from the wall or the floor, whichever is nearer, at twists (m, 6)."""
    r = rotation_matrices(twists)
    out = np.empty((len(twists), len(points)))
    for p in range(len(points)):
        for t in range(len(twists)):  # innermost: twists nearby read the same cells
            x, y, z = in_sweep(points[p], twists[t], r[t])
            u, v, w = cell_at(x, y, z - lowest, distance.shape)
            out[t, p] = nearer(distance_at(distance, u, v, w) - clearance, floors[p] - z)
    return out
