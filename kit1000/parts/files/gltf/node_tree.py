"""The scene of a glTF file as triangles: nodes with their transforms, strips and fans, instances and morph targets.

Triangles are counted before they are made, so that a small file of many instances cannot fill the memory. Coordinates
stay those of the file: y up.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.numerics.linear_algebra import matmul
from kit1000.parts.files.gltf.accessors import count_of, floats, integers
from kit1000.parts.files.gltf.document import Document, read_document
from kit1000.parts.files.gltf.required_extensions import DRACO, INSTANCES, VISIBILITY, check_required
from kit1000.parts.files.soup import TriangleSoup, check_indices, joined

TRIANGLES, STRIP, FAN = 4, 5, 6  # modes of primitives with triangles
MAX_DEPTH = 64  # of nodes inside nodes


def read_gltf(data: bytes, folder: Path, max_faces: int) -> TriangleSoup:
    """The triangles of a .glb or .gltf file, in metres, y up. A damaged file may raise any exception.

    folder: holds the further files that a .gltf names.
    """
    document = read_document(data, folder)
    check_required(document.json)
    scene = _Scene(document, max_faces)
    placed = [scene.placed(mesh, weights, matrix) for mesh, weights, matrix in scene.instances()]
    vertices, faces = joined(placed)
    return TriangleSoup(vertices, faces, "m", scene.notes())


class _Scene:
    """Walks from nodes to meshes."""

    def __init__(self, document: Document, max_faces: int) -> None:
        self.document, self.max_faces = document, max_faces
        self.hidden = self.flat = 0
        self._meshes: dict[tuple[int, tuple[float, ...]], tuple[np.ndarray, np.ndarray]] = {}
        self._counts: dict[int, int] = {}

    def notes(self) -> tuple[str, ...]:
        """What was left out."""
        hidden = [f"left out {self.hidden} invisible node{'' if self.hidden == 1 else 's'}"] if self.hidden else []
        return (*hidden, *(["ignored points and lines, which have no triangles"] if self.flat else []))

    def instances(self) -> list[tuple[int, tuple[float, ...], np.ndarray]]:
        """(mesh, morph weights, matrix) of each instance in the scene. Raises MeshRefused for too many triangles."""
        found, total = [], 0
        for root in self._roots():
            for mesh, weights, matrix in self._below(root, np.eye(4), 0):
                total += max(self._face_count(mesh), 1)
                if total > self.max_faces:
                    raise MeshRefused(f"more than {self.max_faces:,} triangles")
                found.append((mesh, weights, matrix))
        return found

    def placed(self, mesh: int, weights: tuple[float, ...], matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces of an instance."""
        if (mesh, weights) not in self._meshes:
            primitives = self.document.entry("meshes", mesh).get("primitives", [])
            self._meshes[mesh, weights] = joined([self._primitive(primitive, weights) for primitive in primitives])
        vertices, faces = self._meshes[mesh, weights]
        moved = matmul(vertices, matrix[:3, :3].T) + matrix[:3, 3]
        return moved, faces if np.linalg.det(matrix[:3, :3]) >= 0 else faces[:, ::-1]

    def _roots(self) -> list[int]:
        """The nodes of the default scene, else of the first; where there is none, all that are no child."""
        if self.document.entries("scenes"):
            return list(self.document.entry("scenes", self.document.json.get("scene", 0)).get("nodes", []))
        nodes = self.document.entries("nodes")
        children = {child for node in nodes for child in node.get("children", [])}
        return [number for number in range(len(nodes)) if number not in children]

    def _below(self, number: int, outer: np.ndarray, depth: int) -> Iterator[tuple[int, tuple[float, ...], np.ndarray]]:
        if depth > MAX_DEPTH:
            raise MeshRefused(f"not readable as glTF: nodes nested more than {MAX_DEPTH} deep")
        node = self.document.entry("nodes", number)
        if node.get("extensions", {}).get(VISIBILITY, {}).get("visible", True) is False:
            self.hidden += 1
            return
        matrix = matmul(outer, _matrix(node))
        if "mesh" in node:
            if "skin" in node:
                raise MeshRefused("its mesh is bent by a skeleton (skin): apply the armature before the export")
            weights = node.get("weights") or self.document.entry("meshes", node["mesh"]).get("weights") or []
            for instance in self._repeats(node):
                yield node["mesh"], tuple(map(float, weights)), matmul(matrix, instance)
        for child in node.get("children", []):
            yield from self._below(child, matrix, depth + 1)

    def _repeats(self, node: dict[str, Any]) -> Iterator[np.ndarray]:
        """(4, 4) the places of a mesh within its node: one, or those of the instances."""
        attributes = node.get("extensions", {}).get(INSTANCES, {}).get("attributes", {})
        columns = {name: attributes[name] for name in ("TRANSLATION", "ROTATION", "SCALE") if name in attributes}
        if not columns:
            yield np.eye(4)
            return
        n = min(count_of(self.document, index) for index in columns.values())
        if n > self.max_faces:
            raise MeshRefused(f"{n:,} instances, more than {self.max_faces:,} triangles")
        parts = {name: floats(self.document, index, 4 if name == "ROTATION" else 3) for name, index in columns.items()}
        for k in range(n):
            yield _matrix({name.lower(): values[k].tolist() for name, values in parts.items()})

    def _face_count(self, mesh: int) -> int:
        if mesh not in self._counts:
            total = 0
            for primitive in self.document.entry("meshes", mesh).get("primitives", []):
                mode = primitive.get("mode", TRIANGLES)
                accessor = primitive.get("indices", primitive.get("attributes", {}).get("POSITION"))
                if accessor is not None and mode in (TRIANGLES, STRIP, FAN):
                    count = count_of(self.document, accessor)
                    total += count // 3 if mode == TRIANGLES else max(count - 2, 0)
            self._counts[mesh] = total
        return self._counts[mesh]

    def _primitive(self, primitive: dict[str, Any], weights: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces of a primitive; none for points and lines."""
        mode = primitive.get("mode", TRIANGLES)
        attributes = primitive.get("attributes", {})
        if mode not in (TRIANGLES, STRIP, FAN) or "POSITION" not in attributes:
            self.flat += 1
            return joined([])
        stored = self.document.entry("accessors", attributes["POSITION"])
        if DRACO in primitive.get("extensions", {}) and "bufferView" not in stored and "sparse" not in stored:
            raise MeshRefused(f"is stored with Draco compression ({DRACO}), which is not supported: export it without")
        vertices = floats(self.document, attributes["POSITION"], 3)
        for target, weight in zip(primitive.get("targets", []), weights, strict=False):
            if weight and "POSITION" in target:
                vertices = vertices + weight * floats(self.document, target["POSITION"], 3)
        if "indices" in primitive:
            order = integers(self.document, primitive["indices"])[:, 0]
        else:
            order = np.arange(len(vertices))
        faces = _faces(order, mode)
        check_indices(faces, len(vertices), "damaged")
        return vertices, faces


def _faces(order: np.ndarray, mode: int) -> np.ndarray:
    """(m, 3) the faces of vertices in order: each three, a strip, or a fan."""
    if mode == TRIANGLES:
        if len(order) % 3:
            raise MeshRefused(f"damaged: {len(order):,} corners are no whole number of triangles")
        return order.reshape(-1, 3)
    if len(order) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == FAN:
        return np.stack([order[1:-1], order[2:], np.full(len(order) - 2, order[0])], axis=1)
    strip = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
    strip[1::2] = strip[1::2][:, [0, 2, 1]]
    return strip


def _matrix(node: dict[str, Any]) -> np.ndarray:
    """(4, 4) the transform of a node: its matrix, or translation after rotation after scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = (np.array(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)).tolist()
    length = float(np.sqrt(x * x + y * y + z * z + w * w)) or 1.0
    x, y, z, w = x / length, y / length, z / length, w / length
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix
