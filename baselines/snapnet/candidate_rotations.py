"""The candidate rotations of the rotation network: around a guess, or all that a part without a guess may need.

Candidates are along the working axes, on the left: correct rotation = candidate . guess. The angle from the correct
rotation to the nearest candidate remains as an error, whatever the network predicts; `error_floor` measures it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from kit1000.errors import InputError, did_you_mean
from kit1000.pose import Pose, quaternion_from_rotvec, quaternion_multiply
from kit1000.queries.guesses import MAX_ANGLE, draw_ball_error, draw_tilt_error
from kit1000.rng import stream

CandidateSet = Literal["ball", "tilt", "place", "place-paper"]

COUNT = 391  # of the paper: 1 + 5 rings of 78
RINGS, ON_RING = 5, 78  # the release: int(0.48 / 0.08) - 1, and the whole steps of 0.08 rad in a circle
TILT = 0.48  # [rad] of the outermost ring, 27.5 degrees
COARSE = 49  # of them, in a search from coarse to fine: some 8 degrees apart
NEAR, MOST_NEAR = float(np.radians(12)), 41  # [rad] about a rotation, and how many candidates there are scored
BALL_REACH = 0.94  # of 27.5 degrees: the outermost candidates; this has the least mean error floor for uniform angles
PLACE_TILT = float(np.radians(45))  # largest tilt of a cavity
PLACE_SPIRAL = 4096  # rotations of the spiral before those of more tilt are left out
PAPER_EULER = float(np.radians(15))  # largest roll and pitch of the paper's candidates without a guess
PAPER_SPACING = float(np.radians(10))  # smallest angle between two of them


@dataclass(frozen=True)
class ErrorFloor:
    """Angles [rad] between drawn rotations and the nearest candidate."""

    count: int
    """Candidates."""
    mean: float
    median: float
    most: float


@cache
def candidates(name: CandidateSet) -> Pose:
    """A set of candidate rotations about the origin, (n,).

    - ball: 391 rotation vectors on a body-centred cubic lattice, the identity and inverses included, up to 26 degrees
      about any axis, for errors of up to 27.5.
    - tilt: the paper's 391: the identity and 5 rings of 78 rotations about horizontal axes; none changes the yaw.
    - place: a uniform spiral over all rotations, restricted to those that tilt the vertical by 45 degrees at most.
    - place-paper: the paper's without a guess: every yaw, roll and pitch within 15 degrees, thinned to 10 degrees
      apart; 286, as in the release.

    Raises:
        InputError: unknown name.
    """
    if name not in _MAKERS:
        raise InputError(f"candidates: {did_you_mean(name, _MAKERS)}expected one of {', '.join(_MAKERS)}, got {name!r}")
    return Pose(_MAKERS[name](), np.zeros(3))


@cache
def coarse_candidates(name: CandidateSet) -> Pose:
    """COARSE rotations of a set, far apart."""
    return _far_apart(candidates(name), Pose.identity(), COARSE)


def near_candidates(name: CandidateSet, rotation: Pose) -> Pose:
    """Rotations of a set within NEAR of a rotation; of more than MOST_NEAR as many far apart."""
    offered = candidates(name)
    near = offered[np.flatnonzero((rotation.inverse() @ offered).angle() <= NEAR)]
    return near if len(near) <= MOST_NEAR else _far_apart(near, rotation, MOST_NEAR)


def _far_apart(rotations: Pose, first: Pose, count: int) -> Pose:
    """The rotation nearest to `first`, then always the one farthest from all chosen. (n,) -> (count,)."""
    wxyz, chosen = rotations.wxyz, []
    nearest = np.zeros(len(wxyz))  # cosine of half the angle to the nearest chosen one
    for _ in range(count):
        chosen.append(int(nearest.argmin() if chosen else np.abs((wxyz * first.wxyz).sum(1)).argmax()))
        nearest = np.maximum(nearest, np.abs((wxyz * wxyz[chosen[-1]]).sum(1)))
    return rotations[np.array(chosen)]


def nearest_candidate(candidates: Pose, correct: Pose, axis: np.ndarray | None = None) -> tuple[int, np.ndarray]:
    """The candidate nearest to any correct rotation.

    Args:
        candidates: (n,).
        correct: (m,), the correct rotations.
        axis: (3,) unit vector along the working axes: where given, a correct rotation followed by any rotation about
            it is correct too.

    Returns:
        Its index, and the angle of each candidate to the nearest correct rotation, (n,) [rad].
    """
    return int(np.argmin(angles := angles_between(candidates, correct, axis).min(1))), angles


def angles_between(candidates: Pose, correct: Pose, axis: np.ndarray | None = None) -> np.ndarray:
    """Angle of each candidate to each correct rotation, as in `nearest_candidate`. (n,), (m,) -> (n, m) [rad].

    With p = correct . candidate^-1, a further rotation by t about the axis a leaves |cos(angle / 2)| =
    |cos(t / 2) p_w - sin(t / 2) a.p_v|, the largest value of which is the length of (p_w, a.p_v).
    """
    between = quaternion_multiply(correct.wxyz[None], candidates.inverse().wxyz[:, None])  # (n, m, 4)
    scalar, vector = between[..., 0], between[..., 1:]
    if axis is not None:
        along = vector @ np.asarray(axis)
        scalar, vector = np.hypot(scalar, along), vector - along[..., None] * axis
    return 2 * np.arctan2(np.linalg.norm(vector, axis=-1), np.abs(scalar))


def error_floor(
    name: CandidateSet, draws: int = 20000, seed: int = 0, errors: CandidateSet | None = None
) -> ErrorFloor:
    """Angles from drawn rotations to the nearest candidate.

    Args:
        name: of the candidates.
        draws: rotations drawn.
        seed: of the draws.
        errors: the distribution, by default the one that the candidates are for. ball and tilt: errors of a guess;
            place: any yaw and a uniform direction of the vertical within 45 degrees; place-paper: any yaw, roll and
            pitch within 15.
    """
    rng = stream(seed, "floor", errors or name)
    rotations = _DRAWS[errors or name](rng, draws)
    offered = candidates(name).wxyz
    cosines = np.concatenate([np.abs(some @ offered.T).max(1) for some in np.array_split(rotations, 1 + draws // 1000)])
    angles = 2 * np.arccos(np.minimum(cosines, 1))
    return ErrorFloor(len(offered), float(angles.mean()), float(np.median(angles)), float(angles.max()))


def _ball() -> np.ndarray:
    """The lattice points nearest to the origin, in opposite pairs, scaled so that the last one lies at BALL_REACH."""
    reach = np.arange(-6, 7)
    whole = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), -1).reshape(-1, 3) * 2
    lattice = np.concatenate([whole, whole + 1])  # in half edges, so that all are integers
    square = (lattice**2).sum(1)
    half = lattice[np.lexsort((*lattice.T, square))]
    half = half[[tuple(row) > (0, 0, 0) for row in half]][: COUNT // 2]
    vectors = np.concatenate([half[::-1] * -1, np.zeros((1, 3), int), half])
    return quaternion_from_rotvec(vectors * (BALL_REACH * MAX_ANGLE / np.sqrt((half**2).sum(1).max())))


def _tilt() -> np.ndarray:
    angle, azimuth = np.meshgrid(np.linspace(0, TILT, RINGS + 1)[1:], _circle(ON_RING), indexing="ij")
    vectors = np.stack([-np.sin(azimuth) * angle, np.cos(azimuth) * angle, 0 * angle], -1).reshape(-1, 3)
    return quaternion_from_rotvec(np.concatenate([np.zeros((1, 3)), vectors]))


def _place() -> np.ndarray:
    spiral = super_fibonacci(PLACE_SPIRAL)
    return spiral[_tilts(spiral) <= PLACE_TILT]


def super_fibonacci(count: int) -> np.ndarray:
    """Rotations spread uniformly: Alexa, "Super-Fibonacci spirals" (2022). (count, 4) wxyz."""
    psi = 1.533751168755204288118041  # psi^4 = psi + 4
    steps = np.arange(count) + 0.5
    share = steps / count
    alpha, beta = 2 * np.pi * steps / np.sqrt(2), 2 * np.pi * steps / psi
    inner, outer = np.sqrt(share), np.sqrt(1 - share)
    return np.stack([outer * np.cos(beta), inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta)], -1)


def _place_paper() -> np.ndarray:
    """In the order of the release: all axes and angles, then yaws; one is kept if it is far from all kept before."""
    polar = np.linspace(0.1, np.pi, 31)
    azimuth = np.linspace(0, 2 * np.pi, 62)
    a, b, angle = np.meshgrid(polar, azimuth, np.linspace(0.1, 3.4, 34), indexing="ij")
    axes = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], -1)
    around = quaternion_from_rotvec((axes * angle[..., None]).reshape(-1, 3))
    roll, pitch = _roll_pitch(around)
    around = around[(np.abs(roll) <= PAPER_EULER) & (np.abs(pitch) <= PAPER_EULER)]
    yaws = quaternion_from_rotvec(np.linspace(-np.pi, np.pi, 62)[:, None] * (0, 0, 1))
    kept = np.empty((0, 4))
    for rotation in np.concatenate([around, yaws]):
        if np.all(np.abs(kept @ rotation) <= np.cos(PAPER_SPACING / 2)):
            kept = np.concatenate([kept, rotation[None]])
    return kept


def _roll_pitch(wxyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch of Rz(yaw) Ry(pitch) Rx(roll). (n, 4) -> (n,), (n,) [rad]."""
    w, x, y, z = wxyz.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, np.arcsin(np.clip(2 * (w * y - x * z), -1, 1))


