"""Reading 3MF files: the core specification, and nothing that a slicer adds.

Objects of the build are read with their components and placed. Objects in further model files, a volume that a slicer
does not print as part of the object, an item that is not printed, a shape that is no mesh and an unknown required
extension are refused by name.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from typing import IO, Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] (a compiled module)

from kit1000.errors import MeshRefused, shown
from kit1000.numerics.linear_algebra import determinant, matmul
from kit1000.parts.files.triangles import TriangleSoup, check_indices, decimal_step, joined

UNIT_NAMES = {"micron": "micron", "millimeter": "mm", "centimeter": "cm", "inch": "inch", "foot": "foot", "meter": "m"}
XML_OPTIONS: dict[str, Any] = {"resolve_entities": False, "no_network": True, "huge_tree": True}
XML_OPTIONS |= {"remove_comments": True}
HARMLESS_EXTENSIONS = ("production", "material", "trianglesets", "slice")  # words of their addresses
OBJECT_CONTENT = ("mesh", "components", "metadatagroup", "metadata", "settings", "volumes")
CURA_ROLES = ("infill_mesh", "cutting_mesh", "support_mesh", "anti_overhang_mesh")
PART_ROLES = ("modelpart", "normalpart")  # as slicers write it, in lower case without underscores
CONFIG_ENDS = ("_model.config", "model_settings.config")
TRUE = ("1", "true", "yes")
IDENTITY = "1 0 0 0 1 0 0 0 1 0 0 0"
MAX_DEPTH = 32  # of components inside components
ALONE = "export the part alone, as STL or as 3MF"


def read_threemf(data: bytes, max_faces: int) -> TriangleSoup:
    """The triangles of the build of a 3MF file, at most `max_faces`. A damaged file may raise any exception."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = {_plain(name): name for name in archive.namelist()}
        for name in sorted(names):
            if name.startswith("metadata/") and name.endswith(CONFIG_ENDS):
                for element in _xml(archive, names[name]).iter("{*}volume", "{*}part"):
                    _check_role(element)
        with archive.open(names[_root_name(archive, names)]) as file:
            model = _Model(file)
    if not model.items:
        raise MeshRefused("its build is empty, as in a project without a plate: save it with the part on the plate")
    if sum(model.face_count(item.object_id) for item in model.items) > max_faces:
        raise MeshRefused(f"more than {max_faces:,} triangles")
    vertices, faces = joined([mesh for item in model.items for mesh in model.meshes(item)])
    return TriangleSoup(vertices, faces, UNIT_NAMES[model.unit], decimal_step(vertices))


def _root_name(archive: zipfile.ZipFile, names: dict[str, str]) -> str:
    """The plain name of the root model: the one that the relationships name, else the usual or the only one."""
    for element in _xml(archive, names["_rels/.rels"]) if "_rels/.rels" in names else ():
        if element.get("Type", "").lower().endswith("/3dmodel"):
            target = element.get("Target", "")
            if _plain(target) not in names:
                raise MeshRefused(f"not readable as 3MF: names {shown(target[:80])}, which is not in the archive")
            return _plain(target)
    models = sorted(name for name in names if name.endswith(".model"))
    if not models:
        raise MeshRefused("not readable as 3MF: no model file in the archive")
    return "3d/3dmodel.model" if "3d/3dmodel.model" in models else models[0]


def _xml(archive: zipfile.ZipFile, name: str) -> Any:
    """The root element of a file."""
    with archive.open(name) as file:
        return etree.parse(file, etree.XMLParser(**XML_OPTIONS)).getroot()


class _Reference(NamedTuple):
    """A component of an object, or an item of the build."""

    object_id: str
    transform: np.ndarray  # (4, 3): a row vector (x, y, z, 1) is multiplied from the left


class _Object(NamedTuple):
    """A mesh, an assembly of components, or both."""

    vertices: np.ndarray  # (n, 3)
    faces: np.ndarray  # (m, 3) int64
    components: list[_Reference]
    fault: str | None  # why it cannot be part of the build


