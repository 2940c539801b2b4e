"""The model files of a 3MF archive: objects as meshes or components, and the items of the build.

Of the core specification and its production extension. A model is read when it is first named.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] (a compiled module)

from kit1000.errors import MeshRefused
from kit1000.parts.files.threemf.extensions import check_required, shape_fault
from kit1000.parts.files.threemf.package import XML_OPTIONS, Package
from kit1000.parts.files.threemf.roles import PART, TRUE, TriangleRange, inline_ranges, object_role

UNITS = {"micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "inch": 0.0254, "foot": 0.3048, "meter": 1.0}
"""[m] by the names in a model."""
DEFAULT_UNIT = "millimeter"
ELEMENTS = ("{*}object", "{*}build", "{*}model")
IDENTITY = "1 0 0 0 1 0 0 0 1 0 0 0"


@dataclass(frozen=True, eq=False)
class Reference:
    """An object in a place: a component of another object, or an item of the build."""

    path: str
    """Model file of the archive, by its plain name."""
    object_id: str
    transform: np.ndarray
    """(4, 3): a row vector (x, y, z, 1) is multiplied from the left; in the unit of the model with the reference."""
    printable: bool = True


@dataclass(eq=False)
class Object:
    """A mesh, an assembly of components, or both."""

    vertices: np.ndarray
    """(n, 3) in the unit of its model."""
    faces: np.ndarray
    """(m, 3)"""
    has_lattice: bool
    components: list[Reference]
    role: str = PART
    """Role by its type, or by what Cura says of it."""
    ranges: tuple[TriangleRange, ...] = ()
    """Its volumes, where Slic3r writes them into the object."""
    fault: str | None = None
    """Why it cannot be built."""


@dataclass(eq=False)
class Model:
    """A model file of the archive."""

    unit: str = DEFAULT_UNIT
    objects: dict[str, Object] = field(default_factory=dict)
    items: list[Reference] = field(default_factory=list)

    @property
    def metres(self) -> float:
        """[m] length of its unit."""
        return UNITS[self.unit]


class Models:
    """The models of an archive."""

    def __init__(self, package: Package) -> None:
        self.package = package
        self.root = package.root()
        self._known: dict[str, Model] = {}

    def read(self, path: str) -> Model:
        """A model file by its plain name."""
        if path not in self._known:
            with self.package.open(path) as file:
                self._known[path] = _parse(file, path, self.package)
        return self._known[path]

    def named(self, reference: Reference) -> Object:
        """The object of a reference. Raises MeshRefused for one that is missing, or that is no mesh."""
        objects = self.read(reference.path).objects
        if reference.object_id not in objects:
            raise MeshRefused(f"not readable as 3MF: no object {reference.object_id[:20]} in {reference.path[:80]}")
        found = objects[reference.object_id]
        if found.fault is not None:
            raise MeshRefused(found.fault)
        return found


def _parse(file: Any, path: str, package: Package) -> Model:
    model = Model()
    for _, element in etree.iterparse(file, tag=ELEMENTS, **XML_OPTIONS):
        kind = etree.QName(element).localname
        if kind == "object":
            model.objects[element.attrib["id"]] = _object(element, path, package)
            element.clear()
        elif kind == "build":
            model.items = [_reference(item, path, package) for item in element.iterfind("{*}item")]
        elif kind == "model":
            check_required(element, path)
            model.unit = element.get("unit", DEFAULT_UNIT).lower()
            if model.unit not in UNITS:
                raise MeshRefused(f"not readable as 3MF: unknown unit {model.unit[:40]!r}, expected {', '.join(UNITS)}")
    return model


def _object(element: Any, path: str, package: Package) -> Object:
    mesh = element.find("{*}mesh")
    components = [_reference(component, path, package) for component in element.iterfind("{*}components/{*}component")]
    vertices, faces = (np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)) if mesh is None else _mesh(mesh)
    has_lattice = mesh is not None and mesh.find("{*}beamlattice") is not None
    role, ranges = object_role(element), inline_ranges(element)
    return Object(vertices, faces, has_lattice, components, role, ranges, shape_fault(element))


def _mesh(mesh: Any) -> tuple[np.ndarray, np.ndarray]:
    corners = [[v.attrib[axis] for axis in "xyz"] for v in mesh.iterfind("{*}vertices/{*}vertex")]
    triangles = [[t.attrib[corner] for corner in ("v1", "v2", "v3")] for t in mesh.iterfind("{*}triangles/{*}triangle")]
    vertices = np.array(corners, dtype=np.float64).reshape(-1, 3)
    faces = np.array(triangles, dtype=np.int64).reshape(-1, 3)
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        raise MeshRefused(f"damaged: faces name vertex {faces.max():,} of {len(vertices):,}")
    return vertices, faces


def _reference(element: Any, path: str, package: Package) -> Reference:
    """A component or an item; its path, of the production extension, is absent for an object of the same file."""
    by_name = {etree.QName(name).localname: value for name, value in element.attrib.items()}
    place = package.located(by_name["path"], path) if "path" in by_name else path
    numbers = np.array(by_name.get("transform", IDENTITY).split(), dtype=np.float64)
    printable = by_name.get("printable", "1").lower() in TRUE
    return Reference(place, element.attrib["objectid"], numbers.reshape(4, 3), printable)
