"""The robot: a UR5e with a suction cup, its forward and inverse kinematics, its joint limits and its shape.

Lengths and angles are those that Universal Robots publishes ("DH parameters for calculations of kinematics and
dynamics"), in the classic convention: link i is Rz(q) Tz(d) Tx(a) Rx(alpha). The inverse is closed: two signs each for
shoulder, wrist and elbow (Hawkins 2013; Kebria et al. 2016). Joints are (..., 6) [rad], base to flange.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.numerics.trigonometry import cosine, sine
from kit1000.pose import Pose

D = np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996])  # [m]
A = np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0])  # [m]
ALPHA = np.array([1, 0, 0, 1, -1, 0])  # [quarter turns]
BRANCHES = np.array([(shoulder, wrist, elbow) for shoulder in (1, -1) for wrist in (1, -1) for elbow in (1, -1)])
JOINT_LIMITS = np.array([2, 2, 1, 2, 2, 2]) * np.pi  # [rad] either way; the elbow by half a turn, as its cables allow
JOINT_SPEED = np.pi  # [rad/s] the fastest of every joint
HOME = np.radians([180.0, -110.0, 110.0, -90.0, -90.0, 0.0])  # elbow up, the cup pointing down between the two halves
TOOL_LENGTH = 0.12  # [m] from the flange to the lip of the cup
CUPS = (5e-3, 3e-3, 2e-3)  # [m] radii of the cups; the robot takes the largest that seals
SINGULAR = 1e-9  # sine of the wrist's bend under which joint 6 is set to zero
ROUNDING = 1e-12  # by which rounding may take a cosine beyond 1


@dataclass(frozen=True)
class Capsule:
    """A piece of the arm: all points within a radius of a segment."""

    link: int  # frame that carries it: 0 the base, 6 the flange
    start: tuple[float, float, float]  # [m] in that frame
    end: tuple[float, float, float]
    radius: float  # [m]


# Radii and offsets along the joints' axes as in the public dimension drawings, rounded up.
ARM = (
    Capsule(0, (0, 0, 0.0), (0, 0, 0.13), 0.075),
    Capsule(1, (0, 0, 0.0), (0, 0, 0.138), 0.060),
    Capsule(2, (0.425, 0, 0.138), (0, 0, 0.138), 0.055),
    Capsule(2, (0, 0, 0.138), (0, 0, 0.007), 0.050),
    Capsule(3, (0.3922, 0, 0.007), (0, 0, 0.007), 0.042),
    Capsule(3, (0, 0, 0.007), (0, 0, 0.1333), 0.042),
    Capsule(4, (0, 0, 0.0), (0, 0, 0.0997), 0.042),
    Capsule(5, (0, 0, 0.0), (0, 0, 0.0796), 0.038),
    Capsule(6, (0, 0, 0.0), (0, 0, 0.07), 0.015),
)
NOZZLE = Capsule(6, (0, 0, 0.07), (0, 0, TOOL_LENGTH), 0.0)
"""The tube with the cup at its end, as wide as the cup."""


def link_frames(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames of base and links: rotations (..., 7, 3, 3) and origins (..., 7, 3) [m], base_from_link."""
    joints = np.asarray(joints, float)
    c, s = cosine(joints), sine(joints)
    rotations, origins = np.zeros((*joints.shape[:-1], 7, 3, 3)), np.zeros((*joints.shape[:-1], 7, 3))
    rotations[..., 0, :, :] = np.eye(3)
    for i in range(6):
        ca, sa = 1.0 - abs(ALPHA[i]), float(ALPHA[i])
        local = np.zeros((*joints.shape[:-1], 3, 3))
        local[..., 0, 0], local[..., 1, 0] = c[..., i], s[..., i]
        local[..., 0, 1], local[..., 1, 1], local[..., 2, 1] = -s[..., i] * ca, c[..., i] * ca, sa
        local[..., 0, 2], local[..., 1, 2], local[..., 2, 2] = s[..., i] * sa, -c[..., i] * sa, ca
        step = np.stack([A[i] * c[..., i], A[i] * s[..., i], np.full(joints.shape[:-1], D[i])], axis=-1)
        before = rotations[..., i, :, :]
        rotations[..., i + 1, :, :] = np.einsum("...ij,...jk->...ik", before, local)
        origins[..., i + 1, :] = origins[..., i, :] + np.einsum("...ij,...j->...i", before, step)
    return rotations, origins


def tool_pose(joints: np.ndarray) -> Pose:
    """base_from_tool (...,): the tool's frame is at the middle of the cup's lip, +z out of the cup."""
    rotations, origins = link_frames(joints)
    rotation = rotations[..., 6, :, :]
    return Pose.from_rotation_matrix(rotation, origins[..., 6, :] + TOOL_LENGTH * rotation[..., :, 2])


