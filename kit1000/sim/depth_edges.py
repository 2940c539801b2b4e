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
    edges, halves = np.zeros(columns, np.float32), np.zeros(columns, np.float32)
    total, count = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for v in range(1, rows - 1):
        _enlarge_row(edge[(v - 1) // factor], factor, edges)
        _enlarge_row(half[(v - 1) // factor], factor, halves)
        total[:], count[:] = 0, 1
        for y in range(1, min(widest, v, rows - 1 - v) + 1):
            _add_pairs(d[v], d[v - y], d[v + y], edges, halves, np.float32(y), total, count)
        between[v] += total / count
    for v in range(1, rows - 1):
        _enlarge_row(edge[(v - 1) // factor], factor, edges)
        _enlarge_row(half[(v - 1) // factor], factor, halves)
        total[:], count[:] = 0, 1
        row = between[v]
        for x in range(1, widest + 1):
            end = columns - x
            before, after = row[: end - x], row[2 * x :]
            _add_pairs(
                row[x:end], before, after, edges[x:end], halves[x:end], np.float32(x), total[x:end], count[x:end]
            )
        out[v] = row + total / count
    return out


@compiled
def _enlarge_row(values, factor, out):
    """Write each value of a coarse row to its `factor` columns of a row with a border."""
    for x in range(len(values)):
        for k in range(factor):
            u = 1 + x * factor + k
            if u < len(out) - 1:
                out[u] = values[x]


@compiled
def _add_pairs(here, before, after, edges, halves, away, total, count):
    """Add up the differences of opposite neighbours, `away` px off, if both are small, and count them."""
    for u in range(len(here)):
        a, b = before[u] - here[u], after[u] - here[u]
        share = min(max(halves[u] - away + np.float32(1), np.float32(0)), np.float32(1))
        near = (abs(a) <= edges[u]) & (abs(b) <= edges[u])
        total[u] += share * (a + b) if near else np.float32(0)
        count[u] += share * np.float32(2) if near else np.float32(0)


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
