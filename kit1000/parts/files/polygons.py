"""Polygons of any number of corners as triangles: those that are not convex are cut up exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from manifold3d import triangulate

CONVEX = 1e-9  # smallest turn at a corner of a convex polygon, as a share of its area


def triangles_of(vertices: np.ndarray, polygons: np.ndarray | Sequence[Sequence[int]]) -> np.ndarray:
    """(m, 3) int64 the triangles of polygons, by the order of their numbers of corners; fewer than 3 give none.

    Args:
        vertices: (n, 3)
        polygons: indices of their corners, in order; each one all of `vertices`.
    """
    if isinstance(polygons, np.ndarray):
        return _of_equal(vertices, polygons)
    by_length: dict[int, list[Sequence[int]]] = {}
    for polygon in polygons:
        by_length.setdefault(len(polygon), []).append(polygon)
    groups = [np.array(by_length[length], dtype=np.int64) for length in sorted(by_length) if length >= 3]
    return np.concatenate([np.zeros((0, 3), dtype=np.int64), *(_of_equal(vertices, group) for group in groups)])


def _of_equal(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """The triangles of polygons (k, c) of equal numbers of corners."""
    corners = polygons.shape[1]
    if corners <= 3:
        return polygons.astype(np.int64).reshape(-1, 3) if corners == 3 else np.zeros((0, 3), dtype=np.int64)
    points = vertices[polygons]
    ahead, behind = np.roll(points, -1, axis=1), np.roll(points, 1, axis=1)
    centred = points - points[:, :1]
    normals = np.cross(centred, np.roll(centred, -1, axis=1)).sum(1)  # by Newell: twice the area in length
    turns = (np.cross(points - behind, ahead - points) * normals[:, None]).sum(-1)
    area = (normals**2).sum(-1)
    with np.errstate(invalid="ignore"):
        convex = (turns > CONVEX * area[:, None]).all(1) | ~(area > 0)
    fans = polygons[convex]
    pieces = [np.stack([fans[:, 0], fans[:, k], fans[:, k + 1]], axis=1) for k in range(1, corners - 1)]
    pieces += [
        _cut_up(vertices, polygon, normal) for polygon, normal in zip(polygons[~convex], normals[~convex], strict=True)
    ]
    return np.concatenate([np.zeros((0, 3), dtype=np.int64), *pieces])


def _cut_up(vertices: np.ndarray, polygon: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The triangles of a polygon that is not convex, cut up as seen along its normal's longest axis."""
    axis = int(np.argmax(np.abs(normal)))
    seen = vertices[polygon][:, [(axis + 1) % 3, (axis + 2) % 3]]
    order = np.arange(len(polygon)) if normal[axis] > 0 else np.arange(len(polygon))[::-1]
    size = np.ptp(seen, axis=0).max()
    if not np.isfinite(size) or size == 0:
        return np.stack([np.repeat(polygon[0], len(polygon) - 2), polygon[1:-1], polygon[2:]], axis=1)
    scaled = (seen[order] - seen.min(0)) / size
    found = np.asarray(triangulate([np.ascontiguousarray(scaled)]), dtype=np.int64)
    triangles = polygon[order][found]
    return triangles if normal[axis] > 0 else triangles[:, ::-1]
