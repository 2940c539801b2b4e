"""Down-facing faces merged into convex patches: pieces of an underside whose upward sweep is one convex body.

A patch is convex when its projection along z is a convex polygon and every corner lies on or above the plane of every
face. Its sweep is then the hull of its corners at their own height and at the rim: one hull for a lying cylinder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kit1000.numerics.compiled import compiled

PLANE_TOLERANCE = 2e-6  # [m] a corner may lie this far below the plane of a face
EXACT_AREA = 2e-11  # [m^2] by which the hull of a convex projection exceeds it, by rounding


class Detail(NamedTuple):
    """How far a cavity may exceed the exact one, for the sake of fewer pieces: all errors are to the open side."""

    horizontal: float  # [m] by which a corner of a convex patch may lie outside a face, measured horizontally
    hull_area: float  # [m^2] by which the hull of a patch's projection may exceed the projection
    sagitta: float | None = None  # [m] by which the border of a patch may lie inside its hull, instead of `hull_area`


EXACT = Detail(0.0, EXACT_AREA)
MERGED = Detail(0.1e-3, 2e-8)  # two or three facets of a round hole merge
MERGED_FILE = Detail(0.07e-3, 0.0, sagitta=0.06e-3)  # for parts of files, whose meshes may be dense


class Underside(NamedTuple):
    """Downward-facing triangles with their corners shared, and the patches that they merge into."""

    corners: np.ndarray  # (n, 3) [m]
    faces: np.ndarray  # (m, 3) corners of each triangle
    neighbours: np.ndarray  # (m, 3) triangle across each edge, -1 at the border
    groups: list[np.ndarray]  # triangles of each patch

    @property
    def patches(self) -> list[np.ndarray]:
        """(k, 3) [m] the corners of each patch."""
        return [self.corners[np.unique(self.faces[group])] for group in self.groups]


def merged_underside(triangles: np.ndarray, detail: Detail = MERGED) -> Underside:
    """Downward-facing triangles (m, 3, 3) [m] merged into convex patches."""
    if not len(triangles):
        return Underside(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3), int), [])
    corners, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    neighbours = _neighbours(faces)
    sagitta = -1.0 if detail.sagitta is None else detail.sagitta
    labels = _grow(corners, faces, neighbours, detail.horizontal, detail.hull_area, sagitta)
    order = np.argsort(labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return Underside(corners, faces, neighbours, groups)


def _neighbours(faces: np.ndarray) -> np.ndarray:
    """(m, 3) index of the face across each edge, -1 at the border."""
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    count = faces.max() + 1
    there, back = a * count + b, b * count + a
    order = np.argsort(there)
    place = np.clip(np.searchsorted(there[order], back), 0, len(order) - 1)
    opposite = order[place]
    return np.where(there[opposite] == back, opposite // 3, -1).reshape(-1, 3)


@compiled
def _grow(corners, faces, neighbours, horizontal, hull_tolerance, sagitta):
    """(m,) patch label of each face. Greedy: each unlabelled face seeds a patch that adds neighbours while convex.

    corners: in lexical order, so that a list of indices in order is sorted for the hull. Loops over numbers alone, as
    array expressions would take ten times as long to compile. sagitta: used instead of hull_tolerance unless it is
    negative [m].
    """
    count = faces.shape[0]
    planes, areas = np.empty((count, 5)), np.empty(count)
    for f in range(count):
        areas[f] = _set_plane(corners, faces[f, 0], faces[f, 1], faces[f, 2], horizontal, planes, f)
    labels = np.empty(count, np.int64)
    for f in range(count):
        labels[f] = -1
    members, queue = np.empty(count, np.int64), np.empty(3 * count, np.int64)
    points, longer = np.empty(3 * count, np.int64), np.empty(3 * count, np.int64)
    chain = np.empty(3 * count + 2, np.int64)
    for seed in range(count):
        if labels[seed] >= 0:
            continue
        labels[seed] = seed
        members[0], member_count, area = seed, 1, areas[seed]
        point_count = _insert(faces, seed, points, 0, points)
        head, tail = 0, 3
        for k in range(3):
            queue[k] = neighbours[seed, k]
        while head < tail:
            f = queue[head]
            head += 1
            if f < 0 or labels[f] >= 0:
                continue
            if not _fits(corners, faces, planes, f, points, point_count, members, member_count):
                continue
            longer_count = _insert(faces, f, points, point_count, longer)
            hull_count, hull_area = _hull(corners, longer, longer_count, chain)
            if sagitta < 0:
                if hull_area > area + areas[f] + hull_tolerance:
                    continue
            elif hull_area > area + areas[f] + EXACT_AREA:
                labels[f] = seed
                members[member_count] = f
                if _is_deep(corners, faces, neighbours, labels, members, member_count + 1, chain, hull_count, sagitta):
                    labels[f] = -1
                    continue
            points, longer, point_count = longer, points, longer_count
            area += areas[f]
            labels[f] = seed
            members[member_count] = f
            member_count += 1
            for k in range(3):
                if tail < queue.shape[0]:
                    queue[tail] = neighbours[f, k]
                    tail += 1
    return labels


@compiled
def _set_plane(corners, i, j, k, horizontal, planes, at):
    """Store the plane of triangle i, j, k: upward unit normal, height along it, tolerance; returns its area in xy."""
    x, y, z = corners[i, 0], corners[i, 1], corners[i, 2]
    p, q, r = corners[j, 0] - x, corners[j, 1] - y, corners[j, 2] - z
    s, t, w = corners[k, 0] - x, corners[k, 1] - y, corners[k, 2] - z
    nx, ny, nz = q * w - r * t, r * s - p * w, p * t - q * s
    norm = math.sqrt(nx * nx + ny * ny + nz * nz)
    planes[at, 0], planes[at, 1], planes[at, 2] = -nx / norm, -ny / norm, -nz / norm
    planes[at, 3] = -(nx / norm * x + ny / norm * y + nz / norm * z)
    planes[at, 4] = max(PLANE_TOLERANCE, horizontal * math.hypot(nx / norm, ny / norm))
    return abs(nz) / 2


@compiled
def _insert(faces, f, points, count, longer):
    """Write to `longer` the sorted list of points with the corners of face f, each once; returns its length."""
    for i in range(count):
        longer[i] = points[i]
    for k in range(3):
        corner, place = faces[f, k], count
        while place > 0 and longer[place - 1] > corner:
            place -= 1
        if place > 0 and longer[place - 1] == corner:
            continue
        for i in range(count, place, -1):
            longer[i] = longer[i - 1]
        longer[place] = corner
        count += 1
    return count


@compiled
def _fits(corners, faces, planes, f, points, point_count, members, member_count):
    """Whether all points are above the plane of face f, and its corners above the planes of all members."""
    for i in range(point_count):
        if _is_below(corners, points[i], planes, f):
            return False
    for i in range(member_count):
        for k in range(3):
            if _is_below(corners, faces[f, k], planes, members[i]):
                return False
    return True


@compiled
def _is_below(corners, p, planes, f):
    height = corners[p, 0] * planes[f, 0] + corners[p, 1] * planes[f, 1] + corners[p, 2] * planes[f, 2]
    return height < planes[f, 3] - planes[f, 4]


@compiled
def _hull(corners, points, count, chain):
    """Corners and area of the convex hull of points in lexical order, projected along z (monotone chain).

    Writes the corners to `chain`, first the ones of the lower side.
    """
    area, first = 0.0, 0
    for side in range(2):
        n = first
        for i in range(count):
            p = points[i] if side == 0 else points[count - 1 - i]
            while n - first > 1 and _turn(corners, chain[n - 2], chain[n - 1], p) <= 0:
                n -= 1
            chain[n] = p
            n += 1
        for i in range(first, n - 1):
            a, b = chain[i], chain[i + 1]
            area += corners[a, 0] * corners[b, 1] - corners[a, 1] * corners[b, 0]
        first = n - 1
    return first, abs(area) / 2


@compiled
def _is_deep(corners, faces, neighbours, labels, members, member_count, chain, hull_count, sagitta):
    """Whether a corner on the border of a patch lies farther inside the hull than `sagitta`."""
    for m in range(member_count):
        f = members[m]
        for k in range(3):
            other = neighbours[f, k]
            if other >= 0 and labels[other] == labels[f]:
                continue
            # its other end is where the next edge of the border begins
            if _depth_in_hull(corners, faces[f, k], chain, hull_count, sagitta) > sagitta:
                return True
    return False


@compiled
def _depth_in_hull(corners, p, chain, hull_count, enough):
    """[m] from a corner to the nearest edge of the hull's outline, up to the first distance that is small enough.

    An edge above the corner is as near as one at its height: the hull fills no space below it. An edge below it is not:
    a steep face with an arch is a sliver seen from above, and its hull would fill the arch.
    """
    nearest = np.inf
    for i in range(hull_count):
        a, b = chain[i], chain[(i + 1) % hull_count]
        ux, uy = corners[b, 0] - corners[a, 0], corners[b, 1] - corners[a, 1]
        dx, dy = corners[p, 0] - corners[a, 0], corners[p, 1] - corners[a, 1]
        share = min(max((dx * ux + dy * uy) / max(ux * ux + uy * uy, 1e-300), 0.0), 1.0)
        below = max(corners[p, 2] - corners[a, 2] - share * (corners[b, 2] - corners[a, 2]), 0.0)
        nearest = min(nearest, math.hypot(math.hypot(dx - share * ux, dy - share * uy), below))
        if nearest <= enough:
            break
    return nearest


@compiled
def _turn(corners, a, b, p):
    """Positive for a left turn at b from a to p, seen from above."""
    ahead = (corners[b, 0] - corners[a, 0]) * (corners[p, 1] - corners[a, 1])
    return ahead - (corners[b, 1] - corners[a, 1]) * (corners[p, 0] - corners[a, 0])
