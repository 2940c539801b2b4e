"""Reading 3MF files: the objects that the build names, placed, also from further model files of the archive.

Of the core specification and its production extension. Instances are counted before they are made, so that a small file
of nested components cannot fill the memory.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] (a compiled module)

from kit1000.errors import MeshRefused
from kit1000.numerics.linear_algebra import matmul

MAX_DEPTH = 32  # of components inside components
DEFAULT_UNIT = "millimeter"
ELEMENTS = ("{*}object", "{*}build", "{*}model")
XML_OPTIONS: dict[str, Any] = {
    "resolve_entities": False,
    "no_network": True,
    "huge_tree": True,
    "remove_comments": True,
}


@dataclass(frozen=True, eq=False)
class _Reference:
    """An object in a place: a component of another object, or an item of the build."""

    path: str
    """Model file of the archive, as by `_plain`."""
    object_id: str
    transform: np.ndarray
    """(4, 3): a row vector (x, y, z, 1) is multiplied from the left."""


@dataclass(eq=False)
class _Object:
    vertices: np.ndarray
    """(n, 3) in the unit of the file."""
    faces: np.ndarray
    """(m, 3)"""
    has_lattice: bool
    components: list[_Reference]


@dataclass(eq=False)
class _Model:
    """A model file of the archive."""

    unit: str = DEFAULT_UNIT
    objects: dict[str, _Object] = field(default_factory=dict)
    items: list[_Reference] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Built:
    """All that the build of a 3MF file names, as one soup."""

    vertices: np.ndarray
    """(n, 3) in the unit of the file."""
    faces: np.ndarray
    """(m, 3) int64"""
    unit: str
    """As in the file, for example millimeter."""
    has_lattice: bool
    """Whether there is a beam lattice, which has no triangles."""


def read_threemf(data: bytes, max_faces: int) -> Built:
    """The triangles of a 3MF file, at most `max_faces`. A damaged file may raise any exception."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        models = _Models(archive)
        root = models.read(models.root)
        count = sum(models.face_count(item) for item in root.items)
        if count > max_faces:
            raise MeshRefused(f"{count:,} triangles, more than {max_faces:,}")
        placed = [pair for item in root.items for pair in models.placed(item)]
    vertices, faces, start = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for body, transform in placed:
        vertices.append(matmul(body.vertices, transform[:3]) + transform[3])
        faces.append(body.faces + start)
        start += len(body.vertices)
    lattice = any(body.has_lattice for body, _ in placed)
    return Built(np.concatenate(vertices), np.concatenate(faces), root.unit, lattice)


class _Models:
    """The model files of an archive, each read when it is first named."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self.archive = archive
        self.names = {_plain(name): name for name in archive.namelist()}
        models = sorted(
            (name for name in self.names if name.endswith(".model")), key=lambda name: "3dmodel" not in name
        )
        if not models:
            raise MeshRefused("not readable as 3MF: no model file in the archive")
        self.root = "3d/3dmodel.model" if "3d/3dmodel.model" in models else models[0]
        self.known: dict[str, _Model] = {}
        self.counts: dict[tuple[str, str], int] = {}

    def read(self, path: str) -> _Model:
        """A model file by its plain path."""
        if path not in self.known:
            if path not in self.names:
                raise MeshRefused(f"not readable as 3MF: names {path[:80]}, which is not in the archive")
            with self.archive.open(self.names[path]) as file:
                self.known[path] = _parse(file, path)
        return self.known[path]

    def named(self, reference: _Reference) -> _Object:
        """The object of a reference."""
        objects = self.read(reference.path).objects
        if reference.object_id not in objects:
            raise MeshRefused(f"not readable as 3MF: no object {reference.object_id[:20]} in {reference.path[:80]}")
        return objects[reference.object_id]

    def face_count(self, reference: _Reference, depth: int = 0) -> int:
        """Number of faces of an object with all its components, each instance counted."""
        if depth > MAX_DEPTH:
            raise MeshRefused(f"not readable as 3MF: components nested more than {MAX_DEPTH} deep")
        key = reference.path, reference.object_id
        if key not in self.counts:
            named = self.named(reference)
            inner = sum(self.face_count(component, depth + 1) for component in named.components)
            self.counts[key] = max(len(named.faces) + inner, 1)
        return self.counts[key]

    def placed(self, reference: _Reference) -> list[tuple[_Object, np.ndarray]]:
        """The objects below a reference with their transforms (4, 3)."""
        named = self.named(reference)
        pairs = [(named, reference.transform)]
        for component in named.components:
            pairs += [(inner, _product(first, reference.transform)) for inner, first in self.placed(component)]
        return pairs


def _parse(file: Any, path: str) -> _Model:
    model = _Model()
    for _, element in etree.iterparse(file, tag=ELEMENTS, **XML_OPTIONS):
        kind = etree.QName(element).localname
        if kind == "object":
            model.objects[element.attrib["id"]] = _object(element, path)
            element.clear()
        elif kind == "build":
            model.items = [_reference(item, path) for item in element.iterfind("{*}item")]
        elif kind == "model":
            model.unit = element.attrib.get("unit", DEFAULT_UNIT)
    return model


def _object(element: Any, path: str) -> _Object:
    mesh = element.find("{*}mesh")
    components = [_reference(component, path) for component in element.iterfind("{*}components/{*}component")]
    if mesh is None:
        return _Object(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), False, components)
    corners = [[v.attrib[axis] for axis in "xyz"] for v in mesh.iterfind("{*}vertices/{*}vertex")]
    triangles = [[t.attrib[corner] for corner in ("v1", "v2", "v3")] for t in mesh.iterfind("{*}triangles/{*}triangle")]
    vertices = np.array(corners, dtype=np.float64).reshape(-1, 3)
    faces = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise MeshRefused(f"damaged: faces name vertex {faces.max():,} of {len(vertices):,}")
    return _Object(vertices, faces, mesh.find("{*}beamlattice") is not None, components)


def _reference(element: Any, path: str) -> _Reference:
    """A component or an item; its path, of the production extension, is absent for an object of the same file."""
    elsewhere = [value for name, value in element.attrib.items() if etree.QName(name).localname == "path"]
    numbers = np.array(element.attrib.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split(), dtype=np.float64)
    return _Reference(_plain(elsewhere[0]) if elsewhere else path, element.attrib["objectid"], numbers.reshape(4, 3))


def _product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(4, 3) the transform that applies one after the other."""
    return np.concatenate([matmul(first[:3], second[:3]), matmul(first[3:], second[:3]) + second[3]])


def _plain(path: str) -> str:
    return path.strip("/").lower()
