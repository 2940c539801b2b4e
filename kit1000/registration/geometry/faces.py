"""The faces a part can be inserted on: flat sides of its convex hull on which it can stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from kit1000.numerics.linear_algebra import length, matmul

OVERHANG = 1e-3  # [m] by which the middle of a part may lie outside the outline of a face on which it stands
SMALLEST = 4e-6  # [m^2] of a face
MOST = 24  # facets of the hull from which faces are grown
PAIRED = 5  # normals at the head of the list whose pairs give a third direction
AREA_DECIMALS = 12  # of a square metre: facets of equal area are taken in the order of the hull


@dataclass(frozen=True)
class Face:
    """A flat side of the convex hull."""

    normal: np.ndarray
    """(3,) outward unit normal, world, the part as it lies now."""
    area: float
    """[m^2]"""


def standing_faces(points: np.ndarray, middle: np.ndarray, angle: float) -> list[Face]:
    """The faces of the hull of points (n, 3) [m] on which a part with a middle (3,) [m] stands, the largest first.

    Args:
        points: of the part, world.
        middle: of the part, world.
        angle: [rad] facets within this angle are one face; larger for noisier points.
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
    free = np.ones(len(areas), bool)
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


def squared(normal: np.ndarray, angle: float) -> np.ndarray:
    """A face's normal (3,), put exactly upright or level if it is so within an angle [rad].

    A part lies on a flat side, and most sides of machine parts are parallel to it or at right angles.
    """
    if abs(normal[2]) > np.cos(angle):
        return np.array([0.0, 0.0, np.sign(normal[2])])
    if abs(normal[2]) < np.sin(angle):
        level = normal * (1.0, 1.0, 0.0)
        return level / length(level)
    return normal


def right_angled(normals: Sequence[np.ndarray], angle: float) -> list[np.ndarray]:
    """Normals (3,), their opposites, and the directions at right angles to two of them that are at right angles.

    Machine parts are mostly right-angled: hidden sides are parallel or at right angles to those that an image shows.
    Among directions less than two angles [rad] apart the first is kept.
    """
    first = list(normals)
    across = [
        np.cross(a, b) / length(np.cross(a, b))
        for a, b in combinations(first[:PAIRED], 2)
        if abs(matmul(a, b)) < np.sin(angle)
    ]
    kept: list[np.ndarray] = []
    for normal in [*first, *(-normal for normal in first), *across, *(-normal for normal in across)]:
        if not any(matmul(normal, other) > np.cos(2 * angle) for other in kept):
            kept.append(normal)
    return kept


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
