"""Objects of a BOP dataset: their numbers, their models as PLY in millimetres, and what is said of those.

A part's model has its origin at the part's centroid, which every symmetry fixes; that of an assembly in its foot, as
everywhere in KIT1000. BOP asks for the middle of the box, which no tool relies on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from kit1000.dataset.geometry import Geometry
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.tracks import SPLITS

MM = 1e3  # a metre
PART, ASSEMBLY = "part", "assembly"
KINDS = {PART: "parts", ASSEMBLY: "assemblies"}  # the table of each


def object_numbers(geometry: Geometry) -> dict[tuple[str, str], int]:
    """BOP's number of every object of a dataset, by its kind and id, whatever part of it is exported.

    Split by split, its parts, then its assemblies: a dataset whose test split is withheld numbers the rest alike.
    """
    numbers: dict[tuple[str, str], int] = {}
    for split in SPLITS:
        for kind, table in KINDS.items():
            rows = getattr(geometry, table)
            for item_id in sorted(i for i, row in rows.items() if row["split"] == split):
                numbers[kind, item_id] = len(numbers) + 1
    return numbers


def model_info(mesh: Mesh, symmetry: Symmetry) -> dict[str, Any]:
    """The entry of a model in `models_info.json`, in millimetres; symmetries turn about the origin."""
    low, size = MM * mesh.bounds[0], MM * mesh.extents
    info: dict[str, Any] = {"diameter": MM * diameter(mesh)}
    info |= {f"min_{axis}": float(low[i]) for i, axis in enumerate("xyz")}
    info |= {f"size_{axis}": float(size[i]) for i, axis in enumerate("xyz")}
    if symmetry.order > 1:  # the identity, listed first, goes without saying
        turns = Pose(symmetry.rotations[1:], np.zeros(3)).matrix()
        info["symmetries_discrete"] = turns.reshape(-1, 16).tolist()
    if symmetry.axis is not None:
        info["symmetries_continuous"] = [{"axis": symmetry.axis.tolist(), "offset": [0.0, 0.0, 0.0]}]
    return info


def diameter(mesh: Mesh) -> float:
    """[m] the largest distance between two vertices, which are vertices of the convex hull."""
    corners = mesh.vertices[ConvexHull(mesh.vertices).vertices]
    return float(pdist(corners).max())


def ply_bytes(mesh: Mesh) -> bytes:
    """A mesh as ASCII PLY in millimetres with vertex normals."""
    rows = np.hstack([MM * mesh.vertices, vertex_normals(mesh)]).tolist()
    properties = [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    lines = [
        "ply",
        "format ascii 1.0",
        "comment KIT1000, millimetres",
        f"element vertex {len(mesh.vertices)}",
        *properties,
        f"element face {len(mesh.faces)}",
        "property list uchar int vertex_indices",
        "end_header",
        *(f"{x!r} {y!r} {z!r} {a:.6f} {b:.6f} {c:.6f}" for x, y, z, a, b, c in rows),
        *(f"3 {a} {b} {c}" for a, b, c in mesh.faces.tolist()),
    ]
    return ("\n".join(lines) + "\n").encode("ascii")


def vertex_normals(mesh: Mesh) -> np.ndarray:
    """(n, 3) unit normals: those of the faces around a vertex, by the angle each has there; zero where none has one."""
    sides = np.roll(mesh.triangles, -1, axis=1) - mesh.triangles  # side i leaves corner i
    back = -np.roll(sides, 1, axis=1)
    crosses = np.linalg.norm(np.cross(sides, back), axis=-1)
    angles = np.arctan2(crosses, np.sum(sides * back, axis=-1))
    sums = np.zeros_like(mesh.vertices)
    np.add.at(sums, mesh.faces, angles[..., None] * mesh.normals[:, None])
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 1e-9)
