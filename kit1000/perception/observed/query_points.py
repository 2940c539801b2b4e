"""The points that a depth image shows, in the world."""

from __future__ import annotations

import numpy as np

from kit1000.values import Query


def observed_points(query: Query, mask: np.ndarray, most: int | None = None) -> np.ndarray:
    """(n, 3) float64 [m] world: the points of the pixels of a mask (H, W) that have a return, row by row.

    With `most`, every k-th of them, so that there are no more than that.
    """
    view = query.view
    v, u = np.nonzero(mask & (view.depth > 0))
    if most is not None:
        step = -(-len(v) // most) or 1
        v, u = v[::step], u[::step]
    points = view.camera.unproject_pixels(np.stack([u, v], axis=-1), view.depth[v, u])
    return view.world_from_camera.apply(points)
