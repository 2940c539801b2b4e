"""The faces a part may be inserted on: flat sides of its convex hull on which it can stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

FOOTING = 1e-3  # [m] by which the middle of a part may lie beyond the edge of a face it stands on
SMALLEST = 4e-6  # [m^2] of a face
MOST = 24  # faces that are looked at


@dataclass(frozen=True)
class Face:
    """A flat side of the hull."""

    normal: np.ndarray
    """(3,) outward unit normal, world, the part as it lies now."""
    area: float
    """[m^2]"""


def standing_faces(
    points: np.ndarray, middle: np.ndarray, flat: float, ways: np.ndarray | None = None, cone: float = np.pi
) -> list[Face]:
    """The faces of the hull of points (n, 3) [m] on which a part of that middle (3,) [m] stands, largest first.

    flat: [rad] facets within this angle are one face; the more, the noisier the points.
    ways: (m, 3) unit; only faces that look along one of them, within the angle `cone` [rad].
    """
    if len(points) < 4:
        return []
    try:
        hull = ConvexHull(points)
    except QhullError:  # nothing of the part was seen but a line
        return []
    corners = points[hull.simplices]
    normals = hull.equations[:, :3]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    faces = []
    free = np.ones(len(areas), bool) if ways is None else (normals @ ways.T).max(1) > np.cos(cone)
    for _ in range(MOST):
        if not free.any():
            break
        seed = int(np.argmax(np.where(free, areas, 0)))
        normal = normals[seed]
        for _ in range(3):
            members = normals @ normal > np.cos(flat)
            normal = (areas[members, None] * normals[members]).sum(0)
            normal /= np.linalg.norm(normal)
        members = free & (normals @ normal > np.cos(flat))
        members[seed] = True
        free &= ~members
        area = float(areas[members].sum())
        if area > SMALLEST and _stands(corners[members].reshape(-1, 3), normal, middle):
            faces.append(Face(normal, area))
    return sorted(faces, key=lambda face: -face.area)


def _stands(corners: np.ndarray, normal: np.ndarray, middle: np.ndarray) -> bool:
    """Whether a middle (3,) lies above a face with these corners (n, 3)."""
    across = np.linalg.svd(normal[None])[2][1:]
    flat, foot = corners @ across.T, across @ middle
    try:
        outline = ConvexHull(flat)
    except QhullError:  # a face as narrow as a line
        return False
    return bool((outline.equations[:, :2] @ foot + outline.equations[:, 2]).max() < FOOTING)
