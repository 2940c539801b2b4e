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
    """`gain` [px m] / depth (H, W) [m], with the border; 0 where the depth is 0."""
    rows, columns = depth.shape
    out = np.zeros((rows + 2, columns + 2), np.float32)
    for v in range(rows):
        for u in range(columns):
            out[v + 1, u + 1] = gain / depth[v, u] if depth[v, u] > 0 else np.float32(0)
    return out


@compiled
def depth_from_disparity(d, noise, missing, step, gain):
    """Depths (H, W) [m] from disparities plus noise (H, W) [px], rounded to steps of `step` px if not 0.

    0 where `missing`, bool with the border as d, or where there is no surface.
    """
    out = np.zeros(noise.shape, np.float32)
    for v in range(noise.shape[0]):
        for u in range(noise.shape[1]):
            value = d[v + 1, u + 1] + noise[v, u]
            if step > 0:
                value = np.rint(value / step) * step
            if d[v + 1, u + 1] > 0 and value > 0 and not missing[v + 1, u + 1]:
                out[v, u] = gain / value
    return out


@compiled
def box_blur(image, width):
    """Mean over squares of `width` (odd) x `width` px of an image (H, W) with periodic boundaries."""
    rows, columns = image.shape
    half, share = width // 2, 1 / width
    out = np.empty_like(image)
    total = np.zeros(columns)
    for k in range(-half, half + 1):
        total += image[k % rows]
    row = np.empty(columns + 2 * half, np.float32)  # column means of one row, extended at both ends
    for v in range(rows):
        incoming, outgoing = image[(v + half + 1) % rows], image[(v - half) % rows]
        for u in range(columns):
            row[half + u] = total[u] * share
            total[u] += incoming[u] - outgoing[u]
        for k in range(half):
            row[k], row[half + columns + k] = row[half + (k - half) % columns], row[half + k % columns]
        running = 0.0
        for k in range(width - 1):
            running += row[k]
        for u in range(columns):
            running += row[u + width - 1]
            out[v, u] = running * share
            running -= row[u]
    return out


@compiled
def _smaller_slope(here, before, after):
    """The smaller of two one-sided slopes [px/px], where there is a surface on that side; 0 without any."""
    back, ahead = here - before, after - here
    if before == 0:
        back = ahead
    if after == 0:
        ahead = back
    if before == 0 and after == 0:
        return np.float32(0)
    return ahead if abs(ahead) < abs(back) else back


@compiled
def _slopes(d, v, u):
    """Slope of the disparity [px/px], across and down, of the surface at row v, column u."""
    here = d[v, u]
    return _smaller_slope(here, d[v, u - 1], d[v, u + 1]), _smaller_slope(here, d[v - 1, u], d[v + 1, u])


@compiled
def _normal_cdf(normal):
    """The cumulative standard normal distribution."""
    return 0.5 * (1 + math.erf(normal / math.sqrt(2.0)))


@compiled
def _is_farther(beside, limit):
    """Whether a neighbouring pixel sees a surface of less than this disparity."""
    return (beside > 0) & (beside < limit)


@compiled
def fatten_edges(d, field, max_extension):
    """Disparities with edge fattening: near surfaces extend over the pixels of far ones beyond their edges.

    The extension is uniform in 0 to `max_extension` px; `field` (H/2, W/2) is a smooth standard normal field that
    determines it. The near surface continues with its own slope. Pixels without a surface stay empty.
    """
    rows, columns = d.shape
    out = d.copy()
    steps = np.zeros(columns, np.bool_)
    for v in range(1, rows - 1):
        above, here, below = d[v - 1], d[v], d[v + 1]
        for u in range(1, columns - 1):
            limit = here[u] - np.float32(EDGE_STEP)
            steps[u] = (
                _is_farther(here[u - 1], limit)
                | _is_farther(here[u + 1], limit)
                | _is_farther(above[u], limit)
                | _is_farther(below[u], limit)
            )
        for u in range(1, columns - 1):
            if steps[u]:
                _extend_surface(d, v, u, max_extension * _normal_cdf(field[(v - 1) // 2, (u - 1) // 2]), out)
    return out


@compiled
def _extend_surface(d, v, u, radius, out):
    """Write the surface at row v, column u to the pixels within `radius` px that see farther surfaces."""
    rows, columns = d.shape
    across, down = _slopes(d, v, u)
    whole = int(radius)
    for y in range(max(v - whole, 1), min(v + whole + 1, rows - 1)):
        for x in range(max(u - whole, 1), min(u + whole + 1, columns - 1)):
            if (x - u) ** 2 + (y - v) ** 2 > radius * radius or d[y, x] == 0:
                continue
            value = d[v, u] + across * (x - u) + down * (y - v)
            if value > d[y, x] + EDGE_STEP and value > out[y, x]:
                out[y, x] = value


@compiled
def blend_windows(d, width):
    """Disparities averaged over `width` (odd) px down, then across, over pixels within EDGE_STEP of the central one.

    Opposite pixels are used in pairs or not at all, so a plane is unchanged, also at its edges.
    """
    rows, columns = d.shape
    half = width // 2
    between, out = d.copy(), d.copy()
    total, count = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for v in range(half, rows - half):
        here = d[v]
        total[:], count[:] = 0, 1
        for y in range(1, half + 1):
            _add_pairs(here, d[v - y], d[v + y], total, count)
        between[v] += total / count
    for v in range(rows):
        here = between[v, half : columns - half]
        total[:], count[:] = 0, 1
        for x in range(1, half + 1):
            _add_pairs(here, between[v, half - x :], between[v, half + x :], total, count)
        out[v, half : columns - half] = here + total[: len(here)] / count[: len(here)]
    return out


@compiled
def _add_pairs(here, before, after, total, count):
    """Add up the differences of opposite neighbours from each pixel of a row, where both are small, and count them."""
    edge = np.float32(EDGE_STEP)
    for u in range(len(here)):
        a, b = before[u] - here[u], after[u] - here[u]
        near = (abs(a) <= edge) & (abs(b) <= edge)
        total[u] += a + b if near else np.float32(0)
        count[u] += np.float32(2) if near else np.float32(0)


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
            across, down = _slopes(d, v, u)
            x = (u - 1 - cx) / fx
            a, b = fx * across, fy * down
            c = d[v, u] - a * x - b * y  # (a, b, c) is along the normal, and its product with the ray is d
            cosines[u] = d[v, u] / math.sqrt((a * a + b * b + c * c) * (x * x + y * y + 1))
        for u in range(1, columns - 1):
            if d[v, u] > 0 and cosines[u] < start_cosine:
                probability = (math.acos(cosines[u]) - start) / (end - start)
                out[v, u] = probability >= 1 or _normal_cdf(field[(v - 1) // 2, (u - 1) // 2]) < probability
    return out
