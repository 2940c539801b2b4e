"""The candidate rotations of the rotation network: around a guess, or all that a part without a guess may need.

Candidates are along the working axes, on the left: correct rotation = candidate . guess. The angle from the correct
rotation to the nearest candidate remains as an error, whatever the network predicts.
"""

from __future__ import annotations

from functools import cache
from typing import Literal

import numpy as np

from kit1000.errors import InputError, did_you_mean
from kit1000.pose import Pose, quaternion_from_rotvec, quaternion_multiply
from kit1000.queries.guesses import MAX_ANGLE

CandidateSet = Literal["ball", "tilt"]

COUNT = 391  # of the paper: 1 + 5 rings of 78
RINGS, ON_RING = 5, 78  # the release: int(0.48 / 0.08) - 1, and the whole steps of 0.08 rad in a circle
TILT = 0.48  # [rad] of the outermost ring, 27.5 degrees
COARSE = 49  # of them, in a search from coarse to fine: some 8 degrees apart
NEAR, MOST_NEAR = float(np.radians(12)), 41  # [rad] about a rotation, and how many candidates there are scored
BALL_REACH = 0.94  # of 27.5 degrees: the outermost candidates; this has the least mean error floor for uniform angles


@cache
def candidates(name: CandidateSet) -> Pose:
    """A set of candidate rotations about the origin, (n,).

    - ball: 391 rotation vectors on a body-centred cubic lattice, the identity and inverses included, up to 26 degrees
      about any axis, for errors of up to 27.5.
    - tilt: the paper's 391: the identity and 5 rings of 78 rotations about horizontal axes; none changes the yaw.

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
    angle, azimuth = np.meshgrid(
        np.linspace(0, TILT, RINGS + 1)[1:], np.arange(ON_RING) * (2 * np.pi / ON_RING), indexing="ij"
    )
    vectors = np.stack([-np.sin(azimuth) * angle, np.cos(azimuth) * angle, 0 * angle], -1).reshape(-1, 3)
    return quaternion_from_rotvec(np.concatenate([np.zeros((1, 3)), vectors]))


_MAKERS = {"ball": _ball, "tilt": _tilt}
