"""Repair of a triangle soup to a closed, consistently wound, outward surface; or refusal with one line.

In order: equal vertices are merged, collapsed and duplicate faces dropped, open edges closed where that is safe, and
faces flipped to agree with their neighbours. Vertices (n, 3) float64 [m], faces (m, 3) int64.
"""

from __future__ import annotations

import numpy as np
from manifold3d import Error, Manifold, Mesh64

from kit1000.errors import MeshRefused
from kit1000.numerics.linear_algebra import eigenvectors, matmul
from kit1000.parts.files.closing import close_surface
from kit1000.parts.files.topology import (
    consistently_wound,
    longest_side,
    open_edges,
    unpaired_count,
    without_duplicates,
)

SHEET_SHARE = 1e-6  # of the longest side: a soup thinner than this is a sheet


def closed_solid(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> Manifold:
    """The exact solid that a triangle soup bounds; a note of each repair is appended to `notes`.

    Raises:
        MeshRefused: with the reason and its count.
    """
    faces = without_duplicates(vertices, _with_equal_vertices_merged(vertices, faces), notes)
    vertices, faces = _compact(vertices, faces)
    if not len(faces) or _is_sheet(vertices):
        raise MeshRefused("zero thickness")
    if len(open_edges(faces)):
        vertices, faces = close_surface(vertices, faces, notes)
    faces = consistently_wound(vertices, faces, notes)
    solid = Manifold(Mesh64(vertices, faces.astype(np.uint64)))
    if solid.status() != Error.NoError:
        raise MeshRefused(f"not closed: {unpaired_count(faces)} edges without a partner ({solid.status().name})")
    if solid.volume() < 0:
        notes.append("flipped inside out")
        solid = inverted(solid)
    return solid


def inverted(solid: Manifold) -> Manifold:
    """The same surface with the opposite winding."""
    raw = solid.to_mesh64()
    flipped = np.ascontiguousarray(raw.tri_verts[:, ::-1])
    return Manifold(Mesh64(np.array(raw.vert_properties), flipped))


def _with_equal_vertices_merged(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The faces, with the index of each vertex replaced by that of the first equal one."""
    rows = vertices + 0.0  # -0.0 becomes 0.0
    order = np.lexsort(rows.T)  # stable: equal vertices stay in the order of the file
    is_new = np.ones(len(rows), dtype=bool)
    is_new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(1)
    first = np.empty(len(rows), dtype=np.int64)
    first[order] = order[is_new][np.cumsum(is_new) - 1]
    return first[faces]


def _compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices that faces use, sorted by position: the result does not depend on the order in the file."""
    used, inverse = np.unique(faces, return_inverse=True)
    order = np.lexsort(vertices[used].T[::-1])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return vertices[used][order] + 0.0, rank[inverse].reshape(-1, 3)


def _is_sheet(vertices: np.ndarray) -> bool:
    """Whether all vertices lie in one plane, however it is tilted."""
    centred = vertices - vertices.mean(0)
    normal = eigenvectors(matmul(centred.T, centred))[:, 0]
    return bool(np.ptp(matmul(centred, normal)) <= SHEET_SHARE * longest_side(vertices))
