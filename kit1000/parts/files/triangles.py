"""The triangles of a mesh file before any repair, polygons cut into triangles, and the step of stored coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import triangulate

from kit1000.errors import MeshRefused

CONVEX = 1e-9  # smallest turn at a corner of a convex polygon, as a share of its area
MOST_DECIMALS = 12  # a text with more decimals is as exact as float64
GRID_VALUES = 16  # a text with fewer different coordinates on each axis is a drawing on a grid, so it is exact


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """Triangles as a file stores them: neither connected nor consistently wound."""

    vertices: np.ndarray
    """(n, 3) float64, in the unit of the file."""
    faces: np.ndarray
    """(m, 3) int64 indices of vertices."""
    unit: str | None = None
    """The unit that the file states."""
    step: float = 0.0
    """Distance between two coordinates that the file can tell apart, in its unit; 0 if it is as fine as float64."""


def joined(meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Several meshes (vertices, faces) as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    points = np.concatenate([np.zeros((0, 3)), *(vertices for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts[:-1], strict=True)]
    return points, np.concatenate([np.zeros((0, 3), dtype=np.int64), *faces])


def check_indices(indices: np.ndarray, count: int, kind: str) -> None:
    """Raise MeshRefused if faces of a file of a `kind`, such as OBJ, name a vertex that does not exist."""
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        worst = int(indices.min()) if indices.min() < 0 else int(indices.max())
        raise MeshRefused(f"not readable as {kind}: a face names vertex {worst:,} of {count:,}")


def float32_step(vertices: np.ndarray) -> float:
    """The distance between neighbouring float32 numbers at the largest coordinate."""
    largest = float(np.abs(vertices).max(initial=0.0))
    return float(np.spacing(np.float32(largest))) if np.isfinite(largest) else 0.0


def decimal_step(vertices: np.ndarray) -> float:
    """The power of ten of which all coordinates of a text are multiples; 0 if the text is exact.

    A text with few different coordinates is exact: its shape lies on a grid, such as a box of whole millimetres.
    """
    if all(len(np.unique(axis)) <= GRID_VALUES for axis in vertices.T) or not np.isfinite(vertices).all():
        return 0.0
    for decimals in range(MOST_DECIMALS):
        scaled = vertices * 10.0**decimals
        if (np.abs(scaled - np.rint(scaled)) <= 1e-9 + 1e-12 * np.abs(scaled)).all():
            return 10.0**-decimals
    return 0.0


def polygons_as_triangles(vertices: np.ndarray, polygons: Sequence[Sequence[int]]) -> np.ndarray:
    """(m, 3) int64 the triangles of polygons, sorted by their numbers of corners; fewer than 3 corners give none.

    vertices: (n, 3). polygons: the indices of the corners of each, in order.
    """
    by_length: dict[int, list[Sequence[int]]] = {}
    for polygon in polygons:
        by_length.setdefault(len(polygon), []).append(polygon)
    groups = [np.array(by_length[length], dtype=np.int64) for length in sorted(by_length) if length >= 3]
    return np.concatenate([np.zeros((0, 3), np.int64), *(_triangles_of_equal(vertices, group) for group in groups)])


def _triangles_of_equal(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """The triangles of polygons (k, c) with equal numbers of corners: fans if they are convex."""
    corners = polygons.shape[1]
    if corners == 3:
        return polygons
    points = vertices[polygons]
    ahead, behind = np.roll(points, -1, axis=1), np.roll(points, 1, axis=1)
    centred = points - points[:, :1]
    normals = np.cross(centred, np.roll(centred, -1, axis=1)).sum(1)  # Newell: its length is twice the area
    turns = (np.cross(points - behind, ahead - points) * normals[:, None]).sum(-1)
    area = (normals**2).sum(-1)
    with np.errstate(invalid="ignore"):
        convex = (turns > CONVEX * area[:, None]).all(1) | ~(area > 0)
    fans = polygons[convex]
    pieces = [np.stack([fans[:, 0], fans[:, k], fans[:, k + 1]], axis=1) for k in range(1, corners - 1)]
    others = zip(polygons[~convex], normals[~convex], strict=True)
    pieces += [_cut_up(vertices, polygon, normal) for polygon, normal in others]
    return np.concatenate([np.zeros((0, 3), dtype=np.int64), *pieces])


def _cut_up(vertices: np.ndarray, polygon: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The triangles of a concave polygon, cut up as seen along the longest axis of its normal."""
    axis = int(np.argmax(np.abs(normal)))
    seen = vertices[polygon][:, [(axis + 1) % 3, (axis + 2) % 3]]
    order = np.arange(len(polygon)) if normal[axis] > 0 else np.arange(len(polygon))[::-1]
    size = np.ptp(seen, axis=0).max()
    if not np.isfinite(size) or size == 0:
        return np.stack([np.repeat(polygon[0], len(polygon) - 2), polygon[1:-1], polygon[2:]], axis=1)
    scaled = (seen[order] - seen.min(0)) / size
    triangles = polygon[order][np.asarray(triangulate([np.ascontiguousarray(scaled)]), dtype=np.int64)]
    return triangles if normal[axis] > 0 else triangles[:, ::-1]
