"""Closing of open surfaces, smallest change first: seams welded, T-junctions stitched, small holes filled.

Vertices (n, 3) are float64 [m], faces (m, 3) int64. A surface that stays open is refused with its number of open edges.
"""

from __future__ import annotations

import numpy as np
from manifold3d import triangulate
from scipy.spatial import KDTree

from kit1000.errors import MeshRefused
from kit1000.mesh import component_labels
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.parts.files.topology import consistently_wound, halfedges, longest_side, open_edges, without_duplicates

WELD_SHARES = (1e-7, 1e-6, 1e-5)  # of the longest side; CAD exports one corner with different last digits
WELD_LIMIT = 1e-5  # [m] wider seams are not closed
STITCH_SHARE = 1e-4  # of the longest side: how far a vertex may lie off the edge that it splits
STITCH_LIMIT = 20_000  # open edges; a surface with more is not nearly closed
STITCH_PASSES = 4  # a face may be split along each side, and its pieces once more
HOLE_SHARE = 0.02  # of the surface; a larger hole may be intended, and a lid would change the solid
TRIANGLE_SHARE = 0.2  # of the surface, for a hole of three edges, which has only one possible lid
HOLE_FLATNESS = 2e-3  # of the longest side


def close_surface(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Close seams, T-junctions and small holes, in this order; refuse a surface that stays open."""
    opened = len(open_edges(faces))
    for share in WELD_SHARES:
        faces = _welded_seams(vertices, faces, min(share * longest_side(vertices), WELD_LIMIT), notes)
        if not len(open_edges(faces)):
            return vertices, faces
    if len(open_edges(faces)) <= STITCH_LIMIT:
        faces = _stitched(vertices, faces, notes)
    if 0 < len(open_edges(faces)) <= STITCH_LIMIT:
        faces = _filled(vertices, consistently_wound(vertices, faces, notes), notes)
    left = open_edges(faces)
    if len(left):
        was = "" if len(left) == opened else f" ({opened} before repair)"
        raise MeshRefused(f"not closed: {len(left)} open edges{was}{_holes_text(vertices, faces, left)}")
    return vertices, faces


def _holes_text(vertices: np.ndarray, faces: np.ndarray, opened: np.ndarray) -> str:
    """The number of holes among open edges, the width of the widest, and what to do about them."""
    start, end = halfedges(faces)
    rim, places = np.unique([start[opened], end[opened]], return_inverse=True)
    labels = component_labels(len(rim), *places.reshape(2, -1))
    count = labels.max() + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, labels, vertices[rim])
    np.maximum.at(high, labels, vertices[rim])
    holes = f"in {count:,} holes, the widest" if count > 1 else "in one hole of"
    return f" {holes} {(high - low).max() * 1e3:.4g} mm; export a solid, or close it in a mesh editor"


def _welded_seams(vertices: np.ndarray, faces: np.ndarray, tolerance: float, notes: list[str]) -> np.ndarray:
    """Merge vertices on open edges that lie within a tolerance [m] of each other."""
    start, end = halfedges(faces)
    opened = open_edges(faces)
    rim = np.unique([start[opened], end[opened]])
    labels = component_labels(len(rim), *KDTree(vertices[rim]).query_pairs(tolerance, output_type="ndarray").T)
    count = labels.max() + 1
    if count == len(rim):
        return faces
    first = np.full(count, len(rim))
    np.minimum.at(first, labels, np.arange(len(rim)))
    target = np.arange(len(vertices))
    target[rim] = rim[first[labels]]
    notes.append(f"welded {len(rim) - count:,} vertices within {tolerance * 1e6:.2g} um")
    return without_duplicates(vertices, target[faces], notes)


def _stitched(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """Split faces at vertices of other open edges that lie on their own open edges."""
    before = len(faces)
    for _ in range(STITCH_PASSES):
        splits = _splits(vertices, faces)
        if not splits:
            break
        fans = [_fan(faces[face], side, points) for face, (side, points) in splits.items()]
        faces = np.concatenate([np.delete(faces, list(splits), axis=0), *fans])
    if len(faces) > before:
        notes.append(f"stitched {len(faces) - before:,} T-junctions")
        faces = without_duplicates(vertices, faces, notes)
    return faces


def _splits(vertices: np.ndarray, faces: np.ndarray) -> dict[int, tuple[int, np.ndarray]]:
    """For each face to split, the side (0, 1, 2) and the vertices on it in order. One side per face."""
    start, end = halfedges(faces)
    opened = open_edges(faces)
    if not len(opened):
        return {}
    rim = np.unique([start[opened], end[opened]])
    a, b = vertices[start[opened]], vertices[end[opened]]
    lengths = np.linalg.norm(b - a, axis=1)
    near = KDTree(vertices[rim]).query_ball_point((a + b) / 2, lengths / 2)
    tolerance = min(STITCH_SHARE * longest_side(vertices), WELD_LIMIT)
    splits: dict[int, tuple[int, np.ndarray]] = {}
    for i, halfedge in enumerate(opened):
        side, face = divmod(int(halfedge), len(faces))
        candidates = np.setdiff1d(rim[near[i]], faces[face])
        offset, along = vertices[candidates] - a[i], (b[i] - a[i]) / max(lengths[i], 1e-300)
        position = matmul(offset, along)
        on_edge = np.linalg.norm(offset - position[:, None] * along, axis=1) <= tolerance
        if on_edge.any() and face not in splits:
            splits[face] = side, candidates[on_edge][np.argsort(position[on_edge])]
    return splits


def _fan(face: np.ndarray, side: int, points: np.ndarray) -> np.ndarray:
    """(k + 1, 3) faces: one face split from its opposite corner to k points along a side."""
    a, b, far = np.roll(face, -side)
    chain = np.concatenate([[a], points, [b]])
    return np.stack([chain[:-1], chain[1:], np.full(len(chain) - 1, far)], axis=1)


def _filled(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """Close flat, small holes with a lid; leave the others open."""
    corners = vertices[faces]
    crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(crosses, axis=1).sum() / 2
    loops = _loops(faces)
    shares = [TRIANGLE_SHARE if len(loop) == 3 else HOLE_SHARE for loop in loops]
    found = [_lid(vertices, loop, share * area) for loop, share in zip(loops, shares, strict=True)]
    lids = [lid for lid in found if lid is not None]
    if not lids:
        return faces
    notes.append(f"filled {len(lids)} small holes" if len(lids) > 1 else "filled a small hole")
    return np.concatenate([faces, *lids])


def _loops(faces: np.ndarray) -> list[np.ndarray]:
    """Boundary loops of holes, each vertex once, against the winding of the faces around."""
    start, end = halfedges(faces)
    onward: dict[int, list[int]] = {}
    for halfedge in open_edges(faces):
        onward.setdefault(int(end[halfedge]), []).append(int(start[halfedge]))
    loops = []
    while onward:
        path = [next(iter(onward))]
        while path and (following := onward.get(path[-1])):
            vertex = following.pop()
            if not following:
                del onward[path[-1]]
            if vertex in path:  # holes that touch at a vertex are separated there
                first = path.index(vertex)
                loops.append(np.array(path[first:]))
                path = path[: first + 1]
            else:
                path.append(vertex)
        onward.pop(path[-1], None)
    return loops


def _lid(vertices: np.ndarray, ring: np.ndarray, largest: float) -> np.ndarray | None:
    """(k, 3) faces over a loop of vertices if it is flat and its area [m^2] is at most `largest`, else None."""
    points = vertices[ring] - vertices[ring].mean(0)
    across = np.cross(points, np.roll(points, -1, axis=0)).sum(0) / 2  # area vector of the ring
    area = length(across)
    if not 0 < area <= largest:
        return None
    normal = across / area
    if np.abs(matmul(points, normal)).max() > HOLE_FLATNESS * longest_side(vertices):
        return None
    x = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    x /= length(x)
    plane = np.ascontiguousarray(np.stack([matmul(points, x), matmul(points, np.cross(normal, x))], axis=1))
    return ring[np.asarray(triangulate([plane]), dtype=np.int64)]
