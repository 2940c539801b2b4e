"""The faces of a solid that look down: what it rests on and what it leaves above itself when it moves up."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from kit1000.mesh import mesh_from_solid

WALL_COSINE = 2e-4  # faces whose unit normal has a smaller -z are walls: they sweep no more than their edges do
LEVEL_TOLERANCE = 2e-6  # [m] a face of a smaller extent along z is level


def downward_faces(solid: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Down-facing triangles (m, 3, 3) and which of them are level, these flattened to their lowest corner."""
    mesh = mesh_from_solid(solid)
    triangles = mesh.triangles[mesh.normals[:, 2] < -WALL_COSINE].copy()
    level = np.ptp(triangles[..., 2], axis=1) < LEVEL_TOLERANCE
    heights = np.sort(triangles[level][..., 2].min(1))
    lowest = heights[np.diff(heights, prepend=-np.inf) > LEVEL_TOLERANCE]
    if len(lowest):
        own = np.searchsorted(lowest, triangles[level][..., 2].min(1), side="right") - 1
        flattened = np.broadcast_to(lowest[own][:, None, None], (len(own), 3, 1))
        triangles[level] = np.concatenate([triangles[level][..., :2], flattened], axis=2)
    return triangles, level
