"""Mesh files: GLB (metres, y up, as in glTF) and STL (millimetres, z up, as in slicers).

Vertices are multiples of float32 steps, so a mesh read back equals the one written to the bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.errors import InputError, MeshRefused
from kit1000.mesh import Mesh, y_up, z_up
from kit1000.parts.files.gltf import glb_bodies
from kit1000.parts.files.stl import FACET

GLTF_BINARY, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
UNSIGNED_INT, FLOAT, TRIANGLES = 5125, 5126, 4
MAX_FACES = 10_000_000  # of one file that is read
ASSET = {"version": "2.0", "generator": "https://github.com/mikedh/trimesh"}  # trimesh wrote the first files


def glb_bytes(bodies: Mapping[str, Mesh], colours: Mapping[str, tuple[int, int, int]] | None = None) -> bytes:
    """Named bodies as one GLB. `colours`: sRGB 0..255 by name; bodies without one get no material."""
    file, materials, meshes = _GlbData(), [], []
    for name, mesh in bodies.items():
        indices = file.accessor(mesh.faces.astype("<u4").reshape(-1, 1), UNSIGNED_INT)
        position = file.accessor(y_up(mesh.vertices).astype("<f4"), FLOAT)
        primitive: dict[str, Any] = {"attributes": {"POSITION": position}, "indices": indices, "mode": TRIANGLES}
        if colours and name in colours:
            material = _material(colours[name])
            if material not in materials:
                materials.append(material)
            primitive["material"] = materials.index(material)
        meshes.append({"name": name, "extras": {}, "primitives": [primitive]})
    return file.packed(meshes, materials)


class _GlbData:
    """The arrays of a GLB, each stored once."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.buffers: list[bytes] = []

    def accessor(self, array: np.ndarray, component: int) -> int:
        """The index of the accessor of an array (n, 1) or (n, 3)."""
        data = array.tobytes()
        if data not in self.buffers:
            self.buffers.append(data)
        entry = {"componentType": component, "type": "SCALAR" if array.shape[1] == 1 else "VEC3"}
        entry |= {"byteOffset": 0} if component == FLOAT else {}
        entry |= {"bufferView": self.buffers.index(data), "count": len(array)}
        entry |= {name: bound.tolist() for name, bound in _bounds(array).items()}
        if entry not in self.accessors:
            self.accessors.append(entry)
        return self.accessors.index(entry)

    def packed(self, meshes: list[dict[str, Any]], materials: list[dict[str, Any]]) -> bytes:
        """The bytes of a GLB of meshes, each a node of its own."""
        starts = np.cumsum([0, *map(len, self.buffers)]).tolist()
        views = [
            {"buffer": 0, "byteOffset": start, "byteLength": len(data)}
            for start, data in zip(starts, self.buffers, strict=False)
        ]
        tree = {"scene": 0, "scenes": [{"nodes": list(range(len(meshes)))}], "asset": ASSET}
        tree |= {"accessors": self.accessors, "meshes": meshes} | ({"materials": materials} if materials else {})
        tree |= {"nodes": [{"name": mesh["name"], "mesh": number} for number, mesh in enumerate(meshes)]}
        tree |= {"buffers": [{"byteLength": starts[-1]}], "bufferViews": views}
        content = json.dumps(tree, separators=(",", ":"))
        content += (4 - len(content) % 4) * " "
        head = [GLTF_BINARY, 2, len(content) + starts[-1] + 28, len(content), JSON_CHUNK]
        chunks = [_words(head), content.encode(), _words([starts[-1], BINARY_CHUNK]), *self.buffers]
        return b"".join(chunks)


def _bounds(array: np.ndarray) -> dict[str, np.ndarray]:
    """(k,) each: the largest and the least of columns (n, k), 0.0 where zeros of both signs are.

    Which of these is the largest depends on the processor.
    """
    bounds = {"max": array.max(axis=0), "min": array.min(axis=0)}
    if array.dtype.kind != "f":
        return bounds
    positive = ((array == 0) & ~np.signbit(array)).any(axis=0)
    return {name: np.where((bound == 0) & positive, np.abs(bound), bound) for name, bound in bounds.items()}


def _words(numbers: list[int]) -> bytes:
    return np.array(numbers, "<u4").tobytes()


def _material(colour: tuple[int, int, int]) -> dict[str, Any]:
    """A matt material of an sRGB colour."""
    linear = [round((channel / 255) ** 2.2 * 255) / 255 for channel in colour]
    surface = {"baseColorFactor": [*linear, 1.0], "roughnessFactor": 0.6, "metallicFactor": 0.0}
    return {"pbrMetallicRoughness": surface, "doubleSided": False}


def read_glb(path: Path) -> dict[str, Mesh]:
    """The bodies of a GLB, by name, z up. Raises InputError if the file is missing or no GLB."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    try:
        bodies = glb_bodies(data, MAX_FACES)
        return {body.name: Mesh(z_up(body.vertices), body.faces) for body in bodies}
    except MeshRefused as refused:
        raise InputError(f"cannot read {path}: {refused.reason}") from None
    except Exception as error:  # the reader may raise anything on damaged bytes
        raise InputError(f"cannot read {path}: damaged or no GLB ({type(error).__name__}: {error})") from error


def stl_bytes(mesh: Mesh) -> bytes:
    """A mesh as a binary STL in millimetres, z up, ready for a slicer."""
    facets = np.zeros(len(mesh.faces), FACET)
    facets["normal"], facets["corners"] = mesh.normals, mesh.triangles * 1e3
    return bytes(80) + _words([len(facets)]) + facets.tobytes()
