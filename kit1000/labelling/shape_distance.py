"""How far apart two poses of one shape are, whatever its symmetry: by its surface, not by its axes."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from kit1000.mesh import Mesh, surface_points
from kit1000.pose import Pose
from kit1000.rng import stream

DENSE, SPARSE = 6000, 600  # points of a surface that are searched, and that are looked up
FARTHEST = 98  # percent of the points: single ones of a sparse surface may lie farther from their neighbours


class ShapeDistance:
    """The distance between poses of one shape: up to its symmetries, and those that no one declared."""

    def __init__(self, mesh: Mesh) -> None:
        """Prepare a mesh, in its own frame."""
        points = surface_points(mesh, DENSE, stream(0, "labelling", "surface"))
        self._tree, self._points = KDTree(points), points[:SPARSE]
        self._spacing = self._far(self._points + 1e-12, 2)

    def between(self, a: Pose, b: Pose) -> float:
        """[m] from the surface at one pose to that at the other, nearly the largest; 0 where they coincide."""
        moved = (a.inverse() @ b).apply(self._points)
        return max(self._far(moved, 1) - self._spacing, 0.0)

    def _far(self, points: np.ndarray, rank: int) -> float:
        """[m] to the neighbour of a rank, nearly the largest."""
        distances = np.reshape(self._tree.query(points, k=rank)[0], (len(points), rank))
        return float(np.percentile(distances[:, -1], FARTHEST))
