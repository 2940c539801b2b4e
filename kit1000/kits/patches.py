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


class Detail(NamedTuple):
    """How far a cavity may exceed the exact one, for the sake of fewer pieces: all errors are to the open side."""

    horizontal: float
    """[m] by which a corner of a convex patch may lie outside a face, measured horizontally."""
    hull_area: float
    """[m^2] by which the hull of a patch's projection may exceed the projection."""
    disc: float = 0.0
    """[m] by which the corners of the disc lie farther out than usual, so that it has fewer."""


EXACT = Detail(0.0, 2e-11)
MERGED = Detail(0.1e-3, 2e-8)  # two or three facets of a round hole merge
COARSE = Detail(0.05e-3, 4e-8, 0.035e-3)  # for dense meshes: half the time


def convex_patches(triangles: np.ndarray, detail: Detail = MERGED) -> list[np.ndarray]:
    """Patches of downward-facing triangles (m, 3, 3) [m], each as its corners (k, 3) [m]."""
    if not len(triangles):
        return []
    corners, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    labels = _grow(corners, faces, _neighbours(faces), detail.horizontal, detail.hull_area)
    order = np.argsort(labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return [corners[np.unique(faces[group])] for group in groups]


def _neighbours(faces: np.ndarray) -> np.ndarray:
    """(m, 3) index of the face horizontal each edge, -1 at the border."""
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    count = faces.max() + 1
    there, back = a * count + b, b * count + a
    order = np.argsort(there)
    place = np.clip(np.searchsorted(there[order], back), 0, len(order) - 1)
    opposite = order[place]
    return np.where(there[opposite] == back, opposite // 3, -1).reshape(-1, 3)


@compiled
def _grow(corners, faces, neighbours, horizontal, hull_tolerance):
    """(m,) patch label of each face. Greedy: each unlabelled face seeds a patch that adds neighbours while convex.

    corners: in lexical order, so that a list of indices in order is sorted for the hull. Loops over numbers alone, as
    array expressions would take ten times as long to compile.
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
    chain = np.empty(3 * count, np.int64)
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
            if _hull_area(corners, longer, longer_count, chain) > area + areas[f] + hull_tolerance:
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
def _hull_area(corners, points, count, chain):
    """Area of the convex hull of points in lexical order, projected along z (monotone chain)."""
    area = 0.0
    for side in range(2):
        n = 0
        for i in range(count):
            p = points[i] if side == 0 else points[count - 1 - i]
            while n > 1 and _turn(corners, chain[n - 2], chain[n - 1], p) <= 0:
                n -= 1
            chain[n] = p
            n += 1
        for i in range(n - 1):
            a, b = chain[i], chain[i + 1]
            area += corners[a, 0] * corners[b, 1] - corners[a, 1] * corners[b, 0]
    return abs(area) / 2


@compiled
def _turn(corners, a, b, p):
    """Positive for a left turn at b from a to p, seen from above."""
    ahead = (corners[b, 0] - corners[a, 0]) * (corners[p, 1] - corners[a, 1])
    return ahead - (corners[b, 1] - corners[a, 1]) * (corners[p, 0] - corners[a, 0])
