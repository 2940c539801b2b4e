"""The faces a part can be inserted on: flat sides of its convex hull on which it can stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from kit1000.products import length, matmul

OVERHANG = 1e-3  # [m] by which the middle of a part may lie outside the outline of a face it stands on
SMALLEST = 4e-6  # [m^2] of a face
MOST = 24  # faces that are tried
AREA_DECIMALS = 12  # of a square metre: facets of equal area are taken in the order of the hull


@dataclass(frozen=True)
class Face:
    """A flat side of the convex hull."""

    normal: np.ndarray
    """(3,) outward unit normal, world, the part as it lies now."""
    area: float
    """[m^2]"""


def standing_faces(
    points: np.ndarray, middle: np.ndarray, angle: float, directions: np.ndarray | None = None, cone: float = np.pi
) -> list[Face]:
    """The faces of the hull of points (n, 3) [m] on which a part with that middle (3,) [m] stands, largest first.

    Args:
        points: of the part, world.
        middle: of the part, world.
        angle: [rad] facets within this angle are one face; larger for noisier points.
        directions: (m, 3) unit; only faces whose normal lies within `cone` of one of them.
        cone: [rad]
    """
    if len(points) < 4:
        return []
    try:
        hull = ConvexHull(points)
    except QhullError:  # the observed points lie on a line
        return []
    corners = points[hull.simplices]
    normals = hull.equations[:, :3]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    ranks = areas.round(AREA_DECIMALS)
    faces = []
    free = np.ones(len(areas), bool) if directions is None else matmul(normals, directions.T).max(1) > np.cos(cone)
    for _ in range(MOST):
        if not free.any():
            break
        seed = int(np.argmax(np.where(free, ranks, -1)))
        normal = normals[seed]
        for _ in range(3):
            members = matmul(normals, normal) > np.cos(angle)
            normal = (areas[members, None] * normals[members]).sum(0)
            normal /= length(normal)
        members = free & (matmul(normals, normal) > np.cos(angle))
        members[seed] = True
        free &= ~members
        area = round(float(areas[members].sum()), AREA_DECIMALS)
        if area > SMALLEST and _stands(corners[members].reshape(-1, 3), normal, middle):
            faces.append(Face(normal, area))
    return sorted(faces, key=lambda face: -face.area)


def _stands(corners: np.ndarray, normal: np.ndarray, middle: np.ndarray) -> bool:
    """Whether a middle (3,) projects onto a face with these corners (n, 3)."""
    x = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    x /= length(x)
    across = np.stack([x, np.cross(normal, x)])
    flat, foot = matmul(corners, across.T), matmul(across, middle)
    try:
        outline = ConvexHull(flat)
    except QhullError:  # a face as narrow as a line
        return False
    return bool((matmul(outline.equations[:, :2], foot) + outline.equations[:, 2]).max() < OVERHANG)