def inverse(base_from_tool: Pose) -> np.ndarray:
    """All joints (..., 8, 6) [rad], -pi to pi, that put the tool at poses (...,); NaN for a branch that has none.

    The branches are in the order of BRANCHES; neighbouring poses keep their branches. With a straight wrist, where only
    the sum of two joints counts, joint 6 is zero.
    """
    rotation = base_from_tool.rotation_matrix()[..., None, :, :]  # axes of branches, then of matrices
    flange = base_from_tool.xyz - TOOL_LENGTH * base_from_tool.rotation_matrix()[..., :, 2]
    shoulder, wrist, elbow = BRANCHES.T
    with np.errstate(invalid="ignore", divide="ignore"):
        first = _shoulder(flange, base_from_tool.rotation_matrix(), shoulder)
        c1, s1 = cosine(_finite(first)), sine(_finite(first))
        across = rotation[..., 0, :] * s1[..., None] - rotation[..., 1, :] * c1[..., None]
        bend = np.hypot(across[..., 0], across[..., 1])
        fifth = np.arctan2(wrist * bend, across[..., 2])
        sixth = np.where(bend < SINGULAR, 0.0, np.arctan2(-wrist * across[..., 1], wrist * across[..., 0]))
        joints = np.stack([first, *_planar(flange[..., None, :], rotation, (c1, s1), fifth, sixth, elbow)], axis=-1)
    joints[~np.isfinite(joints).all(-1)] = np.nan
    return _wrapped(joints)


def _shoulder(flange: np.ndarray, rotation: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Joint 1 (..., 8): the wrist's centre lies beside the arm's plane by D[3]."""
    wrist = flange - D[5] * rotation[..., :, 2]
    x, y = wrist[..., 0, None], wrist[..., 1, None]
    square = x * x + y * y - D[3] ** 2
    turn = np.arctan2(np.sqrt(np.where(square < 0, np.nan, square)), D[3])
    return np.arctan2(y, x) + sign * turn + np.pi / 2


def _planar(
    flange: np.ndarray,
    rotation: np.ndarray,
    first: tuple[np.ndarray, np.ndarray],
    fifth: np.ndarray,
    sixth: np.ndarray,
    elbow: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """Joints 2 to 6 (..., 8) each, given the cosine and sine of the first: the elbow's triangle in the arm's plane."""
    c1, s1 = first
    c5, s5, c6, s6 = cosine(fifth), sine(fifth), cosine(sixth), sine(sixth)
    # axes of frame 4 in the base: undo joints 6 and 5
    x5 = rotation[..., :, 0] * c6[..., None] - rotation[..., :, 1] * s6[..., None]
    y5, z5 = rotation[..., :, 0] * s6[..., None] + rotation[..., :, 1] * c6[..., None], rotation[..., :, 2]
    z4 = -y5
    x4 = x5 * c5[..., None] + z5 * -s5[..., None]
    origin = flange - D[5] * z5 - D[4] * z4  # of frame 4
    along, up = origin[..., 0] * c1 + origin[..., 1] * s1, origin[..., 2] - D[0]
    bend = (along**2 + up**2 - A[1] ** 2 - A[2] ** 2) / (2 * A[1] * A[2])
    bend = np.where(np.abs(bend) > 1 + ROUNDING, np.nan, np.clip(bend, -1, 1))
    third = elbow * np.arctan2(np.sqrt(1 - bend * bend), bend)
    second = np.arctan2(up, along) - np.arctan2(A[2] * sine(_finite(third)), A[1] + A[2] * cosine(_finite(third)))
    lift = np.arctan2(x4[..., 2], x4[..., 0] * c1 + x4[..., 1] * s1)  # joints 2 + 3 + 4
    return second, third, lift - second - third, fifth, sixth


def _finite(angles: np.ndarray) -> np.ndarray:
    """Angles with zero for NaN, whose results are discarded later."""
    return np.where(np.isfinite(angles), angles, 0.0)


def _wrapped(angles: np.ndarray) -> np.ndarray:
    """Angles in -pi to pi."""
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))


def within_limits(joints: np.ndarray) -> np.ndarray:
    """Whether all joints (..., 6) are within their limits; False for NaN."""
    return np.asarray((np.abs(joints) <= JOINT_LIMITS).all(-1))


def shape(cup: float) -> tuple[Capsule, ...]:
    """The capsules of the arm with a cup of a radius [m], the nozzle last."""
    return *ARM, Capsule(NOZZLE.link, NOZZLE.start, (0.0, 0.0, NOZZLE.end[2] - cup), cup)


def capsule_ends(joints: np.ndarray, cup: float) -> np.ndarray:
    """(..., capsules, 2, 3) [m] the ends of all capsules of `shape` in the base frame."""
    rotations, origins = link_frames(joints)
    capsules = shape(cup)
    links = [capsule.link for capsule in capsules]
    ends = np.array([(capsule.start, capsule.end) for capsule in capsules])
    turned = np.einsum("...cij,cej->...cei", rotations[..., links, :, :], ends)
    return turned + origins[..., links, None, :]
