"""Down-facing faces merged into convex patches: pieces of an underside whose upward sweep is one convex body.

A patch is convex when its projection along z is a convex polygon and every corner lies on or above the plane of every
face. Its sweep is then the hull of its corners at their own height and at the rim: one hull for a lying cylinder.
"""

from __future__ import annotations

import numpy as np

from kit1000.compiled import compiled

PLANE_TOLERANCE = 2e-6  # [m] a corner may lie this far below the plane of a face, or
# [m] this far outside it, measured horizontally: hulls then err by as much, to the open side, and two or three facets
# of a round hole merge
HORIZONTAL_TOLERANCE = 0.1e-3
HULL_AREA_TOLERANCE = 2e-8  # [m^2] by which the hull of a projection may exceed the projection


def convex_patches(triangles: np.ndarray, merge_nearly_convex: bool = True) -> list[np.ndarray]:
    """Patches of downward-facing triangles (m, 3, 3) [m], each as its corners (k, 3) [m].

    merge_nearly_convex: allow HORIZONTAL_TOLERANCE and HULL_AREA_TOLERANCE; else a patch is convex to PLANE_TOLERANCE.
    """
    if not len(triangles):
        return []
    corners, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    tolerances = (
        (HORIZONTAL_TOLERANCE, HULL_AREA_TOLERANCE) if merge_nearly_convex else (0.0, HULL_AREA_TOLERANCE * 1e-3)
    )
    labels = _grow(corners, faces, _neighbours(faces), *tolerances)
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
    """(m,) patch label of each face. Greedy: each unlabelled face seeds a patch that adds neighbours while convex."""
    count = faces.shape[0]
    planes = np.empty((count, 5))
    areas = np.empty(count)
    for f in range(count):
        a, b, c = corners[faces[f, 0]], corners[faces[f, 1]], corners[faces[f, 2]]
        n = np.cross(b - a, c - a)
        areas[f] = abs(n[2]) / 2
        n /= np.sqrt((n**2).sum())
        planes[f, :3] = -n
        planes[f, 3] = -(n * a).sum()
        planes[f, 4] = max(PLANE_TOLERANCE, horizontal * np.hypot(n[0], n[1]))
    labels = np.full(count, -1)
    members, points, queue = np.empty(count, np.int64), np.empty(3 * count, np.int64), np.empty(3 * count, np.int64)
    for seed in range(count):
        if labels[seed] >= 0:
            continue
        labels[seed] = seed
        members[0], member_count, area = seed, 1, areas[seed]
        points[:3] = faces[seed]
        point_count = 3
        queue[:3] = neighbours[seed]
        head, tail = 0, 3
        while head < tail:
            f = queue[head]
            head += 1
            if f < 0 or labels[f] >= 0:
                continue
            if not _above(corners, points[:point_count], planes[f]) or not _under(
                corners, faces[f], planes, members[:member_count]
            ):
                continue
            points[point_count : point_count + 3] = faces[f]
            if _hull_area(corners, points[: point_count + 3]) > area + areas[f] + hull_tolerance:
                continue
            point_count += 3
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
def _above(corners, points, plane):
    for p in points:
        if corners[p, 0] * plane[0] + corners[p, 1] * plane[1] + corners[p, 2] * plane[2] < plane[3] - plane[4]:
            return False
    return True


@compiled
def _under(corners, face, planes, members):
    for m in members:  # noqa: SIM110 (compiled code supports no generators)
        if not _above(corners, face, planes[m]):
            return False
    return True


@compiled
def _hull_area(corners, points):
    """Area of the convex hull of the points projected along z (monotone chain)."""
    xy = np.empty((points.shape[0], 2))
    for i in range(points.shape[0]):
        xy[i, 0], xy[i, 1] = corners[points[i], 0], corners[points[i], 1]
    xy = xy[np.argsort(xy[:, 1], kind="mergesort")]
    xy = xy[np.argsort(xy[:, 0], kind="mergesort")]
    area = 0.0
    for side in range(2):
        chain = np.empty((xy.shape[0], 2))
        n = 0
        for i in range(xy.shape[0]):
            p = xy[i] if side == 0 else xy[xy.shape[0] - 1 - i]
            while (
                n > 1
                and (
                    (chain[n - 1, 0] - chain[n - 2, 0]) * (p[1] - chain[n - 2, 1])
                    - (chain[n - 1, 1] - chain[n - 2, 1]) * (p[0] - chain[n - 2, 0])
                )
                <= 0
            ):
                n -= 1
            chain[n] = p
            n += 1
        for i in range(n - 1):
            area += chain[i, 0] * chain[i + 1, 1] - chain[i + 1, 0] * chain[i, 1]
    return abs(area) / 2
