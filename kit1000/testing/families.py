"""Conformance of a part family: deterministic draws, one valid solid, and exactly the declared symmetry."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from manifold3d import Error, Manifold

from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh, surface_points
from kit1000.parts.family import Family, dimensions, make_part
from kit1000.pose import Pose, quaternion_from_rotvec
from kit1000.symmetry import Symmetry
from kit1000.values import Part

PART_SIZE = 0.045
"""[m] Longest side of the parts that are checked; parts of the dataset have 35 to 50 mm."""
FINITE_TOLERANCE = 0.02e-3
"""[m] Largest distance by which a declared symmetry may move the surface: the sagitta of the finest arcs."""
FREE_AXIS_TOLERANCE = 0.05e-3
"""[m] The same for a rotation about a free axis, where circles are polygons."""
SURFACE_SAMPLES = 200
"""Surface points whose distance to the rotated surface is measured."""


def check_family(family: type[Family], seeds: Iterable[int], name: str = "part") -> None:
    """Check a part family on the draws of the given seeds.

    Draws are deterministic with finite dimensions. The solid is one valid closed body that becomes a part. Each
    declared symmetry maps the part onto itself, and no simple rotation does so undeclared.
    """
    for seed in seeds:
        where = f"{family.__name__}, seed {seed}"
        dims = family.draw(np.random.default_rng(seed))
        _check_draw(dims, family.draw(np.random.default_rng(seed)), where)
        part = make_part(name, name, dims, PART_SIZE)
        assert abs(part.mesh.extents.max() - PART_SIZE) < 1e-7, (
            f"{where}: longest side {part.mesh.extents.max()} m, expected {PART_SIZE}"
        )
        check_symmetry(part, where)


def check_symmetry(part: Part, where: str = "") -> None:
    """Check the declared symmetry of a part against its mesh, by distances and by volumes."""
    where = where or part.id
    points = surface_points(part.mesh, SURFACE_SAMPLES, np.random.default_rng(0))
    solid = solid_from_mesh(part.mesh)
    for rotation, tolerance in _declared_rotations(part.symmetry):
        gap = float(surface_distances(Pose(rotation, np.zeros(3)).apply(points), part.mesh).max())
        assert gap <= tolerance, (
            f"{where}: {_describe(rotation)} is declared but moves the surface by {gap * 1e3:.3f} mm"
        )
        changed = _volume_difference(solid, rotation)
        limit = tolerance * part.mesh.area
        assert changed <= limit, (
            f"{where}: {_describe(rotation)} is declared but changes {changed / part.mesh.volume:.2%} of the volume"
        )
    for rotation in _undeclared_rotations(part):
        if _volume_difference(solid, rotation) < 0.1 * FINITE_TOLERANCE * part.mesh.area:
            raise AssertionError(f"{where}: {_describe(rotation)} maps the part onto itself but is not declared")


def surface_distances(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """(n,) [m] distances of points (n, 3) [m] to the surface of a mesh, over all triangles."""
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)  # (m, 3)
    ab, ac = b - a, c - a
    squares = np.full((len(points), len(a)), np.inf)
    normal = np.cross(ab, ac)
    size = np.maximum(np.einsum("mi,mi->m", normal, normal), 1e-30)
    p = points[:, None] - a  # (n, m, 3)
    u = np.einsum("nmi,mi->nm", np.cross(p, ac), normal) / size
    v = np.einsum("nmi,mi->nm", np.cross(ab, p), normal) / size
    over = (u >= 0) & (v >= 0) & (u + v <= 1)
    squares[over] = (np.einsum("nmi,mi->nm", p, normal) ** 2 / size)[over]
    for start, edge in ((a, ab), (a, ac), (b, c - b)):
        offset = points[:, None] - start
        t = np.einsum("nmi,mi->nm", offset, edge) / np.maximum(np.einsum("mi,mi->m", edge, edge), 1e-30)
        rest = offset - np.clip(t, 0, 1)[..., None] * edge
        squares = np.minimum(squares, np.einsum("nmi,nmi->nm", rest, rest))
    return np.sqrt(squares.min(axis=1))


def _check_draw(dims: Family, again: Family, where: str) -> None:
    assert dims == again, f"{where}: two draws from one seed differ"
    numbers = dimensions(dims)
    bad = [key for key, value in numbers.items() if not np.isfinite(value)]
    assert not bad, f"{where}: dimensions {bad} are not finite"
    solid = dims.solid()
    assert solid.status() == Error.NoError, f"{where}: solid is {solid.status().name}"
    bodies = len(solid.decompose())
    assert bodies == 1, f"{where}: {bodies} bodies, expected 1"
    first, second = mesh_from_solid(solid), mesh_from_solid(again.solid())
    same = np.array_equal(first.vertices, second.vertices) and np.array_equal(first.faces, second.faces)
    assert same, f"{where}: two solids from one draw differ"


def _declared_rotations(symmetry: Symmetry) -> Iterator[tuple[np.ndarray, float]]:
    """Declared rotations with their tolerances [m]: some of a large group, three angles of a free axis."""
    finite = symmetry.rotations[1:]
    for rotation in finite if len(finite) <= 8 else finite[[0, 1, len(finite) // 2, -2, -1]]:
        yield rotation, FINITE_TOLERANCE if symmetry.axis is None else FREE_AXIS_TOLERANCE
    if symmetry.axis is not None:
        for angle in (0.31, 1.7, 3.9):
            yield quaternion_from_rotvec(angle * symmetry.axis), FREE_AXIS_TOLERANCE


def _undeclared_rotations(part: Part) -> Iterator[np.ndarray]:
    """Undeclared rotations by common angles that leave the bounding box of the part unchanged."""
    symmetry, vertices = part.symmetry, part.mesh.vertices
    rotations = [quaternion_from_rotvec(np.array([0, 0, 2 * np.pi / n])) for n in (3, 5, 6, 7, 8)]
    for rotation in [*Symmetry.cube().rotations[1:], *rotations]:
        if symmetry.error(rotation, symmetry.rotations[0]) < 0.02:
            continue
        rotated = Pose(rotation, np.zeros(3)).apply(vertices)
        shift = np.abs(np.stack([rotated.min(0), rotated.max(0)]) - part.mesh.bounds).max()
        if shift < 2 * FINITE_TOLERANCE:
            yield rotation


def _volume_difference(solid: Manifold, rotation: np.ndarray) -> float:
    """Volume [m^3] of the symmetric difference between a solid and its rotated copy."""
    matrix = np.column_stack([Pose(rotation, np.zeros(3)).rotation_matrix(), np.zeros(3)])
    rotated = solid.transform(matrix)
    return solid.volume() + rotated.volume() - 2 * (solid ^ rotated).volume()


def _describe(rotation: np.ndarray) -> str:
    """A rotation in words."""
    length = float(np.linalg.norm(rotation[1:]))
    axis = np.round(rotation[1:] / length, 2) + 0.0
    return f"a rotation of {np.degrees(2 * np.arctan2(length, rotation[0])):.0f} degrees about {axis.tolist()}"
