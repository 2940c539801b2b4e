"""Where the pixels of a view look at the table's top, the plane z = 0 of the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kit1000.camera import Camera
from kit1000.pose import Pose
from kit1000.sim.layout import TABLE_SIZE
from kit1000.values import View

HALF_SIZES = np.array(TABLE_SIZE[:2]) / 2
"""(2,) [m] from the origin to the table's edges, along x and y."""
NEAR = 25e-3  # [m] from the plane, of pixels of a table of unknown size


def rays(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """(n, 3) directions of pixels (n, 2), of depth 1."""
    return camera.unproject_pixels(uv, np.ones(len(uv)))


def ground(pose: Pose, directions: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: where rays (n, 3) of the camera meet the plane z = 0; NaN where they do not."""
    directions = pose.rotate(directions)
    down = np.where(directions[:, 2] < 0, -directions[:, 2], np.nan)
    return pose.xyz + directions * (pose.xyz[2] / down)[:, None]


def flattened(view: View, labels: np.ndarray, simulated: bool = True) -> View:
    """The view with the depths of the table's plane at all pixels of the table, with a return or without.

    simulated: whether the table is that of generated scenes; of another one, only pixels near its plane are its own.
    """
    depth, on = _table_top(view) if simulated else _near_plane(view)
    return replace(view, depth=np.where((labels == 0) & on, depth.astype(view.depth.dtype), view.depth))


def _near_plane(view: View) -> tuple[np.ndarray, np.ndarray]:
    """As of `_table_top`, for a table of unknown size: pixels without a return, or with one near the plane."""
    depth = _plane_depth(view)[0]
    along = np.abs(view.depth - depth) * view.world_from_camera.xyz[2] / np.maximum(depth, 1e-3)  # [m] of height
    return depth, (depth > 0) & ((view.depth == 0) | (along < NEAR))


def _table_top(view: View) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) [m] depths of the plane z = 0, 0 where it is not in front; (H, W) bool: pixels that look at the table."""
    depth, (x, y, z) = _plane_depth(view)
    axes = zip(view.world_from_camera.xyz, (x, y), HALF_SIZES, strict=False)
    within = [np.abs(start + direction * depth) <= half for start, direction, half in axes]
    return depth, (z < 0) & within[0] & within[1]


def _plane_depth(view: View) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """(H, W) [m] depths of the plane z = 0, 0 where it is not in front; three (H, W): rays of depth 1 in the world."""
    camera, pose = view.camera, view.world_from_camera
    across = (np.arange(camera.width) - camera.cx) / camera.fx
    along = (np.arange(camera.height) - camera.cy) / camera.fy
    x, y, z = (axis[0] * across + (axis[1] * along + axis[2])[:, None] for axis in pose.rotation_matrix())
    return np.divide(pose.xyz[2], -z, out=np.zeros_like(z), where=z < 0), (x, y, z)
