"""Conversion of an exact solid to the mesh of one part: bodies united, self-intersections removed, meshes simplified.

Solids are in metres. manifold3d accepts a surface that passes through itself, but its volume and every boolean with
it are then wrong. So crossings are searched for face by face, and a surface that cannot be repaired is refused.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from manifold3d import Manifold, OpType

from kit1000.errors import MeshRefused
from kit1000.mesh import Mesh, defect, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.parts.files.crossings import crossings, max_distance, winding_numbers
from kit1000.parts.files.repair import inverted

MAX_FACES_UNCHANGED = 5000  # meshes up to this size are not simplified
SIMPLIFY_TOLERANCE = 2e-5  # [m] as large as the sagitta of the procedural parts
SIMPLIFY_SHARES = (
    1.0,
    0.8,
    0.6,
    0.4,
    0.2,
)  # of the tolerance, tried in this order: collapses add up to a larger deviation
MIN_BODY_SHARE = 0.9  # of the volume in one body, for the others to be dropped
CROSSING_TOLERANCE = 1e-6  # [m] surfaces that pass through each other by less count as touching
FOLD_TOLERANCES = (2e-5, 5e-5)  # [m] tried in this order to remove small folds
SEPARATION = 2e-6  # [m] by which surfaces that touch along an edge are moved apart
DEVIATION_POINTS = 20_000  # vertices at which the deviation of a simplified mesh is measured
GROWTH = 2e-6  # [m] by which vertices are moved outward to join bodies that touch but for rounding
MAX_BODIES = 100  # of one file that are made parts of their own
Choice = Literal["union", "largest"]  # which body of several is the part
WINDING_POINTS = 400  # points at which a repaired solid is compared with the winding number of the original surface


class SeveralBodies(MeshRefused):
    """A mesh of several bodies, none of which holds nearly all of the volume."""


def part_mesh(solid: Manifold, notes: list[str], choice: Choice | None = None) -> Mesh:
    """The mesh of one body of a solid, closed also on the float32 grid; a note of each change is appended.

    choice: of several bodies the union of all, which must touch or overlap, or the largest; with None that with nearly
    all of the volume.

    Raises:
        SeveralBodies: there are several, and by `choice` no single one.
        MeshRefused: a surface that passes through itself, or zero thickness.
    """
    solid = united(solid, notes)
    return _body_mesh(_joined(solid, notes) if choice == "union" else _single_body(solid, notes, choice), notes)


def body_meshes(solid: Manifold, notes: list[str]) -> list[tuple[Mesh | MeshRefused, list[str]]]:
    """The mesh of each body of a solid, or why it has none, with all notes on it; the largest body first.

    Bodies that touch or overlap are one. Raises MeshRefused when there are more than MAX_BODIES.
    """
    shells = united(solid, notes).decompose()
    bodies = _by_volume([shell for shell in shells if shell.volume() > 0])
    if not bodies:
        raise MeshRefused("zero thickness")
    if len(bodies) > MAX_BODIES:
        raise MeshRefused(f"{len(bodies):,} separate bodies, more than {MAX_BODIES}")
    meshes: list[tuple[Mesh | MeshRefused, list[str]]] = []
    for number, body in enumerate(bodies, 1):
        own = [*notes, f"body {number} of {len(bodies)}"]
        try:
            meshes.append((_body_mesh(_with_voids(body, shells), own), own))
        except MeshRefused as refused:
            meshes.append((refused, own))
    return meshes


def _body_mesh(solid: Manifold, notes: list[str]) -> Mesh:
    solid = _simplified(solid, notes)
    solid = _without_crossings(solid, notes)
    return _rounded(solid, notes)


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


def _single_body(solid: Manifold, notes: list[str], choice: Choice | None = None) -> Manifold:
    """The body with nearly all of the volume, or the largest by choice, and its own voids."""
    shells = solid.decompose()
    bodies = sorted((shell for shell in shells if shell.volume() > 0), key=lambda body: -body.volume())
    if not bodies:
        raise MeshRefused("zero thickness")
    if len(bodies) == 1:
        return solid
    shares = _volume_shares(bodies)
    if shares[0] < MIN_BODY_SHARE and choice is None:
        raise SeveralBodies(_bodies_text(shares))
    notes.append(f"kept the largest of {len(bodies)} bodies ({shares[0]:.1%} of the volume)")
    return _with_voids((_by_volume(bodies) if choice else bodies)[0], shells)


def _joined(solid: Manifold, notes: list[str]) -> Manifold:
    """The solid as one body; bodies that touch but for rounding are grown to join them."""
    shells = solid.decompose()
    bodies = [shell for shell in shells if shell.volume() > 0]
    if not bodies:
        raise MeshRefused("zero thickness")
    if len(bodies) == 1:
        return solid
    grown = united(Manifold.compose([solid_from_mesh(_grown(mesh_from_solid(body))) for body in bodies]), [])
    if sum(shell.volume() > 0 for shell in grown.decompose()) > 1:
        apart = _bodies_text(_volume_shares(sorted(bodies, key=lambda body: -body.volume())))
        raise SeveralBodies(f"{apart}, which do not touch, so that their union is no single part")
    notes.append(f"joined {len(bodies)} touching bodies, grown by at most {GROWTH * 1e6:g} um")
    voids = [inverted(shell) for shell in shells if shell.volume() < 0]
    return Manifold.batch_boolean([grown, *voids], OpType.Subtract) if voids else grown


def _grown(mesh: Mesh) -> Mesh:
    """The mesh with all vertices moved outward by GROWTH."""
    corners = mesh.vertices[mesh.faces]
    normals = np.zeros_like(mesh.vertices)
    for k in range(3):  # weighted by the angle at the corner, so that it does not depend on the triangulation
        before, after = corners[:, k - 1] - corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(before, after), axis=1), (before * after).sum(1))
        np.add.at(normals, mesh.faces[:, k], angle[:, None] * mesh.normals)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(mesh.vertices + GROWTH * normals / np.maximum(lengths, 1e-12), mesh.faces)


def _by_volume(bodies: list[Manifold]) -> list[Manifold]:
    """The bodies sorted by volume, largest first; equal ones by the lowest corners of their boxes."""
    return sorted(bodies, key=lambda body: (-float(f"{body.volume():.5g}"), np.round(body.bounding_box(), 7).tolist()))


def _volume_shares(bodies: list[Manifold]) -> np.ndarray:
    volumes = np.array([body.volume() for body in bodies])
    return volumes / volumes.sum()


def _bodies_text(shares: np.ndarray) -> str:
    listed = ", ".join(f"{share:.0%}" for share in shares[:4]) + (", ..." if len(shares) > 4 else "")
    return f"{len(shares)} separate bodies ({listed} of the volume)"


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
    """The solid without self-intersections, by the smallest change that works."""
    points = crossings(mesh_from_solid(solid).triangles, CROSSING_TOLERANCE)
    if not len(points):
        return solid
    for tolerance in FOLD_TOLERANCES:
        simple = solid.simplify(tolerance)
        if _is_valid_repair(simple, solid, points):
            measured = _deviation(solid, simple, tolerance)
            notes.append(f"removed a self-intersecting fold, within {measured * 1e3:.3f} mm")
            return simple
    split = _split_at_crossings(solid, points)
    if _is_valid_repair(split, solid, points):
        notes.append(f"resolved a self-intersection (volume {split.volume() / solid.volume() - 1:+.2%})")
        return split
    raise MeshRefused(f"passes through itself at {len(points)} places, near ({_millimetres(points[0])}) mm")


def _millimetres(point: np.ndarray) -> str:
    return ", ".join(f"{value * 1e3:.2f}" for value in point)


def _split_at_crossings(solid: Manifold, points: np.ndarray) -> Manifold:
    """The union of the solid inside a box around its crossings and of the solid outside.

    Inside the box the crossing branches are bodies of their own, which a union joins exactly.
    """
    low, high = points.min(0), points.max(0)
    margin = 0.02 * float(np.ptp(mesh_from_solid(solid).vertices, axis=0).max()) + 0.05 * float((high - low).max())
    box = Manifold.cube((high - low + 2 * margin).tolist()).translate((low - margin).tolist())
    pieces = [*(solid ^ box).decompose(), *(solid - box).decompose()]
    outward = [piece for piece in pieces if piece.volume() > 0]
    inward = [inverted(piece) for piece in pieces if piece.volume() < 0]
    union = Manifold.batch_boolean(outward, OpType.Add)
    return Manifold.batch_boolean([union, *inward], OpType.Subtract) if inward else union


def _is_valid_repair(repaired: Manifold, solid: Manifold, points: np.ndarray) -> bool:
    """Whether a repaired solid is one body without crossings and fills where the original surface winds around."""
    if repaired.is_empty() or sum(shell.volume() > 0 for shell in repaired.decompose()) != 1:
        return False
    triangles = mesh_from_solid(repaired).triangles
    if len(crossings(triangles, CROSSING_TOLERANCE)):
        return False
    original = mesh_from_solid(solid).triangles
    low, high = original.reshape(-1, 3).min(0), original.reshape(-1, 3).max(0)
    rng = np.random.default_rng(0)
    everywhere = rng.uniform(low, high, (WINDING_POINTS, 3))
    spread = 0.03 * (high - low).max()
    nearby = rng.choice(points, WINDING_POINTS) + rng.normal(0, spread, (WINDING_POINTS, 3))
    samples = np.concatenate([everywhere, nearby])
    wanted = winding_numbers(samples, original) > 0.5
    return bool(((winding_numbers(samples, triangles) > 0.5) == wanted).mean() >= 1 - 1 / WINDING_POINTS)


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
