"""Compiled loops of the renderer: project vertices, prepare triangles, fill bands of rows.

Coverage is decided in whole numbers: projected corners are snapped to 1/4096 of a pixel and edges are
evaluated exactly in 64 bits with the top-left rule, so each pixel centre inside a closed fan of triangles
belongs to exactly one of them and no crack opens. Depth comes from the plane of the triangle that was not
snapped: its inverse is linear in the pixel coordinates.

Letters: n vertices, m faces, k prepared triangles. Pixels are (u, v) = (column, row).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera
from kit1000.compiled import compiled

NEAR_PLANE = 1e-3  # [m] nothing nearer to the camera is seen; keeps the division by depth finite
SNAP_BITS = 12  # 1/4096 pixel: 500 times finer than a sharp picture shows, and products below stay under 2^62
SNAP = 1 << SNAP_BITS
# Corners within REGULAR pixels are used as they are; triangles that reach beyond are cut at LIMIT. The gap
# between the two makes sure that an edge of an uncut triangle is never cut in its neighbour.
UNCLIPPED_LIMIT = float(1 << 16)
CLIP_LIMIT = float(1 << 17)

PASSES, FAR_OUT, BEHIND = 0, 1, 2  # what `project` says of a vertex


class Intrinsics(NamedTuple):
    """A camera in the form that compiled loops can read; [pixels]."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @classmethod
    def of(cls, camera: Camera) -> Intrinsics:
        """The lens of a camera."""
        return cls(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)


class TriangleBatch(NamedTuple):
    """Room for k triangles that are ready to be filled."""

    corners: np.ndarray
    """(k, 6) int32 [pixels / 4096]: u, v of three corners, clockwise as seen."""
    planes: np.ndarray
    """(k, 5) float64 [1/m]: 1/depth = plane[0] + plane[1] u + plane[2] v, within plane[3] .. plane[4]."""
    rows: np.ndarray
    """(k, 2) int16: first and last row of pixels."""
    faces: np.ndarray
    """(k,) int32: number of the face among those of all bodies."""


@compiled
def project_vertices(lens, vertices, rotation, shift, seen, snapped, state):
    """Take vertices (n, 3) to the camera by `rotation` (3, 3) and `shift` (3,).

    Written: points `seen` (n, 3) [m], `snapped` (n, 2) int32 [pixels / 4096] where `state` (n,) is PASSES.
    """
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        a = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + shift[0]
        b = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + shift[1]
        c = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + shift[2]
        seen[i, 0], seen[i, 1], seen[i, 2] = a, b, c
        state[i] = BEHIND
        if c >= NEAR_PLANE:
            u, v = lens.fx * a / c + lens.cx, lens.fy * b / c + lens.cy
            state[i] = FAR_OUT
            if abs(u) <= UNCLIPPED_LIMIT and abs(v) <= UNCLIPPED_LIMIT:
                state[i] = PASSES
                snapped[i, 0], snapped[i, 1] = round(u * SNAP), round(v * SNAP)


@compiled
def prepare_triangles(lens, faces, first, seen, snapped, state, batch, cut):
    """Write to `batch` the faces (m, 3) that can hold a pixel centre, to `cut` those that must be cut first.

    `first` is the number of faces[0] among all faces. Returns how many stand in `batch` and in `cut`.
    """
    corners, planes, rows, numbers = batch
    kept, crossing = 0, 0
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        if state[i] == PASSES and state[j] == PASSES and state[k] == PASSES:
            if _set_corners(lens, snapped, i, j, k, corners, rows, kept):
                _set_plane(lens, seen, i, j, k, planes, kept)
                numbers[kept] = first + f
                kept += 1
        elif state[i] != BEHIND or state[j] != BEHIND or state[k] != BEHIND:
            cut[crossing] = f
            crossing += 1
    return kept, crossing


@compiled
def prepare_clipped(lens, cut, faces, first, seen, batch):
    """Like `prepare`, for the faces that `cut` lists: clip each to the space that the camera can project.

    A clipped triangle has up to 8 corners, so `batch` must hold 6 triangles a face. Returns how many it got.
    """
    bounds = np.array((
        (0.0, 0.0, 1.0, -NEAR_PLANE),
        (lens.fx, 0.0, CLIP_LIMIT + lens.cx, 0.0), (-lens.fx, 0.0, CLIP_LIMIT - lens.cx, 0.0),
        (0.0, lens.fy, CLIP_LIMIT + lens.cy, 0.0), (0.0, -lens.fy, CLIP_LIMIT - lens.cy, 0.0),
    ))  # fmt: skip
    polygon, spare = np.empty((9, 3)), np.empty((9, 3))
    uv = np.empty((9, 2), np.int32)
    corners, planes, rows, numbers = batch
    kept = 0
    for f in cut:
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        polygon[0], polygon[1], polygon[2] = seen[i], seen[j], seen[k]
        sides = _clip_polygon(polygon, spare, bounds)
        for s in range(sides):
            uv[s, 0] = round((lens.fx * polygon[s, 0] / polygon[s, 2] + lens.cx) * SNAP)
            uv[s, 1] = round((lens.fy * polygon[s, 1] / polygon[s, 2] + lens.cy) * SNAP)
        for s in range(1, sides - 1):
            if _set_corners(lens, uv, 0, s, s + 1, corners, rows, kept):
                _set_plane(lens, seen, i, j, k, planes, kept)
                numbers[kept] = first + f
                kept += 1
    return kept


