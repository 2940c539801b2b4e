"""Objects of a BOP dataset: numbers, models as PLY in millimetres, and the entries of `models_info.json`.

The origin of a part's model is the part's centroid, which every symmetry fixes; that of an assembly is at its foot, as
elsewhere in KIT1000. BOP specifies the centre of the bounding box, on which no tool relies.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

from kit1000.dataset.geometry import Geometry
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.queries.tracks import SPLITS
from kit1000.symmetry import Symmetry

MM = 1e3  # per metre
PART, ASSEMBLY = "part", "assembly"
KINDS = {PART: "parts", ASSEMBLY: "assemblies"}  # table of each kind


def object_numbers(geometry: Geometry) -> dict[tuple[str, str], int]:
    """The BOP number of every object of a dataset by kind and id, also of objects that are not exported.

    Numbers follow the splits, in each the parts before the assemblies: without a withheld test split they are the same.
    """
    numbers: dict[tuple[str, str], int] = {}
    for split in SPLITS:
        for kind, table in KINDS.items():
            rows = getattr(geometry, table)
            for item_id in sorted(i for i, row in rows.items() if row["split"] == split):
                numbers[kind, item_id] = len(numbers) + 1
    return numbers


def model_info(mesh: Mesh, symmetry: Symmetry) -> dict[str, Any]:
    """The entry of a model in `models_info.json`, in millimetres; symmetries rotate about the origin."""
    low, size = MM * mesh.bounds[0], MM * mesh.extents
    info: dict[str, Any] = {"diameter": MM * diameter(mesh)}
    info |= {f"min_{axis}": float(low[i]) for i, axis in enumerate("xyz")}
    info |= {f"size_{axis}": float(size[i]) for i, axis in enumerate("xyz")}
    if symmetry.order > 1:  # without the identity, which is first
        rotations = Pose(symmetry.rotations[1:], np.zeros(3)).matrix()
        info["symmetries_discrete"] = rotations.reshape(-1, 16).tolist()
    if symmetry.axis is not None:
        info["symmetries_continuous"] = [{"axis": symmetry.axis.tolist(), "offset": [0.0, 0.0, 0.0]}]
    return info


def diameter(mesh: Mesh) -> float:
    """The largest distance [m] between two vertices, found among those of the convex hull."""
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
    """(n, 3) unit normals of the vertices: means of the adjacent face normals, weighted by angle; zero if undefined."""
    sides = np.roll(mesh.triangles, -1, axis=1) - mesh.triangles  # side i leaves corner i
    back = -np.roll(sides, 1, axis=1)
    crosses = np.linalg.norm(np.cross(sides, back), axis=-1)
    angles = np.arctan2(crosses, np.sum(sides * back, axis=-1))
    sums = np.zeros_like(mesh.vertices)
    np.add.at(sums, mesh.faces, angles[..., None] * mesh.normals[:, None])
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 1e-9)
