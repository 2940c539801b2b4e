"""The world of an own scene: z = 0 on the table, kits at y > 0, parts at y < 0, or the frame of the user's own pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kit1000.capture.seen_bodies import SeenBody
from kit1000.capture.table_search import Table
from kit1000.dataset.pose_files import stated_pose
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.pose import Pose, quaternion_between

DIRECTIONS = 360  # of the line that parts kit and parts
KITS_PLACE = 0.2  # [m] from the origin to the middle of the kit, where there are no parts
SAME_GAP = 2e-3  # [m] gaps up to this much narrower than the widest are as good
MOST_OFF, MOST_TILT_DEG = 25e-3, 5.0  # [m] from the plane z = 0 and from level, of the table in the user's frame
TRIMMED = 0.01  # share of a body's points beyond either side of the line


@dataclass(frozen=True, eq=False)
class OwnWorld:
    """The pose of the camera, and how far apart kit and parts are."""

    world_from_camera: Pose
    gap: float | None
    """[m] between kit and parts along y; below 0: no line parts them; None: there are no parts, or a pose was given."""
    moved: tuple[float, float] = (0.0, 0.0)
    """[m] and degrees by which a given pose was corrected, so that the table is at z = 0."""


def world_of_bodies(table: Table, kit: SeenBody, parts: Sequence[SeenBody]) -> OwnWorld:
    """The world whose line y = 0 best parts the kit from the parts, its origin in the gap."""
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    kit_feet = table.ground(kit.mask)
    if not parts:
        towards = np.array([0.0, 1.0])
        return OwnWorld(_pose(table, towards, kit.centre - KITS_PLACE * towards), None)
    near = np.quantile(kit_feet @ directions.T, TRIMMED, axis=0)
    far = np.max([np.quantile(table.ground(part.mask) @ directions.T, 1 - TRIMMED, axis=0) for part in parts], axis=0)
    gaps = near - far
    widest = np.flatnonzero(gaps >= gaps.max() - SAME_GAP)
    best = widest[len(widest) // 2] if np.ptp(widest) < DIRECTIONS / 2 else int(gaps.argmax())
    towards = directions[best]
    middle = (kit.centre + np.mean([part.centre for part in parts], axis=0)) / 2
    across = np.array([towards[1], -towards[0]])
    origin = (near[best] + far[best]) / 2 * towards + (middle @ across) * across
    return OwnWorld(_pose(table, towards, origin), float(gaps[best]))


def world_of_pose(table: Table, given: Pose, source: str) -> OwnWorld:
    """The user's own frame: a given pose, turned and lifted so little that the seen table is its plane z = 0.

    Raises InputError where the table is not near that plane.
    """
    up, z = given.rotate(table.up), given.xyz[2]
    tilt = float(np.degrees(np.arccos(np.clip(up[2], -1, 1))))
    if tilt > MOST_TILT_DEG:
        raise InputError(
            f"{source}: with this pose the table is tilted by {tilt:.1f}°, expected up to {MOST_TILT_DEG:g}: "
            "give world_from_camera (x right, y down, z forward), z of the world up"
        )
    turned = Pose(quaternion_between(up, (0.0, 0.0, 1.0)), np.zeros(3))
    lifted = table.distance
    if abs(lifted - z) > MOST_OFF:
        raise InputError(
            f"{source}: with this pose the table is at z = {1e3 * (z - lifted):.0f} mm, expected 0: "
            f"subtract {z - lifted:.4f} from its z"
        )
    rotation = Pose(turned.wxyz, np.zeros(3)) @ Pose(given.wxyz, np.zeros(3))
    pose = Pose(rotation.wxyz, np.array([given.xyz[0], given.xyz[1], lifted]))
    return OwnWorld(pose, None, (float(lifted - z), tilt))


def read_pose(path: Path) -> Pose:
    """The pose world_from_camera of a JSON file. Raises InputError for anything else."""
    value = read_json(path)
    return stated_pose(value.get("world_from_camera", value) if isinstance(value, dict) else value, str(path))


def _pose(table: Table, towards: np.ndarray, origin: np.ndarray) -> Pose:
    """world_from_camera of a world with y along `towards` (2,) and a place of the table (2,) [m] as its origin."""
    x, y, z = table.axes
    along = towards[0] * x + towards[1] * y
    rotation = np.stack([np.cross(along, z), along, z])
    at = origin[0] * x + origin[1] * y - table.distance * z  # the origin in the camera frame
    return Pose.from_rotation_matrix(rotation, -rotation @ at)
