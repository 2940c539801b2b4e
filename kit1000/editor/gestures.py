"""What the hand does to a part, as functions of motions: slide on a surface, turn, tilt, lift, lay level.

A motion is a `goal_from_now`; the part turns about the image of its pivot.
"""

from __future__ import annotations

import numpy as np

from kit1000.editor.seen_plates import Plate
from kit1000.numerics.linear_algebra import matmul
from kit1000.pose import Pose, quaternion_between


def slid(motion: Pose, cloud: np.ndarray, pivot: np.ndarray, old: Plate, new: Plate, point: np.ndarray) -> Pose:
    """The part stood on another place: it keeps its rotation to the surface, and touches that.

    Args:
        motion: goal_from_now.
        cloud: (n, 3) [m] points of the part where it lies, which bound it.
        pivot: (3,) [m] of the part where it lies.
        old: the surface on which it stands.
        new: the surface on which it shall stand.
        point: (3,) [m] on that surface, below the pivot.
    """
    rotation = Pose(quaternion_between(old.normal, new.normal), np.zeros(3)) @ Pose(motion.wxyz, np.zeros(3))
    below = float(matmul(rotation.rotate(cloud - pivot), new.normal).min())
    return _about(rotation, pivot, point - below * new.normal)


def rotated(motion: Pose, pivot: np.ndarray, axis: np.ndarray, angle: float) -> Pose:
    """Turned about an axis (3,) of the world through the image of the pivot. angle: [rad]."""
    rotation = Pose.from_rotvec(axis * angle) @ Pose(motion.wxyz, np.zeros(3))
    return _about(rotation, pivot, motion.apply(pivot))


def shifted(motion: Pose, offset: np.ndarray) -> Pose:
    """Moved by an offset (3,) [m] of the world."""
    return Pose(motion.wxyz, motion.xyz + offset)


def levelled(motion: Pose, cloud: np.ndarray, pivot: np.ndarray, plate: Plate) -> Pose:
    """Stood on a plate with the nearest of the six sides that it has where it lies, at the place where it is."""
    here = motion.inverse().rotate(plate.normal)
    side = np.zeros(3)
    side[np.abs(here).argmax()] = np.sign(here[np.abs(here).argmax()])
    up = motion.rotate(side)
    level = Pose(quaternion_between(up, plate.normal), np.zeros(3)) @ Pose(motion.wxyz, np.zeros(3))
    return stood(_about(level, pivot, motion.apply(pivot)), cloud, plate)


def stood(motion: Pose, cloud: np.ndarray, plate: Plate) -> Pose:
    """Lowered or raised along the plate's normal until it touches the plate."""
    lowest = float(plate.height(motion.apply(cloud)).min())
    return shifted(motion, -lowest * plate.normal)


def distance(one: Pose, other: Pose, pivot: np.ndarray) -> tuple[float, float]:
    """How far apart two motions take the pivot [m], and the angle between them [rad]."""
    apart = one.apply(pivot) - other.apply(pivot)
    return float(np.sqrt(matmul(apart, apart))), float((one @ other.inverse()).angle())


def same_motion(one: Pose, other: Pose) -> bool:
    """Whether two motions are equal, bit for bit."""
    return one.wxyz.tobytes() + one.xyz.tobytes() == other.wxyz.tobytes() + other.xyz.tobytes()


def _about(rotation: Pose, pivot: np.ndarray, image: np.ndarray) -> Pose:
    """The motion with a rotation that takes the pivot to its image (3,) [m]."""
    return Pose(rotation.wxyz, image - rotation.rotate(pivot))
