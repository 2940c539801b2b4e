"""What slicers say about the volumes of a 3MF file: which are parts, which are cut out, and which only help.

PrusaSlicer, SuperSlicer and Slic3r keep all volumes of an object in one mesh and describe ranges of its triangles.
Bambu Studio and OrcaSlicer describe the components of an object. Cura marks an object by its metadata.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] (a compiled module)

from kit1000.errors import MeshRefused
from kit1000.parts.files.threemf.extensions import EXPORT
from kit1000.parts.files.threemf.package import Package

PART, NEGATIVE = "part", "negative volume"
VOLUME_ROLES = {
    "modelpart": PART,
    "negativevolume": NEGATIVE,
    "parametermodifier": "modifier",
    "supportenforcer": "support enforcer",
    "supportblocker": "support blocker",
    "seamposition": "seam position",
    "seampositioninside": "seam position",
    "brimpatch": "brim patch",
    "brimnegative": "brim patch",
    "normalpart": PART,
    "negativepart": NEGATIVE,
    "modifierpart": "modifier",
}
"""Roles by the names that slicers write, in lower case without underscores; further ones are refused."""
CURA_ROLES = {
    "infill_mesh": "infill mesh",
    "cutting_mesh": "cutting mesh",
    "support_mesh": "support mesh",
    "anti_overhang_mesh": "support blocker",
}
"""Roles of objects by the setting that Cura gives them."""
SURFACE = "surface object"
TYPE_ROLES = {
    "model": PART,
    "surface": SURFACE,
    "solidsupport": "support object",
    "support": "support object",
    "other": "helper object",
}
"""Roles by the type of an object in the core specification; a surface is a part where there is no other one."""
CONFIG_FOLDER, CONFIG_ENDS = "metadata/", ("_model.config", "model_settings.config")
TRUE = ("1", "true", "yes")


@dataclass(frozen=True)
class TriangleRange:
    """A run of the triangles of a mesh, and its role."""

    first: int
    last: int
    """Inclusive."""
    role: str


@dataclass(frozen=True)
class Roles:
    """The roles that the configuration files of slicers give, by ids of the root model."""

    ranges: dict[str, tuple[TriangleRange, ...]] = field(default_factory=dict)
    """Volumes of each object, by its id."""
    components: dict[tuple[str, str], str] = field(default_factory=dict)
    """Roles by the ids of an object and of one of its components."""


def read_roles(package: Package) -> Roles:
    """The roles that all configuration files in an archive give; the first that names an object counts."""
    roles = Roles()
    for name in sorted(package.names):
        if name.startswith(CONFIG_FOLDER) and name.endswith(CONFIG_ENDS):
            root = package.xml(name)
            for element in () if root is None else root.iterfind("{*}object"):
                _read_object(element, roles)
    return roles


def _read_object(element: Any, roles: Roles) -> None:
    object_id = element.get("id", "")
    ranges = [_range(volume, _volume_role(volume)) for volume in element.iterfind("{*}volume")]
    roles.ranges.setdefault(object_id, tuple(ranges))
    for part in element.iterfind("{*}part"):
        if part.get("firstid") is not None:
            roles.ranges[object_id] += (_range(part, _role(part.get("subtype", "normal_part"))),)
        else:
            key = object_id, part.get("id", "")
            roles.components.setdefault(key, _role(part.get("subtype", "normal_part")))


def _range(element: Any, role: str) -> TriangleRange:
    try:
        return TriangleRange(int(element.attrib["firstid"]), int(element.attrib["lastid"]), role)
    except (KeyError, ValueError):
        raise MeshRefused("not readable as 3MF: a volume in Metadata without its triangles") from None


def _volume_role(volume: Any) -> str:
    """The role of a volume; old files say only whether it is a modifier."""
    values = {entry.get("key", ""): entry.get("value", "") for entry in volume.iterfind("{*}metadata")}
    if "volume_type" in values:
        return _role(values["volume_type"])
    return "modifier" if values.get("modifier", "").lower() in TRUE else PART


def _role(written: str) -> str:
    role = VOLUME_ROLES.get(written.replace("_", "").lower())
    if role is None:
        raise MeshRefused(f"holds a volume of the unknown type {written[:40]!r}; {EXPORT}")
    return role


def inline_ranges(element: Any) -> tuple[TriangleRange, ...]:
    """The volumes that Slic3r writes into an object element itself."""
    found = []
    for volume in element.iterfind("{*}volumes/{*}volume"):
        role = "modifier" if volume.get("modifier", "").lower() in TRUE else PART
        try:
            found.append(TriangleRange(int(volume.attrib["ts"]), int(volume.attrib["te"]), role))
        except (KeyError, ValueError):
            raise MeshRefused("not readable as 3MF: a volume without its triangles") from None
    return tuple(found)


def object_role(element: Any) -> str:
    """The role of an object element, by its type and by what Cura writes into it."""
    written = element.get("type", "model").lower()
    for name, value in _settings(element):
        if name in CURA_ROLES and value.strip().lower() in TRUE:
            return CURA_ROLES[name]
    if written not in TYPE_ROLES:
        raise MeshRefused(f"object {element.get('id', '')[:20]} has the unknown type {written[:40]!r}; {EXPORT}")
    return TYPE_ROLES[written]


def _settings(element: Any) -> Iterator[tuple[str, str]]:
    """Names without prefix, and values, of the metadata and settings of an object."""
    for entry in element.iter("{*}metadata", "{*}setting"):
        if etree.QName(entry.getparent()).localname in ("metadatagroup", "settings", "object"):
            plain = {etree.QName(name).localname: value for name, value in entry.attrib.items()}
            name = plain.get("name") or plain.get("key") or ""
            yield name.rpartition(":")[2], entry.text or plain.get("value", "")


def triangle_roles(count: int, ranges: tuple[TriangleRange, ...]) -> list[tuple[str, np.ndarray]]:
    """The roles of the triangles of a mesh, each volume with its indices; those in no volume are a part."""
    free = np.ones(count, dtype=bool)
    found: list[tuple[str, np.ndarray]] = []
    for volume in ranges:
        if volume.first < 0 or volume.last >= count:
            raise MeshRefused(f"damaged: a volume of triangles up to {volume.last:,} of {count:,}")
        indices = np.arange(volume.first, volume.last + 1)
        free[indices] = False
        found += [(volume.role, indices)] if len(indices) else []
    rest = np.flatnonzero(free)
    return [*found, (PART, rest)] if len(rest) else found
