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
ROUNDING = 1e-9  # [m] more than the rounding errors of a height
BARYCENTRIC_SLACK = 1e-12  # [m] so that a point on the edge between two faces belongs to at least one of them


@dataclass(frozen=True, eq=False)
class ContactFeatures:
    """The features of a body that can be touched from one side along z."""

    vertices: np.ndarray  # (n, 3) [m] ends of the edges
    edges: np.ndarray  # (k, 2, 3) [m] convex edges
    faces: np.ndarray  # (m, 3, 3) [m] triangles whose normals point to that side


def contact_features(body: Mesh, rotation: np.ndarray, translation: np.ndarray, side: float) -> ContactFeatures:
    """The features of a closed body that can be touched from above (side = +1) or from below (side = -1).

    rotation: (3, 3) and translation: (3,) [m] of a rigid motion of the body.
    """
    vertices = matmul(body.vertices, rotation.T) + translation
    facing = side * (matmul(body.normals, rotation[2]))  # (m,) cosine to the direction of view
    ends, adjacent = body.convex_edges
    ends = ends[(facing[adjacent] > -WALL_COSINE).any(1)]
    is_end = np.zeros(len(vertices), dtype=bool)
    is_end[ends] = True
    return ContactFeatures(vertices[is_end], vertices[ends], vertices[body.faces[facing > WALL_COSINE]])


def cropped(features: ContactFeatures, low: np.ndarray, high: np.ndarray) -> ContactFeatures:
    """The features whose bounding boxes in xy meet the box low..high (2,) [m]."""
    return ContactFeatures(
        features.vertices[_boxes_overlap(features.vertices[:, None], low, high)],
        features.edges[_boxes_overlap(features.edges, low, high)],
        features.faces[_boxes_overlap(features.faces, low, high)],
    )


def vertical_contact_offset(moving: ContactFeatures, fixed: ContactFeatures, enough: float = np.inf) -> float:
    """Distance along z that takes the moving body to first contact [m]: negative if it hangs free, -inf if it misses.

    The features of the moving body are those from below, of the fixed one from above, in a frame whose z is the line of
    motion. An offset above `enough` [m] is not searched to its end: the result is then some number above it.
    """
    if not len(moving.vertices):
        return -np.inf
    low, high = moving.vertices[:, :2].min(0), moving.vertices[:, :2].max(0)
    fixed = cropped(fixed, low, high)
    best = highest_vertex_contact(moving.vertices, fixed.faces, 1.0, -np.inf, enough)
    best = highest_vertex_contact(fixed.vertices, moving.faces, -1.0, best, enough)
    return highest_edge_contact(moving.edges, fixed.edges, best, enough)


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
def _bins(low, high):
    """A grid over the boxes of k shapes, (k, 2) lowest and highest corners: (origin, cells per metre, cells, cell of
    the first shape of each cell, shapes by cell). A shape is in every cell that its box meets."""
    count = low.shape[0]
    x0, x1, y0, y1, wide, deep = np.inf, -np.inf, np.inf, -np.inf, 0.0, 0.0
    for i in range(count):
        x0, x1, y0, y1 = min(x0, low[i, 0]), max(x1, high[i, 0]), min(y0, low[i, 1]), max(y1, high[i, 1])
        wide, deep = wide + high[i, 0] - low[i, 0], deep + high[i, 1] - low[i, 1]
    # cells as large as the mean box at least, so that few shapes are in many cells
    across = int(np.sqrt(count)) + 1
    nx = max(1, min(across, int((x1 - x0) / max(wide / count, 1e-9)))) if count else 1
    ny = max(1, min(across, int((y1 - y0) / max(deep / count, 1e-9)))) if count else 1
    sx, sy = nx / max(x1 - x0, 1e-9), ny / max(y1 - y0, 1e-9)
    first = np.zeros(nx * ny + 1, np.int64)
    for i in range(count):
        for cx in range(_cell(low[i, 0], x0, sx, nx), _cell(high[i, 0], x0, sx, nx) + 1):
            for cy in range(_cell(low[i, 1], y0, sy, ny), _cell(high[i, 1], y0, sy, ny) + 1):
                first[cx * ny + cy + 1] += 1
    for c in range(nx * ny):
        first[c + 1] += first[c]
    shapes, filled = np.empty(first[nx * ny], np.int64), np.zeros(nx * ny, np.int64)
    for i in range(count):
        for cx in range(_cell(low[i, 0], x0, sx, nx), _cell(high[i, 0], x0, sx, nx) + 1):
            for cy in range(_cell(low[i, 1], y0, sy, ny), _cell(high[i, 1], y0, sy, ny) + 1):
                c = cx * ny + cy
                shapes[first[c] + filled[c]] = i
                filled[c] += 1
    return x0, y0, sx, sy, nx, ny, first, shapes


