"""Compiled loops of the rasterizer: project vertices, set up triangles, fill bands of rows.

Coverage is computed in integers: projected corners are rounded to 1/4096 of a pixel, and edge functions are exact in
64 bits with the top-left rule, so each pixel centre inside a closed fan of triangles is covered by exactly one of them,
without cracks. Depth comes from the plane of the unrounded triangle: its inverse is linear in the pixel coordinates.

Letters: n vertices, m faces, k triangles. Pixels are (u, v) = (column, row).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera
from kit1000.numerics.compiled import compiled

NEAR_PLANE = 1e-3  # [m] nearer surfaces are clipped, which keeps the division by depth finite
SUBPIXEL_BITS = 12  # 1/4096 pixel: 500 times finer than is visible in an image, and products below are under 2^62
SUBPIXELS = 1 << SUBPIXEL_BITS
# Triangles with all corners within UNCLIPPED_LIMIT pixels are not clipped; those that extend beyond it are clipped at
# CLIP_LIMIT. The gap between the two ensures that an edge of an unclipped triangle is not clipped in its neighbour.
UNCLIPPED_LIMIT = float(1 << 16)
CLIP_LIMIT = float(1 << 17)

USABLE, FAR_OUT, BEHIND = 0, 1, 2  # the state of a projected vertex


class Intrinsics(NamedTuple):
    """Camera intrinsics as a tuple that compiled loops can read; [pixels]."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @classmethod
    def of(cls, camera: Camera) -> Intrinsics:
        """The intrinsics of a camera."""
        return cls(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)


class TriangleBatch(NamedTuple):
    """Buffers for k projected triangles."""

    corners: np.ndarray
    """(k, 6) int32 [pixels / 4096]: u, v of three corners, clockwise in the image."""
    planes: np.ndarray
    """(k, 5) float64 [1/m]: 1/depth = plane[0] + plane[1] u + plane[2] v, clamped to plane[3] .. plane[4]."""
    rows: np.ndarray
    """(k, 2) int16: first and last row of pixels."""
    faces: np.ndarray
    """(k,) int32: index of the face among the faces of all bodies."""


@compiled
def project_vertices(intrinsics, vertices, rotation, translation, points, uv, state):
    """Transform vertices (n, 3) to the camera by `rotation` (3, 3) and `translation` (3,), and project them.

    Writes `points` (n, 3) [m] in the camera frame, `state` (n,), and `uv` (n, 2) int32 [pixels / 4096] where the state
    is USABLE.
    """
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        a = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + translation[0]
        b = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + translation[1]
        c = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + translation[2]
        points[i, 0], points[i, 1], points[i, 2] = a, b, c
        state[i] = BEHIND
        if c >= NEAR_PLANE:
            u, v = intrinsics.fx * a / c + intrinsics.cx, intrinsics.fy * b / c + intrinsics.cy
            state[i] = FAR_OUT
            if abs(u) <= UNCLIPPED_LIMIT and abs(v) <= UNCLIPPED_LIMIT:
                state[i] = USABLE
                uv[i, 0], uv[i, 1] = round(u * SUBPIXELS), round(v * SUBPIXELS)


@compiled
def prepare_triangles(intrinsics, faces, first, points, uv, state, batch, to_clip):
    """Write to `batch` the faces (m, 3) that may cover a pixel centre, to `to_clip` those that must be clipped first.

    `first` is the index of faces[0] among all faces. Returns the number of entries in each.
    """
    corners, planes, rows, indices = batch
    count, clip_count = 0, 0
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if state[i] == USABLE and state[j] == USABLE and state[k] == USABLE:
            if _set_corners(intrinsics, uv, i, j, k, corners, rows, count):
                _set_plane(intrinsics, points, i, j, k, planes, count)
                indices[count] = first + f
                count += 1
        elif state[i] != BEHIND or state[j] != BEHIND or state[k] != BEHIND:
            to_clip[clip_count] = f
            clip_count += 1
    return count, clip_count