@compiled
def fill_band(top, batch, count, inverse, winner):
    """Draw the first `count` triangles into the band of rows that begins at `top`.

    `inverse` (rows, W) is 1/depth [1/m], 0 where nothing was seen; `winner` (rows, W) int32 the face there.
    The nearer surface wins; at equal depth the one drawn first.
    """
    height, width = inverse.shape
    corners, planes, rows, numbers = batch
    for t in range(count):
        if rows[t, 1] < top or rows[t, 0] >= top + height:
            continue
        x0, y0 = np.int64(corners[t, 0]), np.int64(corners[t, 1])
        x1, y1 = np.int64(corners[t, 2]), np.int64(corners[t, 3])
        x2, y2 = np.int64(corners[t, 4]), np.int64(corners[t, 5])
        start = max(-((-min(x0, x1, x2)) >> SNAP_BITS), 0)
        stop = min(max(x0, x1, x2) >> SNAP_BITS, width - 1)
        for y in range(max(rows[t, 0], top), min(rows[t, 1] + 1, top + height)):
            left, right = _span(x0, y0, x1, y1, y, start, stop)
            left, right = _span(x1, y1, x2, y2, y, left, right)
            left, right = _span(x2, y2, x0, y0, y, left, right)
            base = planes[t, 0] + planes[t, 2] * y
            for x in range(left, right + 1):
                value = min(max(base + planes[t, 1] * x, planes[t, 3]), planes[t, 4])
                if value > inverse[y - top, x]:
                    inverse[y - top, x] = value
                    winner[y - top, x] = numbers[t]


@compiled
def resolve_band(inverse, winner, body_of, first_of, depth, ids, faces):
    """Turn a filled band into depth [m], body number + 1 and the number of the face within its body."""
    for y in range(inverse.shape[0]):
        for x in range(inverse.shape[1]):
            if inverse[y, x] > 0:
                body = body_of[winner[y, x]]
                depth[y, x] = 1 / inverse[y, x]
                ids[y, x] = body + 1
                faces[y, x] = winner[y, x] - first_of[body]


@compiled
def _set_corners(lens, snapped, i, j, k, corners, rows, at):
    """Store triangle i, j, k as number `at`, turned clockwise; False when no pixel centre can lie in it."""
    x0, y0 = np.int64(snapped[i, 0]), np.int64(snapped[i, 1])
    x1, y1 = np.int64(snapped[j, 0]), np.int64(snapped[j, 1])
    x2, y2 = np.int64(snapped[k, 0]), np.int64(snapped[k, 1])
    left = -((-min(x0, x1, x2)) >> SNAP_BITS)
    right = max(x0, x1, x2) >> SNAP_BITS
    top = -((-min(y0, y1, y2)) >> SNAP_BITS)
    bottom = max(y0, y1, y2) >> SNAP_BITS
    if left > right or top > bottom or right < 0 or bottom < 0 or left >= lens.width or top >= lens.height:
        return False
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    if area == 0:
        return False
    if area < 0:
        x1, y1, x2, y2 = x2, y2, x1, y1
    corners[at, 0], corners[at, 1], corners[at, 2] = x0, y0, x1
    corners[at, 3], corners[at, 4], corners[at, 5] = y1, x2, y2
    rows[at, 0], rows[at, 1] = max(top, 0), min(bottom, lens.height - 1)
    return True


@compiled
def _set_plane(lens, seen, i, j, k, planes, at):
    """Store 1/depth over the image of the plane through points i, j, k, and its bounds at these corners.

    The bounds matter for triangles seen edge on, where snapping may move a pixel off the true triangle.
    """
    x, y, z = seen[i, 0], seen[i, 1], seen[i, 2]
    p, q, r = seen[j, 0] - x, seen[j, 1] - y, seen[j, 2] - z
    s, t, w = seen[k, 0] - x, seen[k, 1] - y, seen[k, 2] - z
    nx, ny, nz = q * w - r * t, r * s - p * w, p * t - q * s
    scale = 1 / (nx * x + ny * y + nz * z)
    along_u, along_v = nx * scale / lens.fx, ny * scale / lens.fy
    origin = nz * scale - along_u * lens.cx - along_v * lens.cy
    nearest, farthest = max(z + min(r, w, 0.0), NEAR_PLANE), z + max(r, w, 0.0)
    planes[at, 3], planes[at, 4] = 1 / farthest, 1 / nearest
    if math.isfinite(origin + along_u + along_v):
        planes[at, 0], planes[at, 1], planes[at, 2] = origin, along_u, along_v
    else:  # seen exactly edge on: no plane to read, its nearest corner will do
        planes[at, 0], planes[at, 1], planes[at, 2] = planes[at, 4], 0.0, 0.0


@compiled
def _span(x0, y0, x1, y1, y, left, right):
    """Narrow the columns left .. right of row y to those on the inner side of the edge from 0 to 1.

    A column x is in when dx (y - y0) - dy (x - x0) > 0, or = 0 on a left or a top edge.
    """
    dx, dy = x1 - x0, y1 - y0
    value = dx * ((y << SNAP_BITS) - y0) + dy * x0
    if not (dy < 0 or (dy == 0 and dx > 0)):
        value -= 1
    if dy > 0:
        right = min(right, _floor_divide(value, dy << SNAP_BITS))
    elif dy < 0:
        left = max(left, -_floor_divide(value, -dy << SNAP_BITS))
    elif value < 0:
        right = left - 1
    return left, right


@compiled
def _floor_divide(value, divisor):
    """Exact floor(value / divisor) for divisor > 0, by the quotient of floats, off by one at most."""
    quotient = np.int64(math.floor(np.float64(value) / np.float64(divisor)))
    rest = value - quotient * divisor
    if rest < 0:
        quotient -= 1
    elif rest >= divisor:
        quotient += 1
    return quotient


@compiled
def _clip_polygon(polygon, spare, bounds):
    """Cut a triangle, in place, to the points p with bounds . (p, 1) >= 0; return its number of corners."""
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
                # Always from the inside out: both triangles at this edge get the same corner, bit for bit.
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