def _tilts(wxyz: np.ndarray) -> np.ndarray:
    """Angles between the vertical and the rotated vertical. (n, 4) -> (n,) [rad]."""
    return 2 * np.arctan2(np.hypot(wxyz[:, 1], wxyz[:, 2]), np.hypot(wxyz[:, 0], wxyz[:, 3]))


def _circle(count: int) -> np.ndarray:
    return np.arange(count) * (2 * np.pi / count)


def _draw_place(rng: np.random.Generator, draws: int) -> np.ndarray:
    tilt = np.arccos(rng.uniform(np.cos(PLACE_TILT), 1, draws))
    azimuth, yaw = rng.uniform(-np.pi, np.pi, (2, draws))
    tilted = quaternion_from_rotvec(np.stack([-np.sin(azimuth) * tilt, np.cos(azimuth) * tilt, 0 * tilt], -1))
    return quaternion_multiply(tilted, quaternion_from_rotvec(yaw[:, None] * (0, 0, 1)))


def _draw_place_paper(rng: np.random.Generator, draws: int) -> np.ndarray:
    roll, pitch = rng.uniform(-PAPER_EULER, PAPER_EULER, (2, draws, 1))
    yaw = rng.uniform(-np.pi, np.pi, (draws, 1))
    steps = [quaternion_from_rotvec(a * e) for a, e in zip((yaw, pitch, roll), np.eye(3)[::-1], strict=True)]
    return quaternion_multiply(quaternion_multiply(steps[0], steps[1]), steps[2])


_MAKERS = {"ball": _ball, "tilt": _tilt, "place": _place, "place-paper": _place_paper}
_DRAWS = {
    "ball": lambda rng, n: quaternion_from_rotvec(np.stack([draw_ball_error(rng)[1] for _ in range(n)])),
    "tilt": lambda rng, n: quaternion_from_rotvec(np.stack([draw_tilt_error(rng)[1] for _ in range(n)])),
    "place": _draw_place,
    "place-paper": _draw_place_paper,
}
