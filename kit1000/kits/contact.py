"""First contact of two polyhedra, one moving along z and one fixed: exact, in closed form.

Only the lower envelope of the moving body and the upper envelope of the fixed body matter: contact is where (fixed -
moving) is largest over the xy plane. Both are piecewise linear, so the maximum lies at a vertex of one over a face of
the other, or where two projected edges cross. Only faces towards the other body and only convex edges can touch, which
leaves few pairs. All arrays are metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import matmul

WALL_COSINE = 1e-9  # faces whose unit normal has a smaller z are walls: only their edges can touch
COPLANAR_SINE = 1e-9  # sine of the dihedral angle below which two faces count as coplanar
BARYCENTRIC_SLACK = 1e-12  # [m] so that a point on the edge between two faces belongs to at least one of them


@dataclass(frozen=True, eq=False)
class ContactFeatures:
    """What of a body can be touched from one side along z."""

    vertices: np.ndarray
    """(n, 3) [m] ends of the edges."""
    edges: np.ndarray
    """(k, 2, 3) [m] convex edges."""
    faces: np.ndarray
    """(m, 3, 3) [m] triangles whose normals point to that side."""


@dataclass(frozen=True, eq=False)
class ConvexEdges:
    """The convex edges of a mesh, independent of its pose."""

    mesh: Mesh
    ends: np.ndarray
    """(k, 2) indices of vertices."""
    adjacent: np.ndarray
    """(k, 2) indices of the two faces at each edge."""


def convex_edges(mesh: Mesh) -> ConvexEdges:
    """The convex edges of a closed mesh."""
    a, b = mesh.faces.ravel(), mesh.faces[:, [1, 2, 0]].ravel()
    owner = np.repeat(np.arange(len(mesh.faces)), 3)
    n = len(mesh.vertices)
    there, back = a.astype(np.int64) * n + b, b.astype(np.int64) * n + a
    order, opposite = np.argsort(there), np.argsort(back)
    first, second = order[a[order] < b[order]], opposite[a[order] < b[order]]
    left, right = mesh.normals[owner[first]], mesh.normals[owner[second]]
    along = mesh.vertices[b[first]] - mesh.vertices[a[first]]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    convex = np.einsum("ij,ij->i", np.cross(left, right), along) > COPLANAR_SINE
    convex |= ~(left.any(1) & right.any(1))  # a face without area has no normal: its edges may be convex
    return ConvexEdges(
        mesh,
        np.stack([a[first], b[first]], 1)[convex],
        np.stack([owner[first], owner[second]], 1)[convex],
    )


def contact_features(body: ConvexEdges, rotation: np.ndarray, translation: np.ndarray, side: float) -> ContactFeatures:
    """What of a body can be touched from above (side = +1) or from below (side = -1) after a rigid motion.

    rotation: (3, 3); translation: (3,) [m].
    """
    vertices = matmul(body.mesh.vertices, rotation.T) + translation
    facing = side * (matmul(body.mesh.normals, rotation[2]))  # (m,) cosine to the direction of view
    ends = body.ends[(facing[body.adjacent] > -WALL_COSINE).any(1)]
    return ContactFeatures(
        vertices[np.unique(ends)],
        vertices[ends],
        vertices[body.mesh.faces[facing > WALL_COSINE]],
    )


def cropped(features: ContactFeatures, low: np.ndarray, high: np.ndarray) -> ContactFeatures:
    """The features whose bounding boxes in xy meet the box low..high (2,) [m]."""
    return ContactFeatures(
        features.vertices[_boxes_overlap(features.vertices[:, None], low, high)],
        features.edges[_boxes_overlap(features.edges, low, high)],
        features.faces[_boxes_overlap(features.faces, low, high)],
    )


def vertical_contact_offset(moving: ContactFeatures, fixed: ContactFeatures) -> float:
    """[m] along z that takes the moving body to first contact: negative when it hangs free, -inf when it falls past.

    moving: features from below, fixed: features from above, both in a frame whose z is the line of motion.
    """
    if not len(moving.vertices):
        return -np.inf
    low, high = moving.vertices[:, :2].min(0), moving.vertices[:, :2].max(0)
    fixed = cropped(fixed, low, high)
    return max(
        _highest_vertex_contact(moving.vertices, fixed.faces, 1.0),
        _highest_vertex_contact(fixed.vertices, moving.faces, -1.0),
        _highest_edge_contact(moving.edges, fixed.edges),
    )


@compiled
def _boxes_overlap(shapes, low, high):
    """(n,) bool: which of n shapes of k vertices (n, k, 3) have a bounding box in xy that meets the box low..high."""
    overlaps = np.ones(shapes.shape[0], np.bool_)
    for i in range(shapes.shape[0]):
        for axis in range(2):
            least = most = shapes[i, 0, axis]
            for k in range(1, shapes.shape[1]):
                least, most = min(least, shapes[i, k, axis]), max(most, shapes[i, k, axis])
            if least > high[axis] or most < low[axis]:
                overlaps[i] = False
    return overlaps


@compiled
def _highest_vertex_contact(points, faces, sign):
    """max of sign * (face height - point height) over points above or below a face."""
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
        slack = -BARYCENTRIC_SLACK * max(high_x - low_x, high_y - low_y) / abs(area)
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
def _highest_edge_contact(moving, fixed):
    """max of (fixed height - moving height) over the crossings of two sets of projected edges."""
    best = -np.inf
    for m in range(moving.shape[0]):
        ax, ay, az = moving[m, 0]
        bx, by, bz = moving[m, 1]
        low_x, high_x, low_y, high_y = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
        dx, dy = bx - ax, by - ay
        for s in range(fixed.shape[0]):
            px, py, pz = fixed[s, 0]
            qx, qy, qz = fixed[s, 1]
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
