"""The step from an exact solid to a mesh that stays one closed body in every file."""

from __future__ import annotations

from manifold3d import Manifold

from kit1000.errors import Redraw
from kit1000.mesh import Mesh, body_count, defect32, mesh_of

WELDS = (2e-6, 5e-6, 10e-6)  # [m] edges shorter than this are collapsed until float32 keeps the solid closed


def printable_mesh(solid: Manifold, name: str) -> Mesh:
    """A solid as one closed body with vertices on the float32 grid; `name` opens the reason of a refusal."""
    fault = "empty"
    for weld in WELDS:
        mesh = mesh_of(solid.simplify(weld)).rounded32()
        fault = defect32(mesh) or ("several bodies" if body_count(mesh) > 1 else "")
        if not fault:
            return mesh
    raise Redraw(f"{name} not closed in float32: {fault}")
