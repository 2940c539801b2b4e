"""The world of an own scene: z = 0 on the table, kits at y > 0, parts at y < 0, or the frame of the user's own pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.capture.camera_poses import check_world_pose, tilt_deg
from kit1000.capture.seen_bodies import SeenBody
from kit1000.capture.table_search import Table
from kit1000.pose import Pose, quaternion_between

DIRECTIONS = 360  # of the line between kit and parts
KITS_PLACE = 0.2  # [m] from the origin to the middle of the kit, where there are no parts
SAME_GAP = 2e-3  # [m] gaps up to this much narrower than the widest are as good
ROUNDING = 1e-9  # of sums of areas
TRIMMED = 0.01  # share of a body's points beyond either side of the line


@dataclass(frozen=True, eq=False)
class OwnWorld:
    """The pose of the camera, and how far apart kit and parts are."""

    world_from_camera: Pose
    gap: float | None
    """[m] between kit and parts along y; below 0: no line separates them; None: no parts, or a pose was given."""
    moved: tuple[float, float] = (0.0, 0.0)
    """[m] and degrees by which a given pose was corrected, so that the table is at z = 0."""
    beside: tuple[SeenBody, ...] = ()
    """The parts that the line y = 0 separates from the kit."""


def world_of_bodies(table: Table, kit: SeenBody, parts: Sequence[SeenBody]) -> OwnWorld:
    """The world whose line y = 0 best separates the kit from the parts, with its origin in the gap.

    Without a line that separates all parts, from those of as large an area as possible.
    """
    angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    directions = np.stack([np.cos(angles), np.sin(angles)], -1)
    if not parts:
        towards = np.array([0.0, 1.0])
        return OwnWorld(_pose(table, towards, kit.centre - KITS_PLACE * towards), None)
    near = _reached(table, kit, directions, TRIMMED)
    far = np.array([_reached(table, part, directions, 1 - TRIMMED) for part in parts])
    beside = far < near
    area = np.array([part.area for part in parts]) @ beside
    gaps = near - np.where(beside | (area == 0), far, -np.inf).max(0)
    gaps[area < (1 - ROUNDING) * area.max()] = -np.inf
    widest = np.flatnonzero(gaps >= gaps.max() - SAME_GAP)
    best = widest[len(widest) // 2] if np.ptp(widest) < DIRECTIONS / 2 else int(gaps.argmax())
    towards = directions[best]
    middle = (kit.centre + np.mean([part.centre for part in parts], axis=0)) / 2
    across = np.array([towards[1], -towards[0]])
    origin = (near[best] - gaps[best] / 2) * towards + (middle @ across) * across
    separated = tuple(part for part, there in zip(parts, beside[:, best], strict=True) if there)
    return OwnWorld(_pose(table, towards, origin), float((near - far)[:, best].min()), beside=separated)


def _reached(table: Table, body: SeenBody, directions: np.ndarray, share: float) -> np.ndarray:
    """(n,) [m] up to where a share of a body's points lies along directions (n, 2)."""
    along = directions @ table.ground(body.mask).T  # one row a direction: quantiles of columns take 3 times as long
    return np.quantile(along, share, axis=1, overwrite_input=True)


def world_of_pose(table: Table, given: Pose, source: str) -> OwnWorld:
    """The user's own frame: a given pose, rotated and lifted so little that the seen table is its plane z = 0.

    Raises InputError if the table is not near that plane.
    """
    check_world_pose(given, table.up, table.distance, source)
    leveled = Pose(quaternion_between(given.rotate(table.up), (0.0, 0.0, 1.0)), np.zeros(3))
    rotation = leveled @ Pose(given.wxyz, np.zeros(3))
    pose = Pose(rotation.wxyz, np.array([given.xyz[0], given.xyz[1], table.distance]))
    return OwnWorld(pose, None, (float(table.distance - given.xyz[2]), tilt_deg(given, table.up)))


def _pose(table: Table, towards: np.ndarray, origin: np.ndarray) -> Pose:
    """world_from_camera of a world with y along `towards` (2,) and a place of the table (2,) [m] as its origin."""
    x, y, z = table.axes
    along = towards[0] * x + towards[1] * y
    rotation = np.stack([np.cross(along, z), along, z])
    at = origin[0] * x + origin[1] * y - table.distance * z  # the origin in the camera frame
    return Pose.from_rotation_matrix(rotation, -rotation @ at)
