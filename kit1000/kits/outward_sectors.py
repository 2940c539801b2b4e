"""The directions in which each corner of an underside has to be grown: a sector of the disc in place of all of it.

The cavity at a height z is the shadow S(z) grown by a disc. A point of it outside S(z) lies along an outward normal of
S(z) from the nearest point of S(z). So a corner needs only the directions of the outward normals that S(z) can have
there: they lie between the horizontal normals of the sloping faces that meet, and the normals of the border edges, seen
from above. Those along an edge or a face are directions of all its corners. A corner with directions all around is
grown by the whole disc.
"""

from __future__ import annotations

import numpy as np

from kit1000.kits.patches import Underside

WHOLE = np.radians(170)  # directions that spread more need the whole disc: less than half a circle is convex
CORE = 0.1  # share of the disc that is part of every sector, so that neighbouring patches overlap
ANGLE_DECIMALS = 9  # the last bits of an arctangent differ between processors
ANGLE_SLACK = 1e-6  # [rad] by which a direction may lie beyond the sector's corner: nanometres


def disc_sectors(underside: Underside, is_sloping: np.ndarray, polygon: np.ndarray) -> list[np.ndarray]:
    """For each corner (k, 2) [m] the points of the disc that it is grown by; of those of level faces alone, all.

    is_sloping: (m,) of the faces: the others are level, and grown elsewhere. polygon: (n, 2) [m] corners of the disc,
    the first along x, all equally spaced.
    """
    corner, angle = _outward_normals(underside, is_sloping)
    order = np.argsort(corner, kind="stable")
    angle, starts = angle[order], np.searchsorted(corner[order], np.arange(len(underside.corners) + 1))
    return [_sector(angle[starts[i] : starts[i + 1]], polygon) for i in range(len(underside.corners))]


def _outward_normals(underside: Underside, is_sloping: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (k,), and the direction (k,) [rad] of an outward normal at each, seen from above."""
    corners, faces, neighbours, _ = underside
    sloping = faces[is_sloping]
    a, b, c = np.moveaxis(corners[sloping], 1, 0)
    normals = np.cross(b - a, c - a)
    face, side = np.nonzero(neighbours < 0)
    start, end = faces[face, side], faces[face, (side + 1) % 3]
    along = corners[end] - corners[start]
    # faces look down, so that the inside of a border edge is on its right
    beside = np.arctan2(along[:, 0], -along[:, 1])
    angles = np.concatenate([np.repeat(np.arctan2(normals[:, 1], normals[:, 0]), 3), beside, beside])
    at = np.concatenate([sloping.ravel(), start, end])
    return at, np.round(angles, ANGLE_DECIMALS) % (2 * np.pi)


def _sector(angles: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """(k, 2) [m] the corners of the disc between which all directions lie, and its core; all where they spread."""
    if not len(angles):
        return polygon
    angles = np.sort(angles)
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    widest = int(gaps.argmax())
    spread, first = 2 * np.pi - gaps[widest], angles[(widest + 1) % len(angles)]
    if spread > WHOLE:
        return polygon
    step = 2 * np.pi / len(polygon)
    low, high = np.floor((first + ANGLE_SLACK) / step), np.ceil((first + spread - ANGLE_SLACK) / step)
    corners = np.arange(int(low), int(high) + 1) % len(polygon)
    core = CORE * polygon[:: max(len(polygon) // 4, 1)]
    return np.concatenate([polygon[corners], core])
