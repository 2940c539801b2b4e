"""Shading of a depth image with masks and nothing else: normals, light, shadows, and lines where surfaces end.

Every number comes from additions, multiplications, divisions and square roots of float64 in a fixed order. All
processors round these alike, so the picture of an image has the same bytes everywhere.
"""

from __future__ import annotations

import numpy as np

from kit1000.camera import Camera
from kit1000.dataset.schema import PREVIEW_STEP
from kit1000.numerics.compiled import compiled

CELL = PREVIEW_STEP  # [px] side of the blocks of the image that become one pixel of the picture, a cell
SURFACE_STEP = 0.02  # largest relative step of depth between cells of one surface
LINE_STEP = 0.004  # relative departure from the plane through both neighbours beyond which a line is drawn
TILE = 8  # [cells] side of the tiles by which the bare table is left out
TILES_BELOW = 9  # tiles to the right of a body and below it that its shadow can reach
KEY_LIGHT = np.array((-0.55, -0.62, -0.56))  # towards the light, in the camera frame: from the upper left
SKY = np.array((0.0, -0.6, -0.8))  # towards the sky
KEY_SHARE, SKY_SHARE, BOUNCE_SHARE = 0.62, 0.46, 0.12  # of the light: facing the lamp, the sky, or anything
SHADOW = 0.75  # of the key light that a shadow takes away
SHADOW_STEPS, SHADOW_REACH = 25, 0.1  # points along a ray towards the light, and its length [m]
SHADOW_OFFSET, SHADOW_GAP = 0.0015, 0.001  # [m] start of the ray above its surface, and depth behind a body that counts
BODY_DEPTH = 0.1  # [m] a ray farther behind a surface passes behind the body
CORNER = 2.8  # darkening of the sky by surroundings
CORNER_REACH = 0.025  # [m] from which on surroundings matter little
CORNER_BIAS = 0.12  # sine of the elevation below which they do not count
_RING = np.array([(10, 0), (7, 7), (0, 10), (-7, 7), (-10, 0), (-7, -7), (0, -10), (7, -7)])  # in tenths
CORNER_OFFSETS = np.concatenate([_RING * radius // 10 for radius in (3, 9)])  # [cells] (16, 2)


def relief_light(camera: Camera, depth: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """The light on the surfaces of a depth image, (H // CELL, W // CELL) float64, about 1 in the open; 0 at holes.

    Args:
        camera: its intrinsics.
        depth: (H, W) [m], 0 for no return.
        labels: (H, W) uint8; 0 is one plane, the table, and surfaces of other labels are told apart.
    """
    intrinsics = (camera.fx / CELL, camera.fy / CELL, (camera.cx + 0.5) / CELL - 0.5, (camera.cy + 0.5) / CELL - 0.5)
    inverse, kinds = _cells(depth, labels)
    normals = _normals(inverse, kinds, _planes(inverse, kinds), *intrinsics)
    points = _points(inverse, *intrinsics)
    near = _near_bodies(kinds)
    shadows = _shadows(points, normals, near, KEY_LIGHT, *intrinsics)
    return _light(points, normals, near, shadows, KEY_LIGHT, SKY, CORNER_OFFSETS)


@compiled
def line_cover(depth, labels):
    """How much of each cell the lines cover that separate surfaces. (H // CELL, W // CELL) float64, 0 .. 1."""
    height, width = depth.shape[0] // CELL, depth.shape[1] // CELL
    cover = np.zeros((height, width))
    for y in range(1, CELL * height - 1):
        for x in range(1, CELL * width - 1):
            here, kind, found = depth[y, x], labels[y, x], False
            for dy, dx in ((0, 1), (1, 0)):
                after, before = depth[y + dy, x + dx], depth[y - dy, x - dx]
                if labels[y + dy, x + dx] != kind or labels[y - dy, x - dx] != kind:
                    found = True
                elif kind > 0 and here > 0 and after > 0 and before > 0:
                    sum_of_both = after + before  # inverse depth is linear over a plane
                    found = found or abs(2.0 * after * before - here * sum_of_both) > LINE_STEP * here * sum_of_both
            if found:
                cover[y // CELL, x // CELL] += 1 / (CELL * CELL)
    return cover


@compiled
def _cells(depth, labels):
    """Inverse depth [1/m] of each cell, 0 at holes, and its label: of the nearest surface in it."""
    height, width = depth.shape[0] // CELL, depth.shape[1] // CELL
    inverse, kinds = np.zeros((height, width)), np.zeros((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            nearest, kind = np.inf, 0
            for y in range(CELL * v, CELL * v + CELL):
                for x in range(CELL * u, CELL * u + CELL):
                    if 0 < depth[y, x] < nearest:
                        nearest, kind = float(depth[y, x]), labels[y, x]
            total, count = 0.0, 0
            for y in range(CELL * v, CELL * v + CELL):
                for x in range(CELL * u, CELL * u + CELL):
                    z = float(depth[y, x])
                    if z > 0 and labels[y, x] == kind and z - nearest <= SURFACE_STEP * nearest:
                        total, count = total + 1 / z, count + 1
            if count > 0:
                inverse[v, u], kinds[v, u] = total / count, kind
    return inverse, kinds


@compiled
def _planes(inverse, kinds):
    """The planes of inverse depth about each cell: slopes along u and v, value, mean square error. (H, W, 4)

    By least squares over the 3 x 3 cells of the same surface; the error is infinite where they determine none. The
    table has one plane.
    """
    height, width = inverse.shape
    planes, sums = np.empty((height, width, 4)), np.zeros(10)
    for v in range(0, height, 4):
        for u in range(0, width, 4):
            if kinds[v, u] == 0 and inverse[v, u] > 0:
                _add(sums, u, v, inverse[v, u])
    table = _fit(sums)
    for v in range(height):
        for u in range(width):
            here, kind, plane = inverse[v, u], kinds[v, u], planes[v, u]
            if kind == 0:
                plane[0], plane[1], plane[2], plane[3] = table[0], table[1], table[2] + table[0] * u + table[1] * v, 0.0
                continue
            sums[:] = 0.0
            for y in range(max(v - 1, 0), min(v + 2, height)):
                for x in range(max(u - 1, 0), min(u + 2, width)):
                    if kinds[y, x] == kind and abs(inverse[y, x] - here) <= SURFACE_STEP * here:
                        _add(sums, x - u, y - v, inverse[y, x] - here)
            plane[0], plane[1], value, plane[3] = _fit(sums)
            plane[2] = here + value
    return planes


@compiled
def _add(sums, u, v, w):
    """Add a value w at (u, v) to the sums of a least squares plane."""
    sums[0] += 1.0
    sums[1] += u
    sums[2] += v
    sums[3] += w
    sums[4] += u * u
    sums[5] += v * v
    sums[6] += u * v
    sums[7] += w * u
    sums[8] += w * v
    sums[9] += w * w


@compiled
def _fit(sums):
    """The plane of such sums: slopes along u and v, value at (0, 0), mean square error; infinite for too few values."""
    n, u, v, w = sums[0], sums[1], sums[2], sums[3]
    if n < 4:
        return 0.0, 0.0, 0.0, np.inf
    uu, vv, uv = sums[4] - u * u / n, sums[5] - v * v / n, sums[6] - u * v / n
    wu, wv, ww = sums[7] - w * u / n, sums[8] - w * v / n, sums[9] - w * w / n
    determinant = uu * vv - uv * uv
    if determinant < 0.5:
        return 0.0, 0.0, 0.0, np.inf
    a, b = (wu * vv - wv * uv) / determinant, (wv * uu - wu * uv) / determinant
    return a, b, (w - a * u - b * v) / n, max(ww - a * wu - b * wv, 0.0) / n


@compiled
def _normals(inverse, kinds, planes, fx, fy, cx, cy):
    """(H, W, 3) unit normals towards the camera, 0 at holes.

    A cell takes the plane about itself or a neighbour that fits best, so creases stay sharp.
    """
    height, width = inverse.shape
    normals = np.zeros((height, width, 3))
    table = np.zeros(3)
    for v in range(height):
        for u in range(width):
            here, kind, best = inverse[v, u], kinds[v, u], np.inf
            if here > 0 and kind == 0:
                if table[2] == 0:
                    _set_normal(table, planes[v, u], u - cx, v - cy, fx, fy)
                normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = table[0], table[1], table[2]
            elif here > 0:
                plane = planes[v, u]
                for y in range(max(v - 1, 0), min(v + 2, height)):
                    for x in range(max(u - 1, 0), min(u + 2, width)):
                        if kinds[y, x] == kind and planes[y, x, 3] < best:
                            away = planes[y, x, 2] + planes[y, x, 0] * (u - x) + planes[y, x, 1] * (v - y) - here
                            error = planes[y, x, 3] + away * away
                            if error < best:
                                best, plane = error, planes[y, x]
                _set_normal(normals[v, u], plane, u - cx, v - cy, fx, fy)
    return normals


@compiled
def _set_normal(normal, plane, u, v, fx, fy):
    """Set the unit normal (3,) towards the camera of a plane whose value is that at (u, v) from the principal point.

    On the plane n . P = d the inverse depth is n . (x, y, 1) / d.
    """
    x, y, z = -plane[0] * fx, -plane[1] * fy, -(plane[2] - plane[0] * u - plane[1] * v)
    length = np.sqrt(x * x + y * y + z * z)
    normal[0], normal[1], normal[2] = x / length, y / length, z / length


@compiled
def _points(inverse, fx, fy, cx, cy):
    """(H, W, 3) [m] the point of each cell in the camera frame; 0 at holes."""
    height, width = inverse.shape
    points = np.zeros((height, width, 3))
    for v in range(height):
        for u in range(width):
            if inverse[v, u] > 0:
                z = 1 / inverse[v, u]
                points[v, u, 0], points[v, u, 1], points[v, u, 2] = (u - cx) / fx * z, (v - cy) / fy * z, z
    return points


@compiled
def _near_bodies(kinds):
    """(H // TILE + 1, W // TILE + 1) uint8: 2 for tiles close to a body, 1 for others that its shadow can reach."""
    height, width = kinds.shape
    rows, columns = height // TILE + 1, width // TILE + 1
    near, full = np.zeros((rows, columns), np.uint8), np.zeros((rows, columns), np.bool_)
    for v in range(height):
        for u in range(width):
            if kinds[v, u] > 0:
                full[v // TILE, u // TILE] = True
    for row in range(rows):
        for column in range(columns):
            if full[row, column]:
                for y in range(max(row - 2, 0), min(row + TILES_BELOW, rows)):
                    for x in range(max(column - 2, 0), min(column + TILES_BELOW, columns)):
                        near[y, x] = max(near[y, x], 2 if y < row + 3 and x < column + 3 else 1)
    return near


@compiled
def _shadows(points, normals, near, light, fx, fy, cx, cy):
    """(H, W) 1 where a body stands between a cell and the light (3,), by points along the ray; else 0."""
    height, width = points.shape[:2]
    shadows = np.zeros((height, width))
    front = np.inf  # depth [m] of the nearest point: rays in front of it are free
    for v in range(height):
        for u in range(width):
            if 0 < points[v, u, 2] < front:
                front = points[v, u, 2]
    step = SHADOW_REACH / SHADOW_STEPS
    for v in range(height):
        for u in range(width):
            point, normal = points[v, u], normals[v, u]
            if point[2] == 0 or not near[v // TILE, u // TILE]:
                continue
            if normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2] <= 0:
                continue  # dark without a shadow
            x = point[0] + SHADOW_OFFSET * normal[0]
            y = point[1] + SHADOW_OFFSET * normal[1]
            z = point[2] + SHADOW_OFFSET * normal[2]
            for _ in range(SHADOW_STEPS):
                x, y, z = x + step * light[0], y + step * light[1], z + step * light[2]
                if z < front:
                    break
                column, row = int(fx * x / z + cx + 0.5), int(fy * y / z + cy + 0.5)
                if column < 0 or row < 0 or column >= width or row >= height:
                    break
                behind = z - points[row, column, 2]
                if points[row, column, 2] > 0 and SHADOW_GAP < behind < BODY_DEPTH:
                    shadows[v, u] = 1.0
                    break
    return shadows


@compiled
def _light(points, normals, near, shadows, key, sky, offsets):
    """(H, W) the light on every cell, from the directions (3,) of the lamp and the sky; 0 at holes."""
    height, width = points.shape[:2]
    light = np.zeros((height, width))
    for v in range(height):
        for u in range(width):
            if points[v, u, 2] == 0:
                continue
            normal, shadow, unseen = normals[v, u], 0.0, 0.0
            close = near[v // TILE, u // TILE]
            if close == 2:
                unseen = min(CORNER * _surroundings(points, normal, u, v, offsets) / len(offsets), 0.85)
            if close > 0:
                for y in range(max(v - 1, 0), min(v + 2, height)):
                    for x in range(max(u - 1, 0), min(u + 2, width)):
                        shadow += SHADOW / 9 * shadows[y, x]
            facing_key = max(normal[0] * key[0] + normal[1] * key[1] + normal[2] * key[2], 0.0)
            facing_sky = 0.5 + 0.5 * (normal[0] * sky[0] + normal[1] * sky[1] + normal[2] * sky[2])
            open_sky = (SKY_SHARE * facing_sky + BOUNCE_SHARE) * (1 - unseen)
            light[v, u] = open_sky + KEY_SHARE * facing_key * (1 - shadow) * (1 - 0.5 * unseen)
    return light


@compiled
def _surroundings(points, normal, u, v, offsets):
    """How much of the sky over the cell (u, v) its surroundings take: a sum over the cells at the offsets (n, 2)."""
    height, width = points.shape[:2]
    here, taken = points[v, u], 0.0
    for k in range(offsets.shape[0]):
        x, y = u + offsets[k, 0], v + offsets[k, 1]
        if x < 0 or y < 0 or x >= width or y >= height or points[y, x, 2] == 0:
            continue
        dx, dy, dz = points[y, x, 0] - here[0], points[y, x, 1] - here[1], points[y, x, 2] - here[2]
        rise = dx * normal[0] + dy * normal[1] + dz * normal[2]
        if rise > 0:
            square = dx * dx + dy * dy + dz * dz
            sine = rise / np.sqrt(square)
            if sine > CORNER_BIAS:
                taken += (sine - CORNER_BIAS) / (1 + square / (CORNER_REACH * CORNER_REACH))
    return taken
