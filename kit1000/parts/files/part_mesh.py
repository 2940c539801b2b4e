"""From an exact solid to the mesh of one part: bodies are united, dense meshes simplified, crossings refused.

Solids are in metres. manifold3d accepts a surface that passes through itself, but its volume and every boolean with
it are then wrong. So the faces are searched for crossings, and a surface with more than a small fold is refused.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from manifold3d import Manifold, OpType

from kit1000.errors import MeshRefused
from kit1000.mesh import Mesh, defect, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.parts.files.repair import inverted
from kit1000.parts.files.triangle_queries import crossings, max_distance

MAX_FACES_UNCHANGED = 5000  # meshes up to this size are not simplified
SIMPLIFY_TOLERANCE = 2e-5  # [m] as large as the sagitta of the procedural parts
SIMPLIFY_SHARES = (1.0, 0.8, 0.6, 0.4, 0.2)  # of the tolerance, in this order: collapses add up to a larger deviation
MIN_BODY_SHARE = 0.9  # of the volume in one body, for the others to be dropped
CROSSING_TOLERANCE = 1e-6  # [m] surfaces that pass through each other by less count as touching
FOLD_TOLERANCES = (2e-5, 5e-5)  # [m] tried in this order to remove small folds
SEPARATION = 2e-6  # [m] by which surfaces that touch along an edge are moved apart
DEVIATION_POINTS = 20_000  # vertices at which the deviation of a simplified mesh is measured
Choice = Literal["union", "largest"]  # which body of several is the part


class SeveralBodies(MeshRefused):
    """A mesh of several bodies, none of which holds nearly all of the volume."""


def part_mesh(solid: Manifold, notes: list[str], choice: Choice | None = None) -> Mesh:
    """The mesh of one body of a solid, closed also on the float32 grid; a note of each change is appended.

    choice: which of several bodies. "union": all as one, which must touch or overlap; "largest"; None: the one with
    nearly all of the volume.

    Raises:
        SeveralBodies: there are several, and by `choice` no single one.
        MeshRefused: a surface that passes through itself, or zero thickness.
    """
    solid = _simplified(_single_body(united(solid, notes), notes, choice), notes)
    return _rounded(_without_crossings(solid, notes), notes)


def united(solid: Manifold, notes: list[str]) -> Manifold:
    """The union of all outward shells without the voids inside them."""
    shells = solid.decompose()
    if len(shells) < 2:
        return solid
    outward = [shell for shell in shells if shell.volume() > 0]
    inward = [inverted(shell) for shell in shells if shell.volume() < 0]
    union = Manifold.batch_boolean(outward, OpType.Add)
    inside = [_share_inside(shell, union) for shell in inward]
    voids = [shell for shell, share in zip(inward, inside, strict=True) if share > 0.5]
    loose = [shell for shell, share in zip(inward, inside, strict=True) if share <= 0.5]
    if any(0.5 < share < 1 - 1e-9 for share in inside):
        notes.append("cut out a void that breaks through the surface")
    if loose:
        notes.append(f"flipped {len(loose)} of {len(shells)} bodies inside out")
        union = Manifold.batch_boolean([union, *loose], OpType.Add)
    bodies = len(outward) + len(loose)
    if len([body for body in union.decompose() if body.volume() > 0]) < bodies:
        notes.append(f"united overlapping or touching bodies ({bodies} in the file)")
    return Manifold.batch_boolean([union, *voids], OpType.Subtract) if voids else union


def _share_inside(shell: Manifold, other: Manifold) -> float:
    return (shell ^ other).volume() / max(shell.volume(), 1e-300)


def _single_body(solid: Manifold, notes: list[str], choice: Choice | None) -> Manifold:
    """The body with nearly all of the volume, or the largest by choice, and its own voids."""
    shells = solid.decompose()
    bodies = _by_volume([shell for shell in shells if shell.volume() > 0])
    if not bodies:
        raise MeshRefused("zero thickness")
    if len(bodies) == 1:
        return solid
    volumes = np.array([body.volume() for body in bodies])
    shares = volumes / volumes.sum()
    listed = ", ".join(f"{share:.0%}" for share in shares[:4]) + (", ..." if len(shares) > 4 else "")
    found = f"{len(bodies)} separate bodies ({listed} of the volume)"
    if choice == "union":
        raise SeveralBodies(f"{found}, which neither touch nor overlap, so that their union is no single part")
    if shares[0] < MIN_BODY_SHARE and choice is None:
        raise SeveralBodies(found)
    notes.append(f"kept the largest of {len(bodies)} bodies ({shares[0]:.1%} of the volume)")
    return _with_voids(bodies[0], shells)


def _by_volume(bodies: list[Manifold]) -> list[Manifold]:
    """The bodies sorted by volume, largest first; equal ones by the lowest corners of their boxes."""
    return sorted(bodies, key=lambda body: (-float(f"{body.volume():.5g}"), np.round(body.bounding_box(), 7).tolist()))


def _with_voids(body: Manifold, shells: list[Manifold]) -> Manifold:
    """A body with those of the voids among the shells that lie inside it."""
    voids = [inverted(shell) for shell in shells if shell.volume() < 0]
    inside = [void for void in voids if _share_inside(void, body) > 0.5]
    return Manifold.batch_boolean([body, *inside], OpType.Subtract) if inside else body


def _simplified(solid: Manifold, notes: list[str]) -> Manifold:
    """The solid with fewer faces if it has many, within SIMPLIFY_TOLERANCE as measured."""
    if solid.num_tri() <= MAX_FACES_UNCHANGED:
        return solid
    for share in SIMPLIFY_SHARES:
        simple = solid.simplify(share * SIMPLIFY_TOLERANCE)
        if simple.num_tri() >= solid.num_tri() or simple.volume() <= 0:
            break
        measured = _deviation(solid, simple, SIMPLIFY_TOLERANCE)
        if measured <= SIMPLIFY_TOLERANCE:
            fewer = f"{solid.num_tri():,} -> {simple.num_tri():,} faces"
            notes.append(f"simplified {fewer} within {measured * 1e3:.3f} mm")
            return simple
    return solid


def _deviation(before: Manifold, after: Manifold, tolerance: float) -> float:
    """[m] largest distance from the vertices of one solid (every k-th of very many) to the other's surface."""
    vertices = mesh_from_solid(before).vertices
    some = vertices[:: max(1, -(-len(vertices) // DEVIATION_POINTS))]
    surface = mesh_from_solid(after)
    kept = set(map(bytes, surface.vertices))  # those stay where they were
    moved = [vertex for vertex in some if bytes(vertex) not in kept]
    return max_distance(np.reshape(moved, (-1, 3)), surface.triangles, 5 * tolerance)


def _without_crossings(solid: Manifold, notes: list[str]) -> Manifold:
    """The solid without self-intersections: as it is, or without folds that are smaller than the tolerances."""
    points = crossings(mesh_from_solid(solid).triangles, CROSSING_TOLERANCE)
    if not len(points):
        return solid
    for tolerance in FOLD_TOLERANCES:
        simple = solid.simplify(tolerance)
        if simple.is_empty() or sum(shell.volume() > 0 for shell in simple.decompose()) != 1:
            continue
        measured = _deviation(solid, simple, tolerance)
        if measured <= tolerance and not len(crossings(mesh_from_solid(simple).triangles, CROSSING_TOLERANCE)):
            notes.append(f"removed a self-intersecting fold, within {measured * 1e3:.3f} mm")
            return simple
    place = ", ".join(f"{value * 1e3:.2f}" for value in points[0])
    raise MeshRefused(f"passes through itself at {len(points)} places, near ({place}) mm: export a solid")


def _rounded(solid: Manifold, notes: list[str]) -> Mesh:
    """The mesh on the float32 grid, with surfaces that touch along edges moved apart."""
    mesh = mesh_from_solid(solid)
    fault = defect_float32(mesh)
    if fault is not None and "more than two" in fault:
        mesh = _separated(mesh)
        notes.append(f"separated surfaces that touch along edges, by {SEPARATION * 1e6:.0f} um")
        fault = defect_float32(mesh)
    if fault is not None:
        mesh = mesh_from_solid(solid.simplify(SIMPLIFY_TOLERANCE / 10))
        fault = defect_float32(mesh)
    if fault is not None:
        raise MeshRefused(fault if defect(mesh) else f"{fault} once rounded to float32")
    mesh = mesh.rounded_float32().merged()
    solid_from_mesh(mesh)
    return mesh


def _separated(mesh: Mesh) -> Mesh:
    """The mesh with each vertex that shares its position with another moved inward along its own normal."""
    positions = mesh.vertices.astype(np.float32)
    _, inverse, counts = np.unique(positions, axis=0, return_inverse=True, return_counts=True)
    shared = np.flatnonzero(counts[inverse.reshape(-1)] > 1)
    normals = np.zeros_like(mesh.vertices)
    np.add.at(normals, mesh.faces, mesh.normals[:, None])
    lengths = np.linalg.norm(normals[shared], axis=1, keepdims=True)
    moved = np.array(mesh.vertices)
    moved[shared] -= SEPARATION * normals[shared] / np.maximum(lengths, 1e-12)
    return Mesh(moved, mesh.faces)
