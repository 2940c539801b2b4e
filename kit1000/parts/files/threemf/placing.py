"""The build of a 3MF file as triangles: items and their components, placed, each volume by its role.

Instances are counted before they are made, so that a small file of nested components cannot fill the memory.
"""

from __future__ import annotations

import io
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.numerics.linear_algebra import determinant, matmul
from kit1000.parts.files.threemf.models import Models, Object, Reference
from kit1000.parts.files.threemf.package import Package
from kit1000.parts.files.threemf.roles import NEGATIVE, PART, SURFACE, Roles, read_roles, triangle_roles

MAX_DEPTH = 32  # of components inside components


@dataclass(frozen=True, eq=False)
class Volume:
    """A placed volume of an item of the build."""

    item: int
    """Index of the item."""
    role: str
    vertices: np.ndarray
    """(n, 3) in the unit of the root model."""
    faces: np.ndarray
    """(m, 3)"""


@dataclass(frozen=True, eq=False)
class Built:
    """What the build of a 3MF file names."""

    volumes: list[Volume]
    """Parts and negative volumes."""
    unit: str
    """As in the root model, for example millimeter."""
    has_lattice: bool
    """Whether there is a beam lattice, which has no triangles."""
    notes: tuple[str, ...]
    """What was left out or is to be cut out."""


def read_threemf(data: bytes, max_faces: int) -> Built:
    """The volumes of a 3MF file, with at most `max_faces` triangles. A damaged file may raise any exception."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        package = Package(archive)
        placer = _Placer(Models(package), read_roles(package))
        root = placer.models.read(placer.models.root)
        if not root.items:
            raise MeshRefused(
                "its build is empty: no object is placed on the plate, as in a project or a sliced file; "
                "save it with the part on the plate"
            )
        count = sum(placer.face_count(item) for item in root.items)
        if count > max_faces:
            raise MeshRefused(f"{count:,} triangles, more than {max_faces:,}")
        printed = [item for item in root.items if item.printable]
        placed = [volume for number, item in enumerate(printed) for volume in placer.volumes(number, item)]
    hidden = len(root.items) - len(printed)
    used, left_out = _sorted_by_use(placed)
    left_out += [f"left out {_counted(hidden, 'item')} marked as not printable"] if hidden else []
    if left_out and not any(volume.role == PART for volume in used):
        raise MeshRefused(f"holds nothing to print: {'; '.join(left_out)}")
    return Built(used, root.unit, placer.has_lattice, (*left_out, *_cut_out(used)))


def _sorted_by_use(placed: Sequence[Volume]) -> tuple[list[Volume], list[str]]:
    """Parts and negative volumes, and a note on the others; surfaces are parts where nothing else is."""
    solid = any(volume.role == PART for volume in placed)
    used = [
        replace(volume, role=PART) if volume.role == SURFACE else volume
        for volume in placed
        if volume.role in (PART, NEGATIVE) or (volume.role == SURFACE and not solid)
    ]
    others = Counter(volume.role for volume in placed if volume.role not in (PART, NEGATIVE, SURFACE))
    others[SURFACE] = sum(volume.role == SURFACE for volume in placed) if solid else 0
    return used, [f"left out {_counted(number, role)}" for role, number in others.items() if number]


def _cut_out(used: Sequence[Volume]) -> list[str]:
    """Notes on the negative volumes: those after a part of their item are subtracted, the others have no effect."""
    begun: set[int] = set()
    subtracted = idle = 0
    for volume in used:
        if volume.role == PART:
            begun.add(volume.item)
        elif volume.item in begun:
            subtracted += 1
        else:
            idle += 1
    notes = [f"subtracted {_counted(subtracted, NEGATIVE)}"] if subtracted else []
    return notes + ([f"left out {_counted(idle, NEGATIVE)} listed before all parts"] if idle else [])


def _counted(number: int, noun: str) -> str:
    """A number with its noun: 2 support blockers."""
    return f"{number} {noun}" + ("" if number == 1 else "es" if noun.endswith(("sh", "ch")) else "s")


class _Placer:
    """Walks from items to meshes."""

    def __init__(self, models: Models, roles: Roles) -> None:
        self.models, self.roles = models, roles
        self.has_lattice = False
        self._counts: dict[tuple[str, str], int] = {}

    def face_count(self, reference: Reference, depth: int = 0) -> int:
        """Number of faces of an object with all its components, each instance counted."""
        if depth > MAX_DEPTH:
            raise MeshRefused(f"not readable as 3MF: components nested more than {MAX_DEPTH} deep")
        key = reference.path, reference.object_id
        if key not in self._counts:
            named = self.models.named(reference)
            inner = sum(self.face_count(component, depth + 1) for component in named.components)
            self._counts[key] = max(len(named.faces) + inner, 1)
        return self._counts[key]

    def volumes(self, number: int, item: Reference) -> Iterator[Volume]:
        """The placed volumes of an item of the build."""
        yield from self._below(number, item, item, self._in_metres(item, self.models.root), None)

    def _below(
        self, number: int, item: Reference, reference: Reference, transform: np.ndarray, outer: str | None
    ) -> Iterator[Volume]:
        """The volumes below a reference.

        transform: (4, 3) from the unit of the reference's model to that of the root model.
        outer: the role of an object around it that is no part.
        """
        named = self.models.named(reference)
        role = outer or self._role(item, reference, named)
        self.has_lattice |= named.has_lattice and role == PART
        if len(named.faces):
            vertices = matmul(named.vertices, transform[:3]) + transform[3]
            faces = named.faces if determinant(transform[:3]) >= 0 else named.faces[:, ::-1]
            for kind, indices in self._ranges(reference, named):
                yield Volume(number, role if role != PART else kind, vertices, faces[indices])
        inherited = None if role in (PART, SURFACE) else role
        for component in named.components:
            first = self._in_metres(component, reference.path)
            yield from self._below(number, item, component, _product(first, transform), inherited)

    def _role(self, item: Reference, reference: Reference, named: Object) -> str:
        """The role of an object: what a slicer says of it as a component, else what the object says of itself.

        Objects of several models may have the same id, so what is said of a component holds for meshes alone.
        """
        said = self.roles.components.get((item.object_id, reference.object_id)) if len(named.faces) else None
        return said or named.role

    def _ranges(self, reference: Reference, named: Object) -> list[tuple[str, np.ndarray]]:
        configured = self.roles.ranges.get(reference.object_id, ()) if reference.path == self.models.root else ()
        return triangle_roles(len(named.faces), configured or named.ranges)

    def _in_metres(self, reference: Reference, source: str) -> np.ndarray:
        """(4, 3) the transform of a reference in a model, from the unit of the object's model to that of `source`."""
        ratio = self.models.read(reference.path).metres / self.models.read(source).metres
        return np.concatenate([reference.transform[:3] * ratio, reference.transform[3:]])


def _product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(4, 3) the transform that applies one after the other."""
    return np.concatenate([matmul(first[:3], second[:3]), matmul(first[3:], second[:3]) + second[3]])
