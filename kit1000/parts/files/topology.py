"""Topology of a mesh: edges, neighbours, duplicate faces and consistent winding.

Vertices (n, 3) are float64 [m], faces (m, 3) int64 of indices into them. A halfedge is one side of one face.
"""

from __future__ import annotations

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.mesh import component_labels


def halfedges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and end vertex (3m,) of each side of each face; side k of face f stands at k * m + f."""
    return faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel()


def edge_keys(faces: np.ndarray) -> np.ndarray:
    """(3m,) a number for each halfedge, the same for both directions."""
    start, end = halfedges(faces)
    return np.minimum(start, end) * (faces.max() + 1) + np.maximum(start, end)


def open_edges(faces: np.ndarray) -> np.ndarray:
    """(k,) halfedges whose edge is shared by an odd number of faces."""
    _, inverse, counts = np.unique(edge_keys(faces), return_inverse=True, return_counts=True)
    return np.flatnonzero(counts[inverse] % 2)


def without_duplicates(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """The faces without collapsed ones and duplicates; a face and its reverse enclose nothing and both are dropped."""
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    rotated = faces[np.arange(len(faces))[:, None], (faces.argmin(1)[:, None] + np.arange(3)) % 3]
    swapped = (rotated[:, 1] > rotated[:, 2]).astype(np.int64)
    lowest, low, high = rotated[:, 0], rotated[:, 1:].min(1), rotated[:, 1:].max(1)
    order = np.lexsort((swapped, high, low, lowest))
    same = np.ones(len(order), dtype=bool)
    for key in (lowest, low, high):
        same[1:] &= key[order][1:] == key[order][:-1]
    same[:1] = False
    group = np.cumsum(~same) - 1
    if not same.any():
        return faces
    forward = np.bincount(group, weights=swapped[order] == 0) > 0
    backward = np.bincount(group, weights=swapped[order] == 1) > 0
    keep = ~same & ~(forward & backward)[group]
    notes.append(f"dropped {len(faces) - int(keep.sum()):,} duplicate faces")
    return faces[np.sort(order[keep])]


def longest_side(vertices: np.ndarray) -> float:
    """Longest side of the bounding box."""
    return float(np.ptp(vertices, axis=0).max())


def unpaired_count(faces: np.ndarray) -> int:
    """Number of halfedges without one of the opposite direction."""
    start, end = halfedges(faces)
    _, inverse = np.unique(edge_keys(faces), return_inverse=True)
    return int(np.abs(np.bincount(inverse, weights=np.sign(start - end))).sum())


def consistently_wound(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> np.ndarray:
    """Faces flipped to agree with their neighbours; connected pieces in which faces were flipped point outward."""
    if not unpaired_count(faces):
        return faces
    piece, flip = _winding_flips(faces)
    flip_counts = np.bincount(piece, weights=flip.astype(np.float64))
    mixed = (flip_counts > 0) & (flip_counts < np.bincount(piece))
    flip &= mixed[piece]
    flipped = np.where(flip[:, None], faces[:, ::-1], faces)
    a, b, c = np.moveaxis(vertices[flipped] - vertices.mean(0), 1, 0)
    inward = np.bincount(piece, weights=np.einsum("mc,mc->m", a, np.cross(b, c))) < 0
    result = np.where((flip ^ (mixed & inward)[piece])[:, None], faces[:, ::-1], faces)
    if changed := int((result != faces).any(1).sum()):
        notes.append(f"flipped {changed:,} faces to agree with their neighbours")
    return result


def _winding_flips(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(m,) connected piece of each face, (m,) bool: whether it must be flipped to agree with the piece's first face.

    Each face is in a graph twice, as it is and flipped; an edge of two faces connects the states that agree.
    """
    count = len(faces)
    start = halfedges(faces)[0]
    keys = edge_keys(faces)
    order = np.argsort(keys, kind="stable")
    _, first, counts = np.unique(keys[order], return_index=True, return_counts=True)
    left, right = order[first[counts == 2]], order[first[counts == 2] + 1]
    opposed = (start[left] == start[right]).astype(np.int64)  # both run the same way: one must be flipped
    left, right = left % count, right % count
    rows = np.concatenate([left, left + count])
    columns = np.concatenate([right + opposed * count, right + (1 - opposed) * count])
    labels = component_labels(2 * count, rows, columns)
    as_is, flipped = labels[:count], labels[count:]
    if (as_is == flipped).any():
        raise MeshRefused("one-sided surface: its faces cannot be wound consistently")
    _, piece = np.unique(np.minimum(as_is, flipped), return_inverse=True)
    return piece, as_is > flipped
