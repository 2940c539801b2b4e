"""Errors of real stereo cameras at depth edges, as compiled loops: ramps, wide edges, wide shadows, holes.

Letters and borders are those of `kit1000.sim.stereo`: d disparity [px], (H + 2, W + 2) with a border of zeros, 0 for no
surface. Coarse fields hold one value in `factor` px along both axes.
"""

from __future__ import annotations

import numpy as np

from kit1000.numerics.compiled import compiled
from kit1000.sim.stereo import slopes

SEEN_STEP = 1.0  # [px] smallest jump at which a near surface extends over a far one


@compiled
def widened_edges(d, share, edge, factor, most):
    """Disparities whose near surfaces extend beyond their edges: over a jump of more than `edge` by `most` times
    `share` px, over smaller ones, down to SEEN_STEP, by half of it.

    Args:
        d: disparities; pixels without a surface stay empty, and a near surface continues with its own slope.
        share: (H / factor, W / factor) 0 to 1, smooth.
        edge: the same, [px] of disparity.
        factor: [px] between values of the two fields.
        most: [px] the largest extension.
    """
    rows, columns = d.shape
    out = d.copy()
    drop = np.zeros(columns, np.float32)
    for v in range(1, rows - 1):
        for u in range(1, columns - 1):
            here = d[v, u]
            lowest = here
            for beside in (d[v, u - 1], d[v, u + 1], d[v - 1, u], d[v + 1, u]):
                lowest = min(lowest, beside if beside > 0 else here)
            drop[u] = here - lowest
        for u in range(1, columns - 1):
            if drop[u] > SEEN_STEP:
                y, x = (v - 1) // factor, (u - 1) // factor
                radius = most * share[y, x] * (1.0 if drop[u] > edge[y, x] else 0.5)
                if radius >= 1:
                    _extend(d, v, u, radius, out)
    return out


@compiled
def _extend(d, v, u, radius, out):
    """Write the surface at row v, column u to the pixels within `radius` px that see farther surfaces."""
    rows, columns = d.shape
    here = d[v, u]
    across, down = slopes(d, v, u)
    whole = int(radius)
    for y in range(max(v - whole, 1), min(v + whole + 1, rows - 1)):
        for x in range(max(u - whole, 1), min(u + whole + 1, columns - 1)):
            if (x - u) ** 2 + (y - v) ** 2 > radius * radius or d[y, x] == 0:
                continue
            value = here + across * (x - u) + down * (y - v)
            if value > d[y, x] + SEEN_STEP and value > out[y, x]:
                out[y, x] = value


