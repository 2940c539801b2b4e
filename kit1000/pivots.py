"""The pivot of a part: the centre of the extents of its masked depth points, which any method may compute."""

from __future__ import annotations

import numpy as np

from kit1000.values import FIRST_PART_LABEL, View

PIVOT_DECIMALS = 4  # of a metre: 0.1 mm, about the step of depth images


def part_pivots(view: View, labels: np.ndarray) -> dict[int, np.ndarray]:
    """The pivots of parts by part index: (3,) [m] world, the centre of the extents of the part's points, to 0.1 mm.

    The points use the recorded pose of the view; a part without a return has no pivot. labels: (H, W) uint8.
    """
    pivots = {}
    for part in range(int(labels.max()) + 1 - FIRST_PART_LABEL):
        centre = extent_centre(view, labels == FIRST_PART_LABEL + part)
        if centre is not None:
            pivots[part] = np.round(centre, PIVOT_DECIMALS) + 0.0  # never minus zero
    return pivots


def extent_centre(view: View, mask: np.ndarray) -> np.ndarray | None:
    """(3,) [m] world: the centre of the extents of the points of a mask (H, W) bool; None without a return."""
    pixels = np.flatnonzero(mask)
    pixels = pixels[view.depth.ravel()[pixels] > 0]
    if len(pixels) == 0:
        return None
    v, u = np.divmod(pixels, view.camera.width)
    points = view.camera.unproject_pixels(np.stack([u, v], axis=-1), view.depth[v, u])
    points = view.world_from_camera.apply(points)
    return (points.min(0) + points.max(0)) / 2
