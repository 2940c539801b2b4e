"""Shadow maps: images of the depth of a scene from lamps so far away that their rays are parallel."""

from __future__ import annotations

import numpy as np

from kit1000.numerics.compiled import compiled

SLACK = 1e-6  # [px] by which a triangle is widened, so that none of its border is lost between two


def shadow_maps(corners: np.ndarray, map_from_world: np.ndarray, size: int) -> np.ndarray:
    """(L, size, size) float32 [m] depth of the nearest of triangles (m, 3, 3), 0 where there is none.

    map_from_world: (L, 3, 4) of each lamp, from a point (x, y, z, 1) to column, row [px] and depth [m].
    """
    maps = np.zeros((len(map_from_world), size, size), np.float32)
    _fill(np.ascontiguousarray(corners), np.ascontiguousarray(map_from_world), maps)
    return maps


@compiled
def _fill(corners, map_from_world, maps):
    height, width = maps.shape[1], maps.shape[2]
    u, v, w = np.empty(3), np.empty(3), np.empty(3)
    for k in range(maps.shape[0]):
        for t in range(corners.shape[0]):
            for i in range(3):
                x, y, z = corners[t, i, 0], corners[t, i, 1], corners[t, i, 2]
                m = map_from_world
                u[i] = m[k, 0, 0] * x + m[k, 0, 1] * y + m[k, 0, 2] * z + m[k, 0, 3]
                v[i] = m[k, 1, 0] * x + m[k, 1, 1] * y + m[k, 1, 2] * z + m[k, 1, 3]
                w[i] = m[k, 2, 0] * x + m[k, 2, 1] * y + m[k, 2, 2] * z + m[k, 2, 3]
            top = max(np.ceil(min(v[0], v[1], v[2]) - SLACK), 0.0)
            bottom = min(np.floor(max(v[0], v[1], v[2]) + SLACK), height - 1.0)
            if top > bottom:
                continue
            area = (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0])
            if area == 0.0:
                continue
            along = ((w[1] - w[0]) * (v[2] - v[0]) - (w[2] - w[0]) * (v[1] - v[0])) / area
            down = ((u[1] - u[0]) * (w[2] - w[0]) - (u[2] - u[0]) * (w[1] - w[0])) / area
            nearest, farthest = min(w[0], w[1], w[2]), max(w[0], w[1], w[2])
            for row in range(int(top), int(bottom) + 1):
                left, right = np.inf, -np.inf
                for i in range(3):
                    j = (i + 1) % 3
                    if min(v[i], v[j]) <= row + SLACK and max(v[i], v[j]) >= row - SLACK:
                        across = u[j] - u[i]
                        share = 0.0
                        if v[i] != v[j]:
                            share = min(max((row - v[i]) / (v[j] - v[i]), 0.0), 1.0)
                        else:
                            left, right = min(left, u[j]), max(right, u[j])
                        left, right = min(left, u[i] + share * across), max(right, u[i] + share * across)
                first, last = max(np.ceil(left - SLACK), 0.0), min(np.floor(right + SLACK), width - 1.0)
                if first > last:
                    continue
                base = w[0] + down * (row - v[0]) - along * u[0]
                for column in range(int(first), int(last) + 1):
                    depth = min(max(base + along * column, nearest), farthest)
                    if maps[k, row, column] == 0 or depth < maps[k, row, column]:
                        maps[k, row, column] = depth
