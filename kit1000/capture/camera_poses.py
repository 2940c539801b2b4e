"""Poses of the camera that a user states, compared with the table that the image shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose

FARTHEST = 5.0  # [m] of a camera from the origin of a robot's base or of a bench
LEVEL_DEG, TILTED_DEG = 5.0, 10.0  # of a table that lies level, and of one that surely does not
MOST_OFF = 25e-3  # [m] of a table from the plane z = 0
HALF_ROTATION_ABOUT_X = Pose(np.array([0.0, 1.0, 0.0, 0.0]), np.zeros(3))


def tilt_deg(pose: Pose, up: np.ndarray) -> float:
    """The angle between z of a frame and the upward normal (3,) of the table, which is in the camera's frame."""
    return float(np.degrees(np.arccos(np.clip(pose.rotate(up)[2], -1, 1))))


def table_height(pose: Pose, up: np.ndarray, distance: float) -> float:
    """z [m] in a frame of the table's point below the camera, whose distance [m] is along the normal (3,)."""
    return float(pose.apply(-distance * up)[2])


def check_world_pose(pose: Pose, up: np.ndarray, distance: float, source: str) -> None:
    """Raise InputError if the table is not near the plane z = 0 of the user's frame; name the reading that fits.

    Args:
        pose: world_from_camera, as stated.
        up: (3,) unit normal of the table in the camera's frame, towards the camera.
        distance: of the camera from the table [m].
        source: the file, for the message.
    """

    def fits(reading: Pose) -> bool:
        return tilt_deg(reading, up) <= LEVEL_DEG and abs(table_height(reading, up, distance)) <= MOST_OFF

    _check_distance(pose, up, fits, source)
    if fits(pose):
        return
    tilt, height = tilt_deg(pose, up), table_height(pose, up, distance)
    known = next((name for name, reading in _other_readings(pose) if fits(reading)), None)
    if known is not None:
        raise InputError(f"{source}: with this pose the table is tilted by {tilt:.0f}° at z = {height:.2f} m; {known}")
    if tilt > LEVEL_DEG:
        raise InputError(
            f"{source}: with this pose the table is tilted by {tilt:.1f}°, expected up to {LEVEL_DEG:g}: "
            "give world_from_camera (x right, y down, z forward), z of the world up"
        )
    raise InputError(
        f"{source}: with this pose the table is at z = {1e3 * height:.0f} mm, expected 0: subtract {height:.4f} from "
        "its z"
    )


def check_base_pose(pose: Pose, up: np.ndarray, distance: float, source: str) -> list[str]:
    """The lines that say how the table lies in the base of a robot.

    The last line is a warning if the table is not level there: a base may stand on a wall, but seldom does.

    Args:
        pose: base_from_camera, as stated.
        up: (3,) unit normal of the table in the camera's frame, towards the camera.
        distance: of the camera from the table [m].
        source: the file or entry, for messages.

    Raises:
        InputError: the camera is more than FARTHEST from the base, or another reading makes the table level.
    """

    def fits(reading: Pose) -> bool:
        return tilt_deg(reading, up) <= LEVEL_DEG

    _check_distance(pose, up, fits, source)
    tilt = tilt_deg(pose, up)
    away = float(np.sqrt(pose.xyz @ pose.xyz))
    line = f"{source}: the table lies at z = {1e3 * table_height(pose, up, distance):.0f} mm of the base, tilted by "
    line += f"{tilt:.1f}°; the camera is {away:.2f} m from the base"
    if tilt <= TILTED_DEG:
        return [line]
    known = next((name for name, reading in _other_readings(pose) if fits(reading)), None)
    if known is not None:
        raise InputError(f"{source}: with this pose the table is tilted by {tilt:.0f}° in the base; {known}")
    return [line, f"warning: {source}: up of the table is not up of the base; is the pose base_from_camera?"]


def _check_distance(pose: Pose, up: np.ndarray, fits: Callable[[Pose], bool], source: str) -> None:
    """Raise InputError for a camera beyond FARTHEST; say whether the position in mm would fit."""
    away = float(np.sqrt(pose.xyz @ pose.xyz))
    if away <= FARTHEST:
        return
    metres = Pose(pose.wxyz, 1e-3 * pose.xyz)
    readings = [("", metres), *((f"; {name}", reading) for name, reading in _other_readings(metres))]
    also = next((name for name, reading in readings if fits(reading)), None)
    verdict = f"it would be {1e-3 * away:.2f} m away, and "
    verdict += f"the table fits{also}" if also is not None else f"the table is tilted by {tilt_deg(metres, up):.0f}°"
    raise InputError(f"{source}: the camera is {away:.0f} m away: is the position in mm? Divided by 1000 {verdict}")


def _other_readings(pose: Pose) -> Iterator[tuple[str, Pose]]:
    """What the numbers of a pose may mean, with the sentence that names it."""
    w, x, y, z = pose.wxyz
    scalar_last = Pose(np.array([z, w, x, y]), pose.xyz)
    yield "it fits as the inverse, camera_from_frame: invert it", pose.inverse()
    yield (
        "it fits with the axes of OpenGL (y up, z backward): rotate it by 180° about x of the camera",
        (pose @ HALF_ROTATION_ABOUT_X),
    )
    yield "it fits if its quaternion has the scalar last: give w first", scalar_last
    yield (
        "it fits as the inverse with the axes of OpenGL: invert it, then rotate by 180° about x of the camera",
        (pose.inverse() @ HALF_ROTATION_ABOUT_X),
    )
