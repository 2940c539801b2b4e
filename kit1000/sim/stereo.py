"""Compiled loops of a triangulating depth sensor: two imagers side by side, the depth image is that of the left one.

Letters: H rows, W columns; d disparity [px], how far a surface is shifted to the left in the image of the other imager:
larger is nearer, 0 for no surface. Images are float32; disparity images are (H + 2, W + 2), with a border of zeros one
pixel wide, so that each pixel has neighbours.
"""

from __future__ import annotations

import math

import numpy as np

from kit1000.numerics.compiled import compiled

# [px] of disparity. Matching windows blend smaller steps; at larger ones the nearer surface takes the whole window.
# Also the tolerance within which two imagers see the same point.
EDGE_STEP = 1.0


@compiled
def disparity_from_depth(depth, gain):
    """`gain` [px m] / depth (H, W) [m], with the border; 0 if the depth is 0."""
    rows, columns = depth.shape
    out = np.zeros((rows + 2, columns + 2), np.float32)
    for v in range(rows):
        for u in range(columns):
            out[v + 1, u + 1] = gain / depth[v, u] if depth[v, u] > 0 else np.float32(0)
    return out


@compiled
def _smaller_slope(here, before, after):
    """The smaller of two one-sided slopes [px/px] of neighbours with a surface; 0 without any."""
    back, ahead = here - before, after - here
    if before == 0 and after == 0:
        return np.float32(0)
    if before == 0 or (after != 0 and abs(ahead) < abs(back)):
        return ahead
    return back


@compiled
def slopes(d, v, u):
    """Slope of the disparity [px/px], across and down, of the surface at row v, column u."""
    here = d[v, u]
    return _smaller_slope(here, d[v, u - 1], d[v, u + 1]), _smaller_slope(here, d[v - 1, u], d[v + 1, u])


@compiled
def _normal_cdf(normal):
    """The cumulative standard normal distribution."""
    return 0.5 * (1 + math.erf(normal / math.sqrt(2.0)))


@compiled
def occlusion_mask(d, shift):
    """Pixels (bool) whose surface is invisible to the other imager: behind a nearer one, or outside its image.

    A point at column u is at column u - d + `shift` of the other image; both images have the same size.
    """
    rows, columns = d.shape
    out = np.zeros(d.shape, np.bool_)
    for v in range(1, rows - 1):
        row = d[v]
        largest = row.max()
        leftmost = np.inf  # column in the other image, over all pixels to the right: only these can occlude this one
        for u in range(columns - 2, 0, -1):
            if row[u] > 0:
                place = u - row[u]
                inside = 0.5 <= place + shift < columns - 1.5
                out[v, u] = not inside or (leftmost <= place + 0.5 and _is_occluded(row, u, largest))
                leftmost = min(leftmost, place)
    return out


@compiled
def _is_occluded(row, u, largest):
    """Whether a surface of this row, of disparities up to `largest`, occludes column u for the other imager."""
    place = u - row[u]
    for w in range(u + 1, min(math.ceil(place + largest + 0.5), len(row) - 1)):
        if row[w] <= row[u] + EDGE_STEP:
            continue
        this = w - row[w]
        beside = w + 1 - row[w + 1]
        if abs(this - place) <= 0.5:
            return True
        if abs(row[w + 1] - row[w]) <= EDGE_STEP and (this < place) == (place < beside):  # continuous surface
            return True
    return False


@compiled
def grazing_mask(d, intrinsics, field, start, end):
    """Pixels (bool) without a return because their surface is seen at a grazing angle.

    The angle [rad] between the ray and the surface normal comes from the slope of the disparity; the probability of no
    return rises linearly from 0 at `start` to 1 at `end`. `intrinsics` is (fx, fy, cx, cy) [px]; `field` (H/2, W/2) is
    a smooth standard normal field, so that missing pixels come in patches.
    """
    fx, fy, cx, cy = intrinsics
    rows, columns = d.shape
    out = np.zeros(d.shape, np.bool_)
    cosines = np.ones(columns)
    start_cosine = math.cos(start)
    for v in range(1, rows - 1):
        y = (v - 1 - cy) / fy
        for u in range(1, columns - 1):
            across, down = slopes(d, v, u)
            x = (u - 1 - cx) / fx
            a, b = fx * across, fy * down
            c = d[v, u] - a * x - b * y  # (a, b, c) is along the normal, and its product with the ray is d
            cosines[u] = d[v, u] / math.sqrt((a * a + b * b + c * c) * (x * x + y * y + 1))
        for u in range(1, columns - 1):
            if d[v, u] > 0 and cosines[u] < start_cosine:
                probability = (math.acos(cosines[u]) - start) / (end - start)
                out[v, u] = probability >= 1 or _normal_cdf(field[(v - 1) // 2, (u - 1) // 2]) < probability
    return out
