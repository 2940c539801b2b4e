"""Refinement: robust Levenberg-Marquardt on SE(3), in which walls stand one clearance away from the part.

Every point of a cavity lies either on a wall, one clearance beside what the part sweeps at its height, or on the
floor, under the dilated part. The part's sweep is stored as distances in slices, for one rotation.

The steps amplify a difference in the last bit to millimetres where a fit is loose. So they use no BLAS or LAPACK and no
sine or cosine, whose last bit depends on the processor: small rotations are Rodrigues vectors, which need neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.elimination import solve_positive
from baselines.registration.relief import dilated, lower_envelope
from baselines.registration.search import Candidate
from kit1000.compiled import compiled
from kit1000.pose import Pose
from kit1000.products import matmul
from kit1000.voxels import Volume

CELL = 0.625e-3  # [m] of slices
WIDE = 144  # cells: 90 mm
LAYER = 1e-3  # [m] between slices
SCALES = (4e-3, 2e-3, 1e-3, 0.5e-3)  # [m] of the Geman-McClure weights, from far to near
STEPS = 6  # of Levenberg-Marquardt at each scale
REACH = 12  # cells (7.5 mm) up to which distances are computed
POINTS = 1500
MAX_RESIDUAL = 2e-3  # [m] at which residuals are clipped
LEVER = 0.02  # [m] a tilt moves the edge of a part by about its angle times this
DIFFERENCES = np.array([1e-3, 1e-3, 1e-3, 5e-5, 5e-5, 5e-5])  # [rad, m] of the numerical derivatives
METRIC = np.array([LEVER, LEVER, LEVER, 1, 1, 1]) ** 2


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a part sweeps on its way up, in one rotation, from its lowest point on; its pivot is the origin."""

    rotation: Pose
    """plate_from_now, a rotation alone."""
    distance: np.ndarray
    """(layers, n, n) float32 [m]: horizontal distance from each cell to the sweep at the layer's height; 0 inside."""
    floor: np.ndarray
    """(n, n) float32 [m]: lower envelope of the dilated part; 0.1 where there is none."""
    lowest: float
    """[m] of the sweep, relative to the pivot."""

    @classmethod
    def from_part(cls, part: Volume, pivot: np.ndarray, rotation: Pose, depth: float, clearance: float) -> Sweep:
        """The sweep of a part in a rotation, up to a little more than `depth` [m] above its lowest point."""
        envelope = lower_envelope(part, rotation @ Pose.from_translation(-pivot), CELL, WIDE)
        lowest = float(envelope.min())
        layers = int(np.ceil((depth + 3e-3) / LAYER)) + 1
        distance = np.empty((layers, WIDE, WIDE), np.float32)
        _horizontal_distances(envelope - lowest, LAYER, CELL, distance)
        floor = dilated(envelope, CELL, clearance)
        return cls(rotation, distance, np.where(np.isfinite(floor), floor, 0.1).astype(np.float32), lowest)


