"""The pivot of a part: the middle of its masked depth points without the outer tenths, which any method may compute.

A depth sensor smears edges over several pixels: near the border of a mask some depths belong to the table or to another
part. The mask is therefore eroded, and the tenth of the points at either end of each axis is left out.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_erosion, find_objects

from kit1000.values import FIRST_PART_LABEL, View

PIVOT_DECIMALS = 4  # of a metre: 0.1 mm, about the step of depth images
POINT_DECIMALS = 6  # of a metre, before points are put in order
LEFT_OUT = 10  # percent of the points at either end of an axis
EROSION = 3  # times: half of the sensor's largest fattening of edges
LEAST_LEFT = (2, 5)  # share of a mask that erosion leaves at least, as a fraction; thin parts are eroded less
NEIGHBOURS = np.ones((3, 3), bool)


def part_pivots(view: View, labels: np.ndarray) -> dict[int, np.ndarray]:
    """The pivots of parts by part index: (3,) [m] world, to 0.1 mm; a part without a return has none.

    The points use the recorded pose of the view. labels: (H, W) uint8, see `kit1000.values.LabelledDepth`.
    """
    pivots = {}
    for label, box in enumerate(find_objects(labels), start=1):
        if label < FIRST_PART_LABEL or box is None:
            continue
        mask = labels[box] == label
        pixels = np.argwhere(_eroded(mask) & (view.depth[box] > 0))
        if len(pixels) == 0:
            pixels = np.argwhere(mask & (view.depth[box] > 0))
        if len(pixels) > 0:
            rows, columns = (pixels + [box[0].start, box[1].start]).T
            middle = _middle(_world_points(view, rows, columns))
            pivots[label - FIRST_PART_LABEL] = np.round(middle, PIVOT_DECIMALS) + 0.0  # never minus zero
    return pivots


def extent_centre(view: View, mask: np.ndarray) -> np.ndarray | None:
    """(3,) [m] world: the centre of the extents of the points of a mask (H, W) bool; None without a return."""
    rows, columns = np.nonzero(mask & (view.depth > 0))
    if len(rows) == 0:
        return None
    points = _world_points(view, rows, columns)
    return (points.min(0) + points.max(0)) / 2


def _eroded(mask: np.ndarray) -> np.ndarray:
    """A mask (h, w) bool without its border of EROSION pixels, or of fewer if less than LEAST_LEFT would remain."""
    part, whole = LEAST_LEFT
    eroded = mask
    for _ in range(EROSION):
        smaller = binary_erosion(eroded, NEIGHBOURS)
        if whole * np.count_nonzero(smaller) < part * np.count_nonzero(mask):
            break
        eroded = smaller
    return eroded


def _middle(points: np.ndarray) -> np.ndarray:
    """(3,) the middle between the two ends of points (n, 3) along each axis, without LEFT_OUT percent at either end."""
    first = (len(points) - 1) * LEFT_OUT // 100
    last = len(points) - 1 - first
    ordered = np.partition(np.round(points, POINT_DECIMALS), sorted({first, last}), axis=0)
    return (ordered[first] + ordered[last]) / 2


def _world_points(view: View, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(n, 3) [m] world: the points of pixels with a return."""
    points = view.camera.unproject_pixels(np.stack([columns, rows], axis=-1), view.depth[rows, columns])
    return view.world_from_camera.apply(points)
