"""Conversion of an exact solid to a mesh that stays one closed body in every file format.

An exact solid is closed by its indices, but different vertices of it may share one position, because two walls touch or
a sliver folds back on itself. A loader that merges equal vertices then sees edges with four faces. So vertices are
rounded to a grid, and if the mesh would open, vertices that share a position are moved microns apart.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold

from kit1000.errors import Redraw
from kit1000.mesh import Mesh, body_count, defect_float32, mesh_from_solid
from kit1000.numerics.linear_algebra import length

SIMPLIFY_TOLERANCE = 2e-6  # [m] edges and bumps smaller than this are simplified away
GRID = 2.0**-23  # [m] 0.12 um: exact in float32 up to 2 m, and ten times the distance at which loaders merge vertices
SEPARATION = 2e-6  # [m] by which vertices that share a position are moved towards their own neighbours
MAX_ROUNDS = 5  # of separation, each by twice the distance of the one before


def printable_mesh(solid: Manifold, name: str) -> Mesh:
    """The mesh of a solid: one closed body, vertices on GRID. Raises Redraw, its reason beginning with `name`, else."""
    mesh, fault = closed_on_grid(mesh_from_solid(solid.as_original().simplify(SIMPLIFY_TOLERANCE)), GRID)
    if fault is not None:
        raise Redraw(f"{name} not closed in float32: {fault}")
    if body_count(mesh) > 1:
        raise Redraw(f"{name} in several bodies")
    return mesh


def closed_on_grid(
    mesh: Mesh, grid: float, defect_of: Callable[[Mesh], str | None] = defect_float32
) -> tuple[Mesh, str | None]:
    """A mesh with vertices on a grid [m], moved apart until it is closed, and its remaining defect; None: closed."""
    mesh, fault = _on_grid(mesh, grid), None
    for round_ in range(MAX_ROUNDS):
        fault = defect_of(mesh)
        if fault is None:
            return mesh.merged(), None
        mesh = _on_grid(_separated(mesh, SEPARATION * 2**round_), grid)
    return mesh, fault


def _on_grid(mesh: Mesh, grid: float) -> Mesh:
    return Mesh(np.round(mesh.vertices / grid) * grid, mesh.faces)


def _separated(mesh: Mesh, distance: float) -> Mesh:
    """The mesh with every vertex that shares its position with another moved towards the mean of its neighbours."""
    _, place, count = np.unique(mesh.vertices, axis=0, return_inverse=True, return_counts=True)
    shared = np.flatnonzero(count[place.ravel()] > 1)
    vertices = mesh.vertices.copy()
    for vertex in shared:
        ring = mesh.faces[(mesh.faces == vertex).any(1)]
        towards = mesh.vertices[ring].reshape(-1, 3).mean(0) - mesh.vertices[vertex]
        vertices[vertex] += distance * towards / max(length(towards), GRID)
    return Mesh(vertices, mesh.faces)