@compiled
def blended_ramps(d, edge, half, factor):
    """Disparities averaged down, then across, over the pixels within `half` px and `edge` px of disparity of each.

    A jump of less than `edge` becomes a ramp of about 2 `half` + 1 px, a larger one stays. Opposite pixels are used in
    pairs or not at all, so a plane is unchanged, also at its edges.

    Args:
        d: disparities.
        edge: (H / factor, W / factor) [px] of disparity, float32.
        half: the same, [px], float32.
        factor: [px] between values of the two fields.
    """
    rows, columns = d.shape
    widest = int(np.ceil(half.max()))
    between, out = d.copy(), d.copy()
    edges, shares = np.zeros(columns, np.float32), np.zeros((widest, columns), np.float32)
    total, count = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for v in range(1, rows - 1):
        if (v - 1) % factor == 0:
            _enlarge_rows(edge[(v - 1) // factor], half[(v - 1) // factor], factor, edges, shares)
        total[:], count[:] = 0, 1
        for y in range(1, min(widest, v, rows - 1 - v) + 1):
            _add_pairs(d[v], d[v - y], d[v + y], edges, shares[y - 1], total, count)
        for u in range(columns):
            between[v, u] += total[u] / count[u]
    for v in range(1, rows - 1):
        if (v - 1) % factor == 0:
            _enlarge_rows(edge[(v - 1) // factor], half[(v - 1) // factor], factor, edges, shares)
        total[:], count[:] = 0, 1
        row = between[v]
        for x in range(1, widest + 1):
            end = columns - x
            before, after = row[: end - x], row[2 * x :]
            _add_pairs(row[x:end], before, after, edges[x:end], shares[x - 1, x:end], total[x:end], count[x:end])
        for u in range(columns):
            out[v, u] = row[u] + total[u] / count[u]
    return out


@compiled
def _enlarge_rows(edge, half, factor, edges, shares):
    """Write each value of two coarse rows to its `factor` columns of rows with a border: the edges, and the share of a
    pixel 1, 2, ... px away that counts.
    """
    for x in range(len(edge)):
        for u in range(1 + x * factor, min(1 + (x + 1) * factor, len(edges) - 1)):
            edges[u] = edge[x]
            for away in range(1, len(shares) + 1):
                shares[away - 1, u] = min(max(half[x] - np.float32(away) + np.float32(1), np.float32(0)), np.float32(1))


@compiled
def _add_pairs(here, before, after, edges, shares, total, count):
    """Add up the differences of opposite neighbours, each by its share, if both are small, and count them."""
    for u in range(len(here)):  # a loop without branches, which the processor does for several pixels at once
        a, b = before[u] - here[u], after[u] - here[u]
        share = shares[u] if (abs(a) <= edges[u]) & (abs(b) <= edges[u]) else np.float32(0)
        total[u] += share * (a + b)
        count[u] += share + share


@compiled
def widen_shadows(missing, d, width):
    """Extend shadows (bool) by `width` px to the left, over pixels of the same far surface, in place."""
    rows, columns = d.shape
    for v in range(1, rows - 1):
        left = 0
        value = np.float32(0)
        for u in range(columns - 2, 0, -1):
            if missing[v, u]:
                left, value = width, d[v, u]
            elif left > 0 and abs(d[v, u] - value) < SEEN_STEP:
                missing[v, u] = True
                left -= 1
                if left == 0:
                    value = np.float32(0)
            else:
                left = 0


@compiled
def punch_holes(missing, d, chance, size, factor, jump, share, widest):
    """Mark (bool, in place) pixels without a return about jumps of more than `jump` px between neighbours.

    Args:
        missing: with the border, as d.
        d: disparities.
        chance: (H / factor, W / factor) uniform, smooth: there are holes in pixels with a value below `share`.
        size: the same: the width is 1, 3, ... px, up to `widest`, each in an equal share of values.
        factor: [px] between values of the two fields.
        jump: [px] of disparity.
        share: of the jumps.
        widest: [px] odd.
    """
    rows, columns = d.shape
    sizes = np.float32((widest + 1) // 2)
    for v in range(1, rows - 1):
        for u in range(1, columns - 1):
            here, right, below = d[v, u], d[v, u + 1], d[v + 1, u]
            jumps = (right > 0 and abs(right - here) > jump) or (below > 0 and abs(below - here) > jump)
            if here == 0 or not jumps:
                continue
            y, x = (v - 1) // factor, (u - 1) // factor
            if chance[y, x] >= share:
                continue
            reach = min(int(size[y, x] * sizes), int(sizes) - 1)
            for i in range(max(v - reach, 1), min(v + reach + 1, rows - 1)):
                for j in range(max(u - reach, 1), min(u + reach + 1, columns - 1)):
                    missing[i, j] = True


@compiled
def depths_of(d, noise, missing, step, unit, gain):
    """Depths (H, W) [m] from disparities plus noise (H, W) [px]; 0 for `missing` pixels and pixels without a surface.

    Disparities are rounded to steps of `step` px, depths to multiples of `unit` [m]; 0 for no rounding.
    """
    out = np.zeros(noise.shape, np.float32)
    for v in range(noise.shape[0]):
        for u in range(noise.shape[1]):
            value = d[v + 1, u + 1] + noise[v, u]
            if step > 0:
                value = np.rint(value / step) * step
            if d[v + 1, u + 1] > 0 and value > 0 and not missing[v + 1, u + 1]:
                depth = gain / value
                out[v, u] = np.rint(depth / unit) * unit if unit > 0 else depth
    return out