class _Model:
    """A model file; lengths are in its unit."""

    def __init__(self, file: IO[bytes]) -> None:
        self.unit = "millimeter"
        self.objects: dict[str, _Object] = {}
        self.items: list[_Reference] = []
        self.counts: dict[str, int] = {}
        """Faces of each object with its components."""
        for _, element in etree.iterparse(file, tag=("{*}object", "{*}build", "{*}model"), **XML_OPTIONS):
            kind = etree.QName(element).localname
            if kind == "object":
                self.objects[element.attrib["id"]] = _object(element)
                element.clear()
            elif kind == "build":
                items = list(element.iterfind("{*}item"))
                if any(_attributes(item).get("printable", "1").lower() not in TRUE for item in items):
                    raise MeshRefused(f'holds an item that is not printed (printable="0"): {ALONE}')
                self.items = list(map(_reference, items))
            else:
                _check_required(element)
                self.unit = element.get("unit", "millimeter").lower()
                if self.unit not in UNIT_NAMES:
                    raise MeshRefused(f"not readable as 3MF: unknown unit {shown(self.unit[:40])!r}")

    def named(self, object_id: str) -> _Object:
        """An object. Raises MeshRefused if it is missing, or if it is no plain mesh."""
        found, name = self.objects.get(object_id), shown(object_id[:20])
        if found is None:
            raise MeshRefused(f"not readable as 3MF: no object {name} in its model")
        if found.fault is not None:
            raise MeshRefused(f"object {name} {found.fault}")
        return found

    def face_count(self, object_id: str, depth: int = 0) -> int:
        """Number of faces of an object with all its components, each instance counted, before any is made."""
        if depth > MAX_DEPTH:
            raise MeshRefused(f"not readable as 3MF: components nested more than {MAX_DEPTH} deep")
        if object_id not in self.counts:
            named = self.named(object_id)
            inner = sum(self.face_count(component.object_id, depth + 1) for component in named.components)
            self.counts[object_id] = max(len(named.faces) + inner, 1)
        return self.counts[object_id]

    def meshes(self, reference: _Reference, outer: np.ndarray | None = None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The placed meshes (vertices, faces) of a reference. outer: (4, 3) of the object that it stands in."""
        named, transform = self.named(reference.object_id), reference.transform
        if outer is not None:
            moved = matmul(transform[3:], outer[:3]) + outer[3]
            transform = np.concatenate([matmul(transform[:3], outer[:3]), moved])
        if len(named.faces):
            faces = named.faces if determinant(transform[:3]) >= 0 else named.faces[:, ::-1]
            yield matmul(named.vertices, transform[:3]) + transform[3], faces
        for component in named.components:
            yield from self.meshes(component, transform)


def _object(element: Any) -> _Object:
    mesh = element.find("{*}mesh")
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    if mesh is not None:
        corners = [[v.attrib[axis] for axis in "xyz"] for v in mesh.iterfind("{*}vertices/{*}vertex")]
        found = [[t.attrib[k] for k in ("v1", "v2", "v3")] for t in mesh.iterfind("{*}triangles/{*}triangle")]
        vertices = np.array(corners, dtype=np.float64).reshape(-1, 3)
        faces = np.array(found, dtype=np.int64).reshape(-1, 3)
        check_indices(faces, len(vertices), "3MF")
    components = [_reference(each) for each in element.iterfind("{*}components/{*}component")]
    return _Object(vertices, faces, components, _object_fault(element))


def _reference(element: Any) -> _Reference:
    attributes = _attributes(element)
    if "path" in attributes:
        raise MeshRefused(f"holds objects in further model files ({shown(attributes['path'][:80])}): {ALONE}")
    transform = np.array(attributes.get("transform", IDENTITY).split(), dtype=np.float64).reshape(4, 3)
    return _Reference(element.attrib["objectid"], transform)


def _plain(name: str) -> str:
    """The name of a file as names are compared."""
    return unquote(name).replace("\\", "/").strip("/").lower()


def _attributes(element: Any) -> dict[str, str]:
    """Attributes by their names without prefixes."""
    return {etree.QName(name).localname: value for name, value in element.attrib.items()}


def _check_role(element: Any) -> None:
    """Raise MeshRefused for a volume (PrusaSlicer, Slic3r) or part (Bambu Studio, OrcaSlicer) that is no plain part."""
    values = {entry.get("key", ""): entry.get("value", "") for entry in element.iterfind("{*}metadata")}
    role = element.get("subtype") or values.get("volume_type") or ""
    is_modifier = element.get("modifier", values.get("modifier", "")).lower() in TRUE
    if is_modifier or (role and role.replace("_", "").lower() not in PART_ROLES):
        kind = shown(role[:40] or "modifier")
        raise MeshRefused(f"holds a volume of the type {kind}, which a slicer does not print as a part: {ALONE}")


def _check_required(model: Any) -> None:
    """Raise MeshRefused if a model element requires an extension that is not known here."""
    for prefix in model.get("requiredextensions", "").split():
        address = model.nsmap.get(prefix) or "not declared"
        if not any(f"/{word}/" in address for word in HARMLESS_EXTENSIONS) or "/alternatives/" in address:
            name = f"{shown(prefix[:40])} ({shown(address[:120])})"
            raise MeshRefused(f"requires the 3MF extension {name}, which is not read: {ALONE}")


def _object_fault(element: Any) -> str | None:
    """Why an object element is no plain mesh; None if it is. Only objects in the build are asked."""
    attributes = _attributes(element)
    shapes = [etree.QName(child).localname for child in element if isinstance(child.tag, str)]
    unknown = [shape for shape in shapes if shape not in OBJECT_CONTENT]
    lattice = element.find("{*}mesh/{*}beamlattice") is not None
    if unknown or lattice:
        return f"holds a {'beamlattice' if lattice else shown(unknown[0][:40])}, which is no mesh: {ALONE}"
    kind = attributes.get("type", "model").lower()
    roles = [kind] if kind != "model" else [role for role in CURA_ROLES if role in _true_settings(element)]
    if roles:
        return f"is of the type {shown(roles[0][:40])} and no part: {ALONE}"
    for volume in element.iterfind("{*}volumes/{*}volume"):
        _check_role(volume)
    detail = attributes.get("meshresolution") or attributes.get("modelresolution") or "fullres"
    return None if detail == "fullres" else f"has a mesh of the resolution {shown(detail[:40])}: {ALONE}"


def _true_settings(element: Any) -> Iterator[str]:
    """Names without prefixes of the metadata and settings of an object that are true, as Cura writes them."""
    for entry in element.iter("{*}metadata", "{*}setting"):
        values = _attributes(entry)
        if (entry.text or values.get("value", "")).strip().lower() in TRUE:
            yield (values.get("name") or values.get("key") or "").rpartition(":")[2]