@compiled
def _cell(x, x0, scale, count):
    """The cell of a coordinate, in whole numbers up to count - 1; coordinates outside are in the nearest cell."""
    place = (x - x0) * scale
    return 0 if place <= 0 else count - 1 if place >= count - 1 else int(place)


@compiled
def highest_vertex_contact(points, faces, sign, best, enough):
    """max of `best` and of sign * (face height - point height) over points above or below a face.

    Stops at the first number above `enough`.
    """
    if best > enough:
        return best
    x0, y0, sx, sy, nx, ny, first, shapes = _bins(points[:, :2], points[:, :2])
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
        low_z, high_z = min(az, bz, cz), max(az, bz, cz)
        # the height that the slack can add to the face, and rounding: farther below the best nothing is computed
        reach = (high_z if sign > 0 else -low_z) - 3 * slack * (high_z - low_z) + ROUNDING
        for i in range(_cell(low_x, x0, sx, nx), _cell(high_x, x0, sx, nx) + 1):
            for j in range(_cell(low_y, y0, sy, ny), _cell(high_y, y0, sy, ny) + 1):
                for k in range(first[i * ny + j], first[i * ny + j + 1]):
                    p = shapes[k]
                    x, y = points[p, 0], points[p, 1]
                    if x < low_x or x > high_x or y < low_y or y > high_y or reach - sign * points[p, 2] < best:
                        continue
                    u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                    v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                    w = 1.0 - u - v
                    if u >= slack and v >= slack and w >= slack:
                        best = max(best, sign * (u * az + v * bz + w * cz - points[p, 2]))
        if best > enough:
            break
    return best


@compiled
def highest_edge_contact(moving, fixed, best, enough):
    """max of `best` and of (fixed height - moving height) over the crossings of two sets of projected edges.

    Stops at the first number above `enough`.
    """
    if best > enough:
        return best
    low, high = np.empty((fixed.shape[0], 2)), np.empty((fixed.shape[0], 2))
    for s in range(fixed.shape[0]):
        for i in range(2):
            low[s, i], high[s, i] = min(fixed[s, 0, i], fixed[s, 1, i]), max(fixed[s, 0, i], fixed[s, 1, i])
    x0, y0, sx, sy, nx, ny, first, shapes = _bins(low, high)
    for m in range(moving.shape[0]):
        ax, ay, az = moving[m, 0]
        bx, by, bz = moving[m, 1]
        low_x, high_x, low_y, high_y = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
        dx, dy, low_z = bx - ax, by - ay, min(az, bz) - ROUNDING
        for i in range(_cell(low_x, x0, sx, nx), _cell(high_x, x0, sx, nx) + 1):
            for j in range(_cell(low_y, y0, sy, ny), _cell(high_y, y0, sy, ny) + 1):
                for k in range(first[i * ny + j], first[i * ny + j + 1]):
                    s = shapes[k]
                    if low[s, 0] > high_x or high[s, 0] < low_x or low[s, 1] > high_y or high[s, 1] < low_y:
                        continue
                    px, py, pz = fixed[s, 0]
                    qx, qy, qz = fixed[s, 1]
                    if max(pz, qz) - low_z < best:
                        continue
                    ex, ey = qx - px, qy - py
                    across = dx * ey - dy * ex
                    if across == 0.0:
                        continue
                    t = ((px - ax) * ey - (py - ay) * ex) / across
                    u = ((px - ax) * dy - (py - ay) * dx) / across
                    if 0.0 <= t <= 1.0 and 0.0 <= u <= 1.0:
                        best = max(best, pz + u * (qz - pz) - az - t * (bz - az))
        if best > enough:
            break
    return best
