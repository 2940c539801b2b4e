"""Poses of the camera that a user states, compared with the table that the image shows."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose

FARTHEST = 5.0  # [m] of a camera from the base of a robot
LEVEL_DEG, TILTED_DEG = 5.0, 10.0  # of a table that lies level, and of one that surely does not
MOST_OFF = 25e-3  # [m] of a table from the plane z = 0
HALF_ROTATION_ABOUT_X = Pose(np.array([0.0, 1.0, 0.0, 0.0]), np.zeros(3))
READINGS: dict[str, Callable[[Pose], Pose]] = {
    "as it is": lambda pose: pose,
    "as the inverse: invert it": Pose.inverse,
    "with the axes of OpenGL (y up, z backward): rotate it by 180° about x": lambda pose: pose @ HALF_ROTATION_ABOUT_X,
    "with the scalar last: give w first": lambda pose: Pose(np.roll(pose.wxyz, 1), pose.xyz),
}
"""What the numbers of a pose may mean, by the words that name it."""


def tilt_deg(pose: Pose, up: np.ndarray) -> float:
    """The angle between z of a frame and the upward normal (3,) of the table, which is in the camera's frame."""
    return float(np.degrees(np.arccos(np.clip(pose.rotate(up)[2], -1, 1))))


def check_world_pose(pose: Pose, up: np.ndarray, distance: float, source: str) -> None:
    """Raise InputError if the table is not near the plane z = 0 of the user's frame; name the reading that fits.

    Args:
        pose: world_from_camera, as stated.
        up: (3,) unit normal of the table in the camera's frame, towards the camera.
        distance: of the camera from the table [m].
        source: the file, for the message.
    """

    def fits(reading: Pose) -> bool:
        return tilt_deg(reading, up) <= LEVEL_DEG and abs(_table_height(reading, up, distance)) <= MOST_OFF

    if not fits(pose):
        advice = _fitting(pose, fits) or "give world_from_camera: x right, y down, z forward; z of the world up"
        raise InputError(
            f"{source}: with this pose the table is tilted by {tilt_deg(pose, up):.1f}° at z = "
            f"{1e3 * _table_height(pose, up, distance):.0f} mm, expected level at 0: {advice}"
        )


def check_base_pose(pose: Pose, up: np.ndarray, distance: float, source: str) -> list[str]:
    """The lines that say how the table lies in the base of a robot; the arguments are those of `check_world_pose`.

    The last line is a warning if the table is not level there: a base may stand on a wall, but seldom does.
    Raises InputError if the camera is more than FARTHEST from the base, or another reading makes the table level.
    """
    tilt, away = tilt_deg(pose, up), float(np.sqrt(pose.xyz @ pose.xyz))
    line = (
        f"{source}: the table lies at z = {1e3 * _table_height(pose, up, distance):.0f} mm of the base, tilted by "
        f"{tilt:.1f}°; the camera is {away:.2f} m from the base"
    )
    if tilt <= TILTED_DEG and away <= FARTHEST:
        return [line]
    advice = _fitting(
        pose, lambda reading: tilt_deg(reading, up) <= LEVEL_DEG and float(reading.xyz @ reading.xyz) < FARTHEST**2
    )
    if advice or away > FARTHEST:
        raise InputError(f"{line}, expected up to {FARTHEST:g} m: {advice or 'give the position in metres'}")
    return [line, f"warning: {source}: up of the table is not up of the base; is the pose base_from_camera?"]


def _table_height(pose: Pose, up: np.ndarray, distance: float) -> float:
    """z [m] in a frame of the table's point below the camera, whose distance [m] is along the normal (3,)."""
    return float(pose.apply(-distance * up)[2])


def _fitting(pose: Pose, fits: Callable[[Pose], bool]) -> str:
    """The reading of a pose that fits, in words; empty if none does."""
    for (unit, scale), (words, read) in product((("", 1.0), (", its position in mm", 1e-3)), READINGS.items()):
        if fits(read(Pose(pose.wxyz, scale * pose.xyz))):
            return f"it fits {words}{unit}"
    return ""