@compiled
def prepare_clipped(intrinsics, to_clip, faces, first, points, batch):
    """Like `prepare_triangles`, for the faces listed in `to_clip`: clip each to the camera's frustum.

    A clipped triangle has up to 8 corners, so `batch` must hold 6 triangles per face. Returns the number of entries.
    """
    bounds = np.array((
        (0.0, 0.0, 1.0, -NEAR_PLANE),
        (intrinsics.fx, 0.0, CLIP_LIMIT + intrinsics.cx, 0.0), (-intrinsics.fx, 0.0, CLIP_LIMIT - intrinsics.cx, 0.0),
        (0.0, intrinsics.fy, CLIP_LIMIT + intrinsics.cy, 0.0), (0.0, -intrinsics.fy, CLIP_LIMIT - intrinsics.cy, 0.0),
    ))  # fmt: skip
    polygon, spare = np.empty((9, 3)), np.empty((9, 3))
    polygon_uv = np.empty((9, 2), np.int32)
    corners, planes, rows, indices = batch
    count = 0
    for f in to_clip:
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        polygon[0], polygon[1], polygon[2] = points[i], points[j], points[k]
        sides = _clip_polygon(polygon, spare, bounds)
        for s in range(sides):
            polygon_uv[s, 0] = round((intrinsics.fx * polygon[s, 0] / polygon[s, 2] + intrinsics.cx) * SUBPIXELS)
            polygon_uv[s, 1] = round((intrinsics.fy * polygon[s, 1] / polygon[s, 2] + intrinsics.cy) * SUBPIXELS)
        for s in range(1, sides - 1):
            if _set_corners(intrinsics, polygon_uv, 0, s, s + 1, corners, rows, count):
                _set_plane(intrinsics, points, i, j, k, planes, count)
                indices[count] = first + f
                count += 1
    return count


@compiled
def fill_band(top, batch, count, inverse_depth, nearest_face):
    """Rasterize the first `count` triangles of a batch into the band of rows that begins at `top`.

    `inverse_depth` (rows, W) is 1/depth [1/m], 0 without a surface; `nearest_face` (rows, W) int32 the face.
    The nearer surface counts; at equal depth the earlier one.
    """
    height, width = inverse_depth.shape
    corners, planes, rows, indices = batch
    for t in range(count):
        if rows[t, 1] < top or rows[t, 0] >= top + height:
            continue
        x0, y0 = np.int64(corners[t, 0]), np.int64(corners[t, 1])
        x1, y1 = np.int64(corners[t, 2]), np.int64(corners[t, 3])
        x2, y2 = np.int64(corners[t, 4]), np.int64(corners[t, 5])
        start = max(-((-min(x0, x1, x2)) >> SUBPIXEL_BITS), 0)
        stop = min(max(x0, x1, x2) >> SUBPIXEL_BITS, width - 1)
        for y in range(max(rows[t, 0], top), min(rows[t, 1] + 1, top + height)):
            left, right = _span(x0, y0, x1, y1, y, start, stop)
            left, right = _span(x1, y1, x2, y2, y, left, right)
            left, right = _span(x2, y2, x0, y0, y, left, right)
            base = planes[t, 0] + planes[t, 2] * y
            for x in range(left, right + 1):
                value = min(max(base + planes[t, 1] * x, planes[t, 3]), planes[t, 4])
                if value > inverse_depth[y - top, x]:
                    inverse_depth[y - top, x] = value
                    nearest_face[y - top, x] = indices[t]


@compiled
def resolve_band(inverse_depth, nearest_face, body_of, first_of, depth, ids, faces):
    """Convert a filled band to depth [m], body index + 1, and the index of the face within its body."""
    for y in range(inverse_depth.shape[0]):
        for x in range(inverse_depth.shape[1]):
            if inverse_depth[y, x] > 0:
                body = body_of[nearest_face[y, x]]
                depth[y, x] = 1 / inverse_depth[y, x]
                ids[y, x] = body + 1
                faces[y, x] = nearest_face[y, x] - first_of[body]


