"""The cells that TransporterNet scores: positions on a lattice and yaws, and how motions become cells and back.

The map of the kits has an even number of pixels n, the kernel of the part k. Scores belong to the corners between
pixels: lattice point a of m is the position (a - (m - 1) / 2) * pixel along an axis of the map, whose origin is its
middle. A part whose pivot is there covers whole pixels, so nothing is shifted by half a pixel.

A rotation is split into a yaw and a tilt: `rotation = tilt . yaw`. The yaw is what the part is rotated by on the map;
the tilt is the rotation vector (x, y, 0) that remains. Unlike Euler angles the split has no preferred axis, so a scene
that is rotated rotates the tilt and nothing else, and it fails for a part upside down alone.
"""

from __future__ import annotations

import numpy as np

from baselines.transporter.config import YAW_STEP, YAWS
from kit1000.pose import Pose


def lattice_of(xy: np.ndarray, points: int, pixel: float) -> np.ndarray:
    """(..., 2) coordinates on a lattice of `points` across, fractions included, of positions (..., 2) [m]."""
    return xy / pixel + (points - 1) / 2


def position_of(lattice: np.ndarray, points: int, pixel: float) -> np.ndarray:
    """(..., 2) [m]: the inverse of `lattice_of`."""
    return (lattice - (points - 1) / 2) * pixel


def tilt_and_yaw(rotation: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Tilts (..., 2) [rad], the x and y of their rotation vectors, and yaws (...,) [rad] from -pi to pi."""
    w, z = rotation.wxyz[..., 0], rotation.wxyz[..., 3]
    yaw = 2 * np.arctan2(z, w)
    yaw = np.where(yaw > np.pi, yaw - 2 * np.pi, np.where(yaw < -np.pi, yaw + 2 * np.pi, yaw))
    about_z = np.stack([np.zeros_like(yaw), np.zeros_like(yaw), yaw], -1)
    tilt = (Pose(rotation.wxyz, np.zeros_like(rotation.xyz)) @ Pose.from_rotvec(about_z).inverse()).rotvec()
    return tilt[..., :2], yaw


def rotation_from(tilt: np.ndarray, yaw: float) -> Pose:
    """The rotation of a tilt (2,) [rad] after a yaw [rad]."""
    return Pose.from_rotvec((tilt[0], tilt[1], 0.0)) @ Pose.from_rotvec((0.0, 0.0, yaw))


def spread_cells(lattice: np.ndarray, yaw: float, spread: bool) -> tuple[np.ndarray, np.ndarray]:
    """The cells that stand for a pose, and their shares.

    Args:
        lattice: (2,) coordinates on the lattice.
        yaw: [rad]
        spread: whether to share the pose among the eight cells around it; otherwise the nearest takes it all.

    Returns:
        (8 or 1, 3) int64 cells: yaw from 0 to YAWS - 1, then the lattice point; (8 or 1,) shares that sum to 1.
    """
    exact = np.array([yaw / YAW_STEP, *lattice])
    if not spread:
        cells, shares = np.rint(exact)[None], np.ones(1)
    else:
        low = np.floor(exact)
        corners = np.indices((2, 2, 2)).reshape(3, 8).T
        cells = low + corners
        shares = np.where(corners == 1, exact - low, 1 - (exact - low)).prod(1)
    cells = cells.astype(np.int64)
    cells[:, 0] %= YAWS
    return cells, shares


def peak_of(probability: np.ndarray, yaws: np.ndarray, mean: bool) -> tuple[tuple[int, int, int], float, np.ndarray]:
    """The best cell and the pose that it stands for.

    Args:
        probability: (y, m, m) of all cells.
        yaws: (y,) the yaw of each layer, from 0 to YAWS - 1.
        mean: whether the pose is the mean of the 27 cells around the best one, weighted by probability.

    Returns:
        The best cell, as layer and lattice point; the yaw [rad]; the coordinates on the lattice (2,).
    """
    layer, *point = (int(i) for i in np.unravel_index(int(probability.argmax()), probability.shape))
    if not mean:
        return (layer, point[0], point[1]), float(yaws[layer] * YAW_STEP), np.array(point, float)
    steps = (yaws - yaws[layer] + YAWS // 2) % YAWS - YAWS // 2
    near = np.flatnonzero(np.abs(steps) <= 1)
    box = tuple(slice(max(i - 1, 0), i + 2) for i in point)
    weights = probability[near][:, box[0], box[1]].astype(float)
    weights /= weights.sum()
    rows, columns = np.arange(probability.shape[1])[box[0]], np.arange(probability.shape[2])[box[1]]
    yaw = (yaws[layer] + float((weights.sum((1, 2)) * steps[near]).sum())) * YAW_STEP
    lattice = np.array([(weights.sum((0, 2)) * rows).sum(), (weights.sum((0, 1)) * columns).sum()])
    return (layer, point[0], point[1]), float(yaw), lattice