def refine(
    part: Volume, pivot: np.ndarray, candidate: Candidate, clearance: float, stiffness: float
) -> tuple[Pose, float]:
    """The best plate_from_now near a candidate, and the RMS [m] of its residuals, clipped at MAX_RESIDUAL.

    stiffness: how firmly the lower face lies on the floor; 1 weighs a tilt by how far it moves a point at LEVER.
    """
    cavity, rotation = candidate.cavity, Pose(candidate.plate_from_now.wxyz, np.zeros(3))
    points = np.ascontiguousarray(cavity.points[:: max(1, len(cavity.points) // POINTS)])
    sweep = Sweep.from_part(part, pivot, rotation, cavity.depth, clearance)
    problem = Problem(points, sweep, rotation.rotate(candidate.down_normal), clearance, stiffness)
    twist = np.concatenate([np.zeros(3), candidate.plate_from_now.apply(pivot)])
    for scale in SCALES:
        twist = _levenberg(problem, twist, scale)
    refined = Pose(np.append(1.0, twist[:3] / 2), np.zeros(3)) @ rotation
    rms = float(np.sqrt(np.mean(np.minimum(problem.residuals(twist)[:-2] ** 2, MAX_RESIDUAL**2))))
    return Pose(refined.wxyz, twist[3:] - refined.rotate(pivot)), rms


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

    def residuals(self, twist: np.ndarray, about: np.ndarray | None = None) -> np.ndarray:
        """(n + 2,) [m] at a Rodrigues vector and a position of the pivot (6,); the last two are the tilt.

        A Rodrigues vector is the axis times twice the tangent of half the angle: the angle, up to its third power.

        about: (6,) at which the floor under each point is looked up; the twist itself by default. A fixed one keeps
        the steps of the floor out of derivatives: floors fix height and tilt, walls position and yaw.
        """
        sweep = self.sweep
        floors = _floors(self.points, twist if about is None else about, sweep.floor)
        distances = _residuals(self.points, twist, sweep.distance, floors, sweep.lowest, self.clearance)
        (x, y, z), (a, b, c) = self.down_normal, twist[:3]
        tilt = np.array([x + b * z - c * y, y + c * x - a * z])  # of the normal after a small rotation
        return np.append(distances, self.stiffness * np.sqrt(len(distances)) * LEVER * tilt)


def _levenberg(problem: Problem, twist: np.ndarray, scale: float) -> np.ndarray:
    """(6,) Rodrigues vector and position of the pivot, after some steps at one scale of the weights."""
    damping = 1e-3
    for _ in range(STEPS):
        residuals = problem.residuals(twist)
        cost = _cost(residuals, scale)
        jacobian = np.empty((len(residuals), 6))
        for k in range(6):
            step = np.zeros(6)
            step[k] = DIFFERENCES[k]
            jacobian[:, k] = (problem.residuals(twist + step, twist) - problem.residuals(twist - step, twist)) / (
                2 * DIFFERENCES[k]
            )
        weights = (scale**2 / (scale**2 + residuals**2)) ** 2
        weights[-2:] = 1
        weighted = (jacobian * weights[:, None]).T
        normal, gradient = matmul(weighted, jacobian), matmul(weighted, residuals)
        mean = np.trace(normal[3:, 3:]) / 3 + 1e-9
        for _ in range(4):
            move = -solve_positive(normal + damping * mean * np.diag(METRIC), gradient)
            if _cost(problem.residuals(twist + move, twist), scale) < cost:
                twist, damping = twist + move, damping / 3
                break
            damping *= 5
        else:
            break
        if np.abs(move[:3]).max() < 2e-5 and np.abs(move[3:]).max() < 1e-6:
            break
    return twist


def _cost(residuals: np.ndarray, scale: float) -> float:
    square = residuals[:-2] ** 2
    return float((square / (scale**2 + square)).sum() + (residuals[-2:] ** 2).sum() / scale**2)


@compiled
def _horizontal_distances(heights, layer, cell, distance):
    """Fill distance (layers, n, n): from each cell to the nearest whose envelope is at or below the layer.

    Exact up to REACH cells, and REACH beyond. Half a cell less: the edge runs between a cell inside and the next.
    """
    layers, n, _ = distance.shape
    along = np.empty((n, n))
    for k in range(layers):
        for i in range(n):
            gap = np.inf
            for j in range(n):
                gap = 0.0 if heights[i, j] <= k * layer + 1e-9 else gap + 1
                along[i, j] = gap
            gap = np.inf
            for j in range(n - 1, -1, -1):
                gap = 0.0 if heights[i, j] <= k * layer + 1e-9 else gap + 1
                along[i, j] = min(along[i, j], gap)
        for i in range(n):
            for j in range(n):
                least = float(REACH * REACH)
                for other in range(max(i - REACH, 0), min(i + REACH + 1, n)):
                    least = min(least, along[other, j] ** 2 + (other - i) ** 2)
                distance[k, i, j] = max(np.sqrt(least) - 0.5, 0.0) * cell


@compiled
def _rotation(twist):
    """(3, 3) rotation matrix of the first three numbers, a Rodrigues vector."""
    x, y, z = twist[0] / 2, twist[1] / 2, twist[2] / 2
    t = 2 / (1 + x * x + y * y + z * z)
    return np.array(
        [
            [1 - t * (y * y + z * z), t * (x * y - z), t * (x * z + y)],
            [t * (x * y + z), 1 - t * (x * x + z * z), t * (y * z - x)],
            [t * (x * z - y), t * (y * z + x), 1 - t * (x * x + y * y)],
        ]
    )


@compiled
def _in_sweep(point, twist, r):
    """The point in the frame of the sweep."""
    dx, dy, dz = point[0] - twist[3], point[1] - twist[4], point[2] - twist[5]
    x = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
    y = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
    z = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
    return x, y, z


@compiled
def _floors(points, twist, floor):
    """(n,) [m]: the floor at the cell of each point."""
    n = floor.shape[0]
    r = _rotation(twist)
    out = np.empty(len(points))
    for p in range(len(points)):
        x, y, _ = _in_sweep(points[p], twist, r)
        u, v = x / CELL + (n - 1) / 2, y / CELL + (n - 1) / 2
        out[p] = floor[int(min(max(u + 0.5, 0.0), n - 1.0)), int(min(max(v + 0.5, 0.0), n - 1.0))]
    return out


@compiled
def _residuals(points, twist, distance, floors, lowest, clearance):
    """(n,) [m]: signed distance of each point from the wall or the floor, whichever is nearer."""
    layers, n, _ = distance.shape
    r = _rotation(twist)
    out = np.empty(len(points))
    for p in range(len(points)):
        x, y, z = _in_sweep(points[p], twist, r)
        u = min(max(x / CELL + (n - 1) / 2, 0.0), n - 1.001)
        v = min(max(y / CELL + (n - 1) / 2, 0.0), n - 1.001)
        w = min(max((z - lowest) / LAYER, 0.0), layers - 1.001)
        i, j, k = int(u), int(v), int(w)
        a, b, c = u - i, v - j, w - k
        below = (1 - a) * ((1 - b) * distance[k, i, j] + b * distance[k, i, j + 1])
        below += a * ((1 - b) * distance[k, i + 1, j] + b * distance[k, i + 1, j + 1])
        above = (1 - a) * ((1 - b) * distance[k + 1, i, j] + b * distance[k + 1, i, j + 1])
        above += a * ((1 - b) * distance[k + 1, i + 1, j] + b * distance[k + 1, i + 1, j + 1])
        wall = (1 - c) * below + c * above - clearance
        under = floors[p] - z
        out[p] = wall if abs(wall) < abs(under) else under
    return out