@compiled
def _set_corners(intrinsics, uv, i, j, k, corners, rows, at):
    """Store triangle i, j, k at index `at`, clockwise; False when it can cover no pixel centre."""
    x0, y0 = np.int64(uv[i, 0]), np.int64(uv[i, 1])
    x1, y1 = np.int64(uv[j, 0]), np.int64(uv[j, 1])
    x2, y2 = np.int64(uv[k, 0]), np.int64(uv[k, 1])
    left = -((-min(x0, x1, x2)) >> SUBPIXEL_BITS)
    right = max(x0, x1, x2) >> SUBPIXEL_BITS
    top = -((-min(y0, y1, y2)) >> SUBPIXEL_BITS)
    bottom = max(y0, y1, y2) >> SUBPIXEL_BITS
    if left > right or top > bottom or right < 0 or bottom < 0 or left >= intrinsics.width or top >= intrinsics.height:
        return False
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    if area == 0:
        return False
    if area < 0:
        x1, y1, x2, y2 = x2, y2, x1, y1
    corners[at, 0], corners[at, 1], corners[at, 2] = x0, y0, x1
    corners[at, 3], corners[at, 4], corners[at, 5] = y1, x2, y2
    rows[at, 0], rows[at, 1] = max(top, 0), min(bottom, intrinsics.height - 1)
    return True


@compiled
def _set_plane(intrinsics, points, i, j, k, planes, at):
    """Store 1/depth, as a linear function over the image, of the plane through points i, j, k, and its bounds there.

    The bounds matter for triangles seen edge on, where rounding may move a pixel off the true triangle.
    """
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    p, q, r = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
    s, t, w = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
    nx, ny, nz = q * w - r * t, r * s - p * w, p * t - q * s
    scale = 1 / (nx * x + ny * y + nz * z)
    along_u, along_v = nx * scale / intrinsics.fx, ny * scale / intrinsics.fy
    origin = nz * scale - along_u * intrinsics.cx - along_v * intrinsics.cy
    nearest, farthest = max(z + min(r, w, 0.0), NEAR_PLANE), z + max(r, w, 0.0)
    planes[at, 3], planes[at, 4] = 1 / farthest, 1 / nearest
    if math.isfinite(origin + along_u + along_v):
        planes[at, 0], planes[at, 1], planes[at, 2] = origin, along_u, along_v
    else:  # seen exactly edge on: the plane has no depth over the image, use that of the nearest corner
        planes[at, 0], planes[at, 1], planes[at, 2] = planes[at, 4], 0.0, 0.0


@compiled
def _span(x0, y0, x1, y1, y, left, right):
    """Narrow the columns left .. right of row y to those on the inner side of the edge from 0 to 1.

    Column x is inside when dx (y - y0) - dy (x - x0) > 0, or = 0 on a left or a top edge.
    """
    dx, dy = x1 - x0, y1 - y0
    value = dx * ((y << SUBPIXEL_BITS) - y0) + dy * x0
    if not (dy < 0 or (dy == 0 and dx > 0)):
        value -= 1
    if dy > 0:
        right = min(right, floor_divide(value, dy << SUBPIXEL_BITS))
    elif dy < 0:
        left = max(left, -floor_divide(value, -dy << SUBPIXEL_BITS))
    elif value < 0:
        right = left - 1
    return left, right


@compiled
def floor_divide(value, divisor):
    """Exact floor(value / divisor) for divisor > 0, from the quotient of floats, which is off by one at most."""
    quotient = np.int64(math.floor(np.float64(value) / np.float64(divisor)))
    rest = value - quotient * divisor
    if rest < 0:
        quotient -= 1
    elif rest >= divisor:
        quotient += 1
    return quotient


@compiled
def _clip_polygon(polygon, spare, bounds):
    """Clip a triangle, in place, to the points p with bounds . (p, 1) >= 0; return its number of corners."""
    sides = 3
    for b in range(bounds.shape[0]):
        made = 0
        for s in range(sides):
            here, there = polygon[s], polygon[(s + 1) % sides]
            h = bounds[b, 0] * here[0] + bounds[b, 1] * here[1] + bounds[b, 2] * here[2] + bounds[b, 3]
            t = bounds[b, 0] * there[0] + bounds[b, 1] * there[1] + bounds[b, 2] * there[2] + bounds[b, 3]
            if h >= 0:
                spare[made] = here
                made += 1
            if (h >= 0) != (t >= 0):
                # Always interpolated from the inside out: both triangles at this edge get the same corner, bit for bit.
                if h >= 0:
                    spare[made] = here + h / (h - t) * (there - here)
                else:
                    spare[made] = there + t / (t - h) * (here - there)
                made += 1
        sides = made
        polygon[:sides] = spare[:sides]
        if sides < 3:
            return 0
    return sides
