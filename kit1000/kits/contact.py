"""First contact of two polyhedra when one moves along z: exact, in closed form.

Along the direction of motion the moving body is its lower envelope and the standing body its upper envelope, so the
contact height is the maximum of (standing - moving) over the plane. Both are piecewise linear: the maximum lies at a
vertex of one over a face of the other, or where two projected edges cross. Only faces that look at the other body and
only convex edges can touch, which leaves few pairs. All arrays are metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.compiled import compiled
from kit1000.mesh import Mesh

STEEP = 1e-9  # faces whose unit normal has a smaller z are walls: their edges speak for them
FLAT_EDGE = 1e-9  # sine of the dihedral angle below which two faces count as one plane
RIM = 1e-12  # [m] closed triangles: a point on the edge between two faces belongs to at least one


@dataclass(frozen=True, eq=False)
class Feelers:
    """What of a body can be touched from one side: convex edges, their corners, and the faces that look that way."""

    corners: np.ndarray
    """(n, 3)"""
    edges: np.ndarray
    """(k, 2, 3)"""
    faces: np.ndarray
    """(m, 3, 3)"""


@dataclass(frozen=True, eq=False)
class Ridges:
    """The convex edges of a mesh with the normals of their two faces, found once and turned with the body."""

    mesh: Mesh
    ends: np.ndarray
    """(k, 2) indices of vertices."""
    sides: np.ndarray
    """(k, 2) indices of faces."""


def ridges(mesh: Mesh) -> Ridges:
    """The convex edges of a closed mesh."""
    a, b = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    owner = np.repeat(np.arange(len(mesh.faces)), 3)
    n = len(mesh.vertices)
    there, back = a.astype(np.int64) * n + b, b.astype(np.int64) * n + a
    order, twin = np.argsort(there), np.argsort(back)
    first, second = order[a[order] < b[order]], twin[a[order] < b[order]]
    left, right = mesh.normals[owner[first]], mesh.normals[owner[second]]
    along = mesh.vertices[b[first]] - mesh.vertices[a[first]]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    convex = np.einsum("ij,ij->i", np.cross(left, right), along) > FLAT_EDGE
    convex |= ~(left.any(1) & right.any(1))  # a face without area has no normal: its edges may be convex
    return Ridges(
        mesh,
        np.stack([a[first], b[first]], 1)[convex],
        np.stack([owner[first], owner[second]], 1)[convex],
    )


def feelers(body: Ridges, rotation: np.ndarray, translation: np.ndarray, side: float) -> Feelers:
    """What can be touched from above (side = +1) or from below (side = -1) of a body carried by a rigid motion.

    rotation (3, 3), translation (3,) [m].
    """
    vertices = body.mesh.vertices @ rotation.T + translation
    looks = side * (body.mesh.normals @ rotation[2])
    ends = body.ends[(looks[body.sides] > -STEEP).any(1)]
    return Feelers(
        vertices[np.unique(ends)],
        vertices[ends],
        vertices[body.mesh.faces[looks > STEEP]],
    )


def within(standing: Feelers, low: np.ndarray, high: np.ndarray) -> Feelers:
    """The feelers whose shadow meets the box low..high (2,) [m] in the plane."""
    return Feelers(
        standing.corners[_meets(standing.corners[:, None], low, high)],
        standing.edges[_meets(standing.edges, low, high)],
        standing.faces[_meets(standing.faces, low, high)],
    )


def contact_height(moving: Feelers, standing: Feelers) -> float:
    """How far the moving body must be raised to just touch [m]; negative when it hangs free, -inf when it falls past.

    moving: seen from below, standing: seen from above, both in a frame whose z is the line of motion.
    """
    if not len(moving.corners):
        return -np.inf
    low, high = moving.corners[:, :2].min(0), moving.corners[:, :2].max(0)
    standing = within(standing, low, high)
    return max(
        _highest_under(moving.corners, standing.faces, 1.0),
        _highest_under(standing.corners, moving.faces, -1.0),
        _highest_crossing(moving.edges, standing.edges),
    )


@compiled
def _meets(shapes, low, high):
    """(n,) bool: which of n shapes of k corners (n, k, 3) have a shadow whose box meets the box low..high."""
    meets = np.ones(shapes.shape[0], np.bool_)
    for i in range(shapes.shape[0]):
        for axis in range(2):
            least = most = shapes[i, 0, axis]
            for k in range(1, shapes.shape[1]):
                least, most = min(least, shapes[i, k, axis]), max(most, shapes[i, k, axis])
            if least > high[axis] or most < low[axis]:
                meets[i] = False
    return meets


@compiled
def _highest_under(points, faces, sign):
    """max of sign * (face height - point height) over points that lie in the shadow of a face."""
    best = -np.inf
    for f in range(faces.shape[0]):
        ax, ay, az = faces[f, 0]
        bx, by, bz = faces[f, 1]
        cx, cy, cz = faces[f, 2]
        low_x, high_x = min(ax, bx, cx), max(ax, bx, cx)
        low_y, high_y = min(ay, by, cy), max(ay, by, cy)
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        slack = -RIM * max(high_x - low_x, high_y - low_y) / abs(area)
        for p in range(points.shape[0]):
            x, y = points[p, 0], points[p, 1]
            if x < low_x or x > high_x or y < low_y or y > high_y:
                continue
            u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
            v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
            w = 1.0 - u - v
            if u >= slack and v >= slack and w >= slack:
                best = max(best, sign * (u * az + v * bz + w * cz - points[p, 2]))
    return best


@compiled
def _highest_crossing(moving, standing):
    """max of (standing - moving) over the crossings of two sets of projected edges."""
    best = -np.inf
    for m in range(moving.shape[0]):
        ax, ay, az = moving[m, 0]
        bx, by, bz = moving[m, 1]
        low_x, high_x, low_y, high_y = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
        dx, dy = bx - ax, by - ay
        for s in range(standing.shape[0]):
            px, py, pz = standing[s, 0]
            qx, qy, qz = standing[s, 1]
            if min(px, qx) > high_x or max(px, qx) < low_x or min(py, qy) > high_y or max(py, qy) < low_y:
                continue
            ex, ey = qx - px, qy - py
            across = dx * ey - dy * ex
            if across == 0.0:
                continue
            t = ((px - ax) * ey - (py - ay) * ex) / across
            u = ((px - ax) * dy - (py - ay) * dx) / across
            if 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0:
                best = max(best, pz + u * (qz - pz) - az - t * (bz - az))
    return best
