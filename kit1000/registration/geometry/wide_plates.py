"""Plates wider than the relief about their middle, as boxes with several cavities: a frame about each hole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import find_objects, label

from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.observed.pixels import Noise
from kit1000.perception.observed.plates import Plane, plane_frame
from kit1000.pose import Pose
from kit1000.registration.geometry.observed_cavity import VOXEL, holes_in, plate_grid
from kit1000.registration.inputs.volume_sources import Source

AREA = 0.025  # [m^2] seen of a plate that is wide: two plates in one plane show less
REACH = 0.11  # [m] along an axis, from its middle to the border of a plate that one relief shows
WIDEST = 0.25  # [m] the same of a plate that is looked at as a whole
BORDER = 0.02  # [m] beyond the border of a plate, within its relief
WITHIN = 98  # percentile of the distances of points from the middle, of the border
LEAST, MOST = 1e-4, 12  # [m^2] of a hole that holds a part; how many of a plate are looked into, the largest
BENT = 2.0  # times as deep a cut, where noise bends rims


def plate_frames(source: Source, plane: Plane, points: np.ndarray, normals: np.ndarray, side: float) -> list[Pose]:
    """world_from_plate for the reliefs of a plate, z along its normal: one about its middle, or one about each hole.

    Args:
        source: of the kits.
        plane: of the plate.
        points: (n, 3) [m] world, on the kits.
        normals: (n, 3) unit.
        side: [m] of a relief.
    """
    frame, noise = plane_frame(plane, plane.point), source.noise
    if plane.area < AREA:
        return [frame]
    local = frame.inverse().apply(_on_plane(plane, points, normals, noise))[:, :2]
    reach = float(np.percentile(np.abs(local), WITHIN, axis=0).max()) if len(local) else 0.0
    if reach <= max(REACH, side / 2):
        return [frame]
    volume = source.plate(plate_grid(frame, 2 * min(reach + BORDER, WIDEST)))
    holes = holes_in(volume, noise.distance, BENT if noise.bent else 1.0)
    centres = [frame.apply(_cell_place(cell, len(holes))) for cell in _centres(holes)]
    return [plane_frame(plane, centre) for centre in centres] or [frame]


def _on_plane(plane: Plane, points: np.ndarray, normals: np.ndarray, noise: Noise) -> np.ndarray:
    """(k, 3) [m] those of points (n, 3) that lie on a plane and face its way."""
    near = np.abs(matmul(points - plane.point, plane.normal)) < 2 * noise.distance
    return points[near & (matmul(normals, plane.normal) > np.cos(2 * noise.angle))]


def _centres(holes: np.ndarray) -> Sequence[np.ndarray]:
    """(2,) cells: the middles of the largest of holes (n, n) bool that may hold a part."""
    names, count = label(holes)  # type: ignore[misc]
    areas = np.bincount(names.ravel(), minlength=count + 1)[1:] * VOXEL**2
    boxes = find_objects(names)
    order = [i for i in np.argsort(-areas, kind="stable").tolist() if areas[i] > LEAST][:MOST]
    return [np.array([(side.start + side.stop - 1) / 2 for side in boxes[i]]) for i in order]


def _cell_place(cell: np.ndarray, cells: int) -> np.ndarray:
    """(3,) [m] in the frame of a relief, of a cell (2,)."""
    return np.append((cell - (cells - 1) / 2) * VOXEL, 0.0)
