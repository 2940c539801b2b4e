"""The interface of a part family, and the conversion of a drawing to a `Part`.

A drawing is in millimetres, in any frame; a part is in metres about its volume centroid.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Protocol, TypeVar

import numpy as np
from manifold3d import Error, Manifold

from kit1000.errors import Redraw
from kit1000.mesh import Mesh, defect_float32, mesh_from_solid
from kit1000.symmetry import Symmetry
from kit1000.values import Part

Drawing = TypeVar("Drawing", bound="Family")

FILE = "file"
"""The family of parts that are read from files."""
DENSITY = 1240.0
"""[kg/m^3] of PLA, the usual material of desktop 3D printers."""
MIN_MEAN_THICKNESS = 0.7e-3
"""[m] least volume / (area / 2) of a part: about the mean thickness of its walls. Families keep each wall at 1.5 mm or
more themselves; this limit only catches a failed drawing."""
MM = 1e-3


class Family(Protocol):
    """A frozen dataclass of named dimensions in mm; counts and switches are allowed as well."""

    @classmethod
    def draw(cls: type[Drawing], rng: np.random.Generator) -> Drawing:
        """Random dimensions of one part, from `rng` alone."""
        ...

    def solid(self) -> Manifold:
        """The part in mm, in any frame."""
        ...

    def symmetry(self) -> Symmetry:
        """All rotations about the centroid that map the solid onto itself, in the axes of the drawing."""
        ...


def make_part(part_id: str, family_name: str, dims: Family, longest: float | None = None) -> Part:
    """The part of a drawing, scaled uniformly to a longest side of its bounding box [m] (None: not scaled).

    Vertices lie on the float32 grid, so the mesh in memory equals the mesh in every file. Raises Redraw if the drawing
    is no single closed body.
    """
    solid = dims.solid()
    _require(solid.status() == Error.NoError and not solid.is_empty(), "no solid")
    _require(solid.volume() > 0, "no volume")
    drawn = mesh_from_solid(solid)
    factor = MM if longest is None else longest / float(drawn.extents.max())
    mesh = Mesh((drawn.vertices - drawn.centroid) * factor, drawn.faces).rounded_float32().merged()
    _require(len(solid.decompose()) == 1, "several bodies")
    _require(2 * mesh.volume / mesh.area >= MIN_MEAN_THICKNESS, "too thin")
    fault = defect_float32(mesh)
    _require(fault is None, f"mesh {fault}")
    return Part(part_id, family_name, mesh, dims.symmetry(), dimensions(dims), DENSITY * mesh.volume)


def part_of_mesh(part_id: str, mesh: Mesh, longest: float | None = None) -> Part:
    """The part of a closed mesh, scaled to a longest side [m] (None: not scaled); no symmetry is declared."""
    scaled = mesh.scaled(1.0 if longest is None else longest / float(mesh.extents.max()))
    centred = Mesh(scaled.vertices - scaled.centroid, scaled.faces).rounded_float32()
    return Part(part_id, FILE, centred, Symmetry.none(), {}, DENSITY * centred.volume)


def dimensions(dims: Family) -> dict[str, float]:
    """The numbers of a drawing by name, switches as 0 or 1; fields of other types are left out."""
    named = {field.name: getattr(dims, field.name) for field in fields(dims)}  # type: ignore[arg-type]
    return {name: float(value) for name, value in named.items() if isinstance(value, int | float)}


def _require(holds: bool, reason: str) -> None:
    if not holds:
        raise Redraw(reason)
