"""Down-facing faces joined into convex patches: pieces of an underside whose upward sweep is one convex body.

A patch is convex when its shadow is a convex polygon and every corner lies on or above the plane of every face. Its
sweep is then the hull of its corners here and at the rim, so the cavity of a whole lying cylinder is a single hull.
"""

from __future__ import annotations

import numpy as np

from kit1000.compiled import compiled

FLAT = 2e-6  # [m] a corner may lie this far below a plane, or
ACROSS = 0.1e-3  # [m] this far beyond it, measured level: hulls then err by as much, to the open side, and the facets
# of a round hole join by twos and threes
NICK = 2e-8  # [m^2] area by which the hull of a shadow may exceed the shadow


def convex_patches(triangles: np.ndarray, joined: bool = True) -> list[np.ndarray]:
    """Triangles (m, 3, 3) [m] that all look down, as patches: (k, 3) [m] corners each.

    joined: allow ACROSS and NICK; otherwise only what is convex to FLAT is one patch.
    """
    if not len(triangles):
        return []
    corners, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = faces.reshape(-1, 3)
    labels = _grow(corners, faces, _neighbours(faces), *((ACROSS, NICK) if joined else (0.0, NICK * 1e-3)))
    order = np.argsort(labels, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    return [corners[np.unique(faces[group])] for group in groups]


def _neighbours(faces: np.ndarray) -> np.ndarray:
    """(m, 3) index of the face across each edge, -1 at the border."""
    a, b = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    count = faces.max() + 1
    there, back = a * count + b, b * count + a
    order = np.argsort(there)
    spot = np.clip(np.searchsorted(there[order], back), 0, len(order) - 1)
    across = order[spot]
    return np.where(there[across] == back, across // 3, -1).reshape(-1, 3)


@compiled
def _grow(corners, faces, neighbours, across, nick):
    """Greedy: each face not yet taken seeds a patch that takes in neighbours as long as it stays convex."""
    count = faces.shape[0]
    normals = np.empty((count, 5))
    shadows = np.empty(count)
    for f in range(count):
        a, b, c = corners[faces[f, 0]], corners[faces[f, 1]], corners[faces[f, 2]]
        n = np.cross(b - a, c - a)
        shadows[f] = abs(n[2]) / 2
        n /= np.sqrt((n**2).sum())
        normals[f, :3] = -n
        normals[f, 3] = -(n * a).sum()
        normals[f, 4] = max(FLAT, across * np.hypot(n[0], n[1]))
    labels = np.full(count, -1)
    members, points, queue = np.empty(count, np.int64), np.empty(3 * count, np.int64), np.empty(3 * count, np.int64)
    for seed in range(count):
        if labels[seed] >= 0:
            continue
        labels[seed] = seed
        members[0], sized, area = seed, 1, shadows[seed]
        points[:3] = faces[seed]
        held = 3
        queue[:3] = neighbours[seed]
        head, tail = 0, 3
        while head < tail:
            f = queue[head]
            head += 1
            if f < 0 or labels[f] >= 0:
                continue
            if not _above(corners, points[:held], normals[f]) or not _under(
                corners, faces[f], normals, members[:sized]
            ):
                continue
            points[held : held + 3] = faces[f]
            if _hull_area(corners, points[: held + 3]) > area + shadows[f] + nick:
                continue
            held += 3
            area += shadows[f]
            labels[f] = seed
            members[sized] = f
            sized += 1
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
    for m in members:  # noqa: SIM110 (compiled code knows no generators)
        if not _above(corners, face, planes[m]):
            return False
    return True


@compiled
def _hull_area(corners, points):
    """Area of the convex hull of the points' shadows (monotone chain)."""
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
