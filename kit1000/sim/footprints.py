"""Footprints: the convex outlines of bodies from above, and the distance between two."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import matmul
from kit1000.pose import Pose


def footprint(mesh: Mesh, world_from_body: Pose) -> np.ndarray:
    """(n, 2) [m]: the convex outline of a body from above, counter-clockwise."""
    points = world_from_body.apply(mesh.vertices)[:, :2]
    return points[ConvexHull(points).vertices]


def centroid(outline: np.ndarray) -> np.ndarray:
    """(2,) [m] the centre of the area of a convex outline (n, 2): within it, whatever the vertices on its edges."""
    start = outline[0]  # of all triangles, so that no sum is much larger than its result
    a, b = outline[1:-1] - start, outline[2:] - start
    doubled = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return start + (doubled[:, None] * (a + b)).sum(0) / (3 * doubled.sum())


def footprint_distance(a: np.ndarray, b: np.ndarray) -> float:
    """[m] between two convex outlines (n, 2) and (m, 2), counter-clockwise; 0 if they intersect."""
    if max(_separating_gap(a, b), _separating_gap(b, a)) <= 0:
        return 0.0
    return min(_distance_to_edges(a, b), _distance_to_edges(b, a))


def _separating_gap(a: np.ndarray, b: np.ndarray) -> float:
    """The widest gap along the normal of an edge of `a` [m]; if a and b overlap, no edge of either has a gap."""
    edges = np.roll(a, -1, axis=0) - a
    outward = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
    return float((matmul(b, outward.T).min(0) - (a * outward).sum(1)).max())


def _distance_to_edges(points: np.ndarray, outline: np.ndarray) -> float:
    """[m] from the nearest of points (n, 2) to the nearest edge of an outline (m, 2)."""
    edges = np.roll(outline, -1, axis=0) - outline
    offset = points[:, None] - outline
    share = np.clip((offset * edges).sum(2) / (edges**2).sum(1), 0, 1)
    return float(np.linalg.norm(offset - share[..., None] * edges, axis=2).min())
