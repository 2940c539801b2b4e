"""Intersections of triangles and distances to surfaces: a tree of boxes finds near pairs, exact tests decide.

Arrays of triangles are (n, 3, 3) float64; every length is in the unit of the coordinates. Triangles that touch do not
cross: an edge must pass through a face by more than a tolerance on both sides, and inside its boundary.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

BOXES_PER_QUERY = 2048  # boxes queried at once: few enough for arrays of their pairs that stay in the cache
MORTON_BITS = 20  # bits per axis in the sorting key: cells of a millionth of the extent


class BoxTree:
    """A complete binary tree of axis-aligned boxes, levels from the root to the leaves."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        """low, high: (n, 3) corners of the boxes."""
        self.order = np.argsort(_morton((low + high) / 2), kind="stable")
        size = 1 << max(len(low) - 1, 0).bit_length()
        lows, highs = np.full((3, size), np.inf), np.full((3, size), -np.inf)  # empty leaves overlap no box
        lows[:, : len(low)], highs[:, : len(low)] = low[self.order].T, high[self.order].T
        self.levels = [(lows, highs)]
        while lows.shape[1] > 1:
            lows, highs = np.minimum(lows[:, ::2], lows[:, 1::2]), np.maximum(highs[:, ::2], highs[:, 1::2])
            self.levels.insert(0, (lows, highs))

    def overlaps(self, low: np.ndarray, high: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield (query, box) index arrays (k,) of all overlapping pairs, some queries (m, 3) at a time."""
        low, high = np.ascontiguousarray(low.T), np.ascontiguousarray(high.T)
        for start in range(0, low.shape[1], BOXES_PER_QUERY):
            query = np.arange(start, min(start + BOXES_PER_QUERY, low.shape[1]))
            node = np.zeros(len(query), dtype=np.int64)
            for depth, (lows, highs) in enumerate(self.levels):
                if depth:
                    node, query = np.concatenate([2 * node, 2 * node + 1]), np.tile(query, 2)
                for axis in range(3):
                    keep = (lows[axis][node] <= high[axis][query]) & (highs[axis][node] >= low[axis][query])
                    node, query = node[keep], query[keep]
            yield query, self.order[node]


def crossings(triangles: np.ndarray, tolerance: float) -> np.ndarray:
    """(k, 3) points where an edge of one triangle passes through another by more than the tolerance."""
    low, high = triangles.min(1), triangles.max(1)
    normals = _unit_normals(triangles)
    points = [np.empty((0, 3))]
    for first, second in BoxTree(low, high).overlaps(low, high):
        different = first != second
        first, second = first[different], second[different]
        points.append(_edge_crossings(triangles, normals, first, second, tolerance))
    return np.concatenate(points)


def _edge_crossings(
    triangles: np.ndarray, normals: np.ndarray, face: np.ndarray, other: np.ndarray, tolerance: float
) -> np.ndarray:
    """(k, 3) points where the edges of `other` pass through `face`, both index arrays (m,)."""
    base, normal = triangles[face, 0], normals[face]
    heights = np.stack([np.einsum("mc,mc->m", triangles[other, k] - base, normal) for k in range(3)])
    across = (heights.min(0) < -tolerance) & (heights.max(0) > tolerance)
    face, other, heights = face[across], other[across], heights[:, across]
    found = []
    for start, end in ((0, 1), (1, 2), (2, 0)):
        a, b = heights[start], heights[end]
        through = (a * b < 0) & (np.minimum(np.abs(a), np.abs(b)) > tolerance)
        share = (a[through] / (a[through] - b[through]))[:, None]
        edge = triangles[other[through]]
        point = edge[:, start] + share * (edge[:, end] - edge[:, start])
        inset = _inset_distance(point, triangles[face[through]], normals[face[through]])
        found.append(point[inset > tolerance])
    return np.concatenate(found)


def _inset_distance(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(m,) distance of in-plane points (m, 3) to the nearest side of their triangle, negative outside."""
    distances = []
    for start, end in ((0, 1), (1, 2), (2, 0)):
        side = triangles[:, end] - triangles[:, start]
        inward = np.cross(normals, side)
        height = np.einsum("mc,mc->m", points - triangles[:, start], inward)
        distances.append(height / np.maximum(np.linalg.norm(side, axis=1), 1e-300))
    return np.min(distances, axis=0) if len(points) else np.empty(0)


def max_distance(points: np.ndarray, triangles: np.ndarray, reach: float) -> float:
    """Largest distance from points (n, 3) to a surface (m, 3, 3); `reach` when a point lies farther off."""
    nearest = np.full(len(points), reach)
    tree = BoxTree(triangles.min(1), triangles.max(1))
    for query, face in tree.overlaps(points - reach, points + reach):
        np.minimum.at(nearest, query, point_distances(points[query], triangles[face]))
    return float(nearest.max(initial=0.0))


def point_distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(m,) distance of each point (m, 3) to its own triangle (m, 3, 3)."""
    normals = _unit_normals(triangles)
    height = np.abs(np.einsum("mc,mc->m", points - triangles[:, 0], normals))
    above = (_inset_distance(points, triangles, normals) >= 0) & normals.any(1)
    sides = np.full(len(points), np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        side = triangles[:, end] - triangles[:, start]
        offset = points - triangles[:, start]
        share = np.einsum("mc,mc->m", offset, side) / np.maximum(np.einsum("mc,mc->m", side, side), 1e-300)
        sides = np.minimum(sides, np.linalg.norm(offset - np.clip(share, 0, 1)[:, None] * side, axis=1))
    return np.where(above, height, sides)


def _unit_normals(triangles: np.ndarray) -> np.ndarray:
    crosses = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
    return np.divide(crosses, lengths, out=np.zeros_like(crosses), where=lengths > 0)


def _morton(points: np.ndarray) -> np.ndarray:
    """(n,) uint64 keys in whose order neighbours in space are near each other (Morton 1966)."""
    span = np.maximum(np.ptp(points, axis=0).max(initial=0.0), 1e-300)
    cells = ((points - points.min(0)) / span * (2**MORTON_BITS - 1)).astype(np.uint64)
    keys = np.zeros(len(points), dtype=np.uint64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            keys |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return keys
