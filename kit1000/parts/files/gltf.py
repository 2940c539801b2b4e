"""Reading GLB files: trimesh reads them, after everything that it would read wrong has been refused by name.

A GLB is glTF 2.0 in one file. trimesh reads positions as they are stored, without the sparse, normalized, morphed or
compressed ones of the standard.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from kit1000.errors import MeshRefused, shown
from kit1000.numerics.linear_algebra import determinant, matmul
from kit1000.parts.files.file_text import check_foreign
from kit1000.parts.files.triangles import check_indices, float32_step

MAGIC = b"glTF"
FLOAT = 5126
TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives that have triangles
SHAPES = {
    "KHR_draco_mesh_compression": "Draco compression",
    "EXT_meshopt_compression": "meshopt compression",
    "KHR_meshopt_compression": "meshopt compression",
    "EXT_mesh_gpu_instancing": "instances of meshes",
    "KHR_node_visibility": "invisible nodes",
}
"""Extensions that change the shape, and what they are."""
SHAPELESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "EXT_lights_", "KHR_lights_", "KHR_xmp", "MSFT_texture_")
SHAPELESS += ("MSFT_packing_", "KHR_animation_pointer", "ADOBE_materials_", "EXT_materials_", "FB_ngon_encoding")
SHAPELESS += ("KHR_mesh_quantization",)  # quantized positions are refused by their type
"""Beginnings of the names of extensions that do not change the shape."""


@dataclass(frozen=True, eq=False)
class Body:
    """A placed mesh of a GLB file."""

    name: str
    vertices: np.ndarray  # (n, 3) float64 [m], y up
    faces: np.ndarray  # (m, 3) int64
    step: float  # distance between two coordinates that the file can tell apart. [m]


def glb_bodies(data: bytes, max_faces: int) -> list[Body]:
    """The bodies of a GLB file in the order of its meshes, with at most `max_faces` triangles.

    A damaged file may raise any exception.
    """
    check_foreign(data)
    text = _json_text(data)
    tree = _tree(text)
    _check_extensions(tree, text)
    _check_primitives(tree)
    _check_nodes(tree, max_faces)
    import trimesh  # only here: its import takes longer than reading most files

    scene: Any = trimesh.load_scene(io.BytesIO(data), file_type="glb", process=False)
    order = {name: number for number, name in enumerate(scene.geometry)}
    nodes = [(scene.graph[node], node) for node in scene.graph.nodes_geometry]
    nodes.sort(key=lambda row: (order[row[0][1]], row[1]))
    placed = ((scene.geometry[name], str(name), matrix) for (matrix, name), _ in nodes)
    return [_placed(*row) for row in placed if len(getattr(row[0], "faces", ()))]


def _placed(mesh: Any, name: str, matrix: np.ndarray) -> Body:
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    check_indices(faces, len(vertices), "glTF")
    step = float32_step(vertices)
    if np.array_equal(matrix, np.eye(4)):
        return Body(name, vertices, faces, step)
    linear = np.array(matrix[:3, :3])
    placed = matmul(vertices, np.ascontiguousarray(linear.T)) + matrix[:3, 3]
    step *= float(np.linalg.norm(linear, axis=0).max())
    return Body(name, placed, faces if determinant(linear) >= 0 else faces[:, ::-1], step)


def _json_text(data: bytes) -> bytes:
    """The JSON part of a file."""
    if data[:4] != MAGIC:
        raise MeshRefused("not readable as GLB: its first bytes are not glTF")
    version, length, size = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8, 12))
    if version != 2:
        raise MeshRefused(f"GLB of version {version}, expected 2: export it again as glTF 2.0")
    if len(data) < length or data[16:20] != b"JSON":
        raise MeshRefused(f"not readable as GLB: cut short or damaged, {len(data):,} of {length:,} bytes")
    return data[20 : 20 + size]


def _tree(text: bytes) -> dict[str, Any]:
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError):
        tree = None
    if not isinstance(tree, dict):
        raise MeshRefused("not readable as glTF: its JSON part is damaged")
    stated = str(tree.get("asset", {}).get("version", "2.0"))
    if not stated.startswith("2."):
        raise MeshRefused(f"glTF of version {stated[:20]}, expected 2.0: export it again")
    if any("uri" in buffer for buffer in tree.get("buffers", [])):
        raise MeshRefused("its data are in further files, which are not read: export it as one GLB file")
    return tree


def _check_extensions(tree: dict[str, Any], text: bytes) -> None:
    """Raise MeshRefused if an extension changes the shape, or if an unknown one is required."""
    for name, what in SHAPES.items():
        if f'"{name}"'.encode() in text:
            raise MeshRefused(f"holds {what} ({name}), which is not read: export it without")
    for name in map(str, tree.get("extensionsRequired", [])):
        if not name.startswith(SHAPELESS):
            raise MeshRefused(f"requires the glTF extension {shown(name[:80])}, which is not read: export it without")


def _check_primitives(tree: dict[str, Any]) -> None:
    """Raise MeshRefused if positions or indices are stored in a way that trimesh does not read."""
    for number, entry in enumerate(tree.get("accessors", [])):
        if "sparse" in entry or "bufferView" not in entry:
            raise MeshRefused(f"accessor {number} is sparse or has no data, which is not read: export it without")
        if not isinstance(entry.get("count"), int) or entry["count"] < 0:
            raise MeshRefused(f"not readable as glTF: accessor {number} has no count")
    for primitive in (primitive for mesh in tree.get("meshes", []) for primitive in mesh["primitives"]):
        if primitive.get("mode", TRIANGLES) == FAN:
            raise MeshRefused("holds fans of triangles, which are not read: export it as triangles")
        position = tree["accessors"][primitive["attributes"]["POSITION"]]
        if (position["componentType"], position["type"]) != (FLOAT, "VEC3") or position.get("normalized"):
            raise MeshRefused("holds quantized positions, which are not read: export it with 32-bit floats")
        if "indices" in primitive and tree["accessors"][primitive["indices"]]["componentType"] == FLOAT:
            raise MeshRefused("not readable as glTF: indices that are no integers")


def _check_nodes(tree: dict[str, Any], max_faces: int) -> None:
    """Raise MeshRefused for nodes that trimesh would leave out, for skins and morph targets, and for too many faces."""
    nodes, meshes = tree.get("nodes", []), tree.get("meshes", [])
    if nodes and not tree.get("scenes"):
        raise MeshRefused("holds no scene: export it again with a scene")
    children = [child for node in nodes for child in node.get("children", [])]
    roots = list(tree["scenes"][tree.get("scene", 0)].get("nodes", [])) if nodes else []
    if len(children) != len(set(children)) or set(roots) & set(children) or len(roots) != len(set(roots)):
        raise MeshRefused("not readable as glTF: a node that stands in two places")
    if any("camera" in node and (node.get("children") or "mesh" in node) for node in nodes):
        raise MeshRefused("holds a camera with further nodes below it, which is not read: export it without cameras")
    count = 0
    for node in (node for node in nodes if "mesh" in node):
        mesh = meshes[node["mesh"]]
        if "skin" in node:
            raise MeshRefused("its mesh is bent by a skeleton (skin): apply the armature before the export")
        if any(node.get("weights", mesh.get("weights", []))):
            raise MeshRefused("its mesh is changed by morph targets (shape keys): apply them before the export")
        count += sum(_face_counts(tree, mesh))
    if count > max_faces:
        raise MeshRefused(f"{count:,} triangles, more than {max_faces:,}")


def _face_counts(tree: dict[str, Any], mesh: dict[str, Any]) -> Iterator[int]:
    for primitive in mesh["primitives"]:
        mode = primitive.get("mode", TRIANGLES)
        if mode in (TRIANGLES, STRIP):
            accessor = primitive.get("indices", primitive["attributes"]["POSITION"])
            count = tree["accessors"][accessor]["count"]
            yield count // 3 if mode == TRIANGLES else max(count - 2, 0)
