"""Whether a part family keeps its promises: solid, deterministic, and as symmetric as it declares."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from manifold3d import Error, Manifold

from kit1000.mesh import Mesh, mesh_from_solid, solid_from_mesh, surface_points
from kit1000.parts.family import Family, dimensions, make_part
from kit1000.pose import Pose, quaternion_from_rotvec
from kit1000.symmetry import Symmetry
from kit1000.values import Part

LONGEST = 0.045
"""[m] Size at which a family is judged; parts of the dataset measure 35 to 50 mm."""
EXACT = 0.02e-3
"""[m] Largest distance by which a declared symmetry may move the surface: the sagitta of the finest arcs."""
FREE = 0.05e-3
"""[m] The same for a turn about a free axis, where polygons stand for circles."""
WITNESSES = 200
"""Surface points that are asked how far they land from the surface."""


def check_family(family: type[Family], seeds: Iterable[int], name: str = "part") -> None:
    """Check that a part family keeps its promises on the draws of the given seeds.

    The drawing is deterministic with finite dimensions; the solid is one valid closed body that becomes a part; each
    declared symmetry maps the part on itself, and no plain rotation does so undeclared.
    """
    for seed in seeds:
        where = f"{family.__name__}, seed {seed}"
        dims = family.draw(np.random.default_rng(seed))
        _check_drawing(dims, family.draw(np.random.default_rng(seed)), where)
        part = make_part(name, name, dims, LONGEST)
        assert abs(part.mesh.extents.max() - LONGEST) < 1e-7, f"{where}: longest side {part.mesh.extents.max()} m"
        check_symmetry(part, where)


def check_symmetry(part: Part, where: str = "") -> None:
    """Check the declared symmetry of a part against its mesh, by distances and by volumes."""
    where = where or part.id
    points = surface_points(part.mesh, WITNESSES, np.random.default_rng(0))
    solid = solid_from_mesh(part.mesh)
    for turn, allowed in _declared(part.symmetry):
        gap = float(distances(Pose(turn, np.zeros(3)).apply(points), part.mesh).max())
        assert gap <= allowed, f"{where}: {_said(turn)} is declared but moves the surface by {gap * 1e3:.3f} mm"
        changed = _changed_volume(solid, turn)
        limit = allowed * part.mesh.area
        assert changed <= limit, (
            f"{where}: {_said(turn)} is declared but changes {changed / part.mesh.volume:.2%} of it"
        )
    for turn in _undeclared(part):
        if _changed_volume(solid, turn) < 0.1 * EXACT * part.mesh.area:
            raise AssertionError(f"{where}: {_said(turn)} maps the part on itself but is not declared")


def distances(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Distance of points (n, 3) [m] from the surface of a mesh (n,) [m], by trying every triangle."""
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


def _check_drawing(dims: Family, again: Family, where: str) -> None:
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
    assert same, f"{where}: two solids from one drawing differ"


def _declared(symmetry: Symmetry) -> Iterator[tuple[np.ndarray, float]]:
    """Rotations that must hold with the allowed distance: of a large group its ends, of a free axis odd turns."""
    finite = symmetry.rotations[1:]
    for turn in finite if len(finite) <= 8 else finite[[0, 1, len(finite) // 2, -2, -1]]:
        yield turn, EXACT if symmetry.axis is None else FREE
    if symmetry.axis is not None:
        for angle in (0.31, 1.7, 3.9):
            yield quaternion_from_rotvec(angle * symmetry.axis), FREE


def _undeclared(part: Part) -> Iterator[np.ndarray]:
    """Rotations a drawing is likely to have, that are not declared and leave the part's box as it is."""
    symmetry, vertices = part.symmetry, part.mesh.vertices
    turns = [quaternion_from_rotvec(np.array([0, 0, 2 * np.pi / n])) for n in (3, 5, 6, 7, 8)]
    for turn in [*Symmetry.cube().rotations[1:], *turns]:
        if symmetry.error(turn, symmetry.rotations[0]) < 0.02:
            continue
        turned = Pose(turn, np.zeros(3)).apply(vertices)
        shift = np.abs(np.stack([turned.min(0), turned.max(0)]) - part.mesh.bounds).max()
        if shift < 2 * EXACT:
            yield turn


def _changed_volume(solid: Manifold, turn: np.ndarray) -> float:
    """Volume of the symmetric difference between a solid and its turned copy [m^3]."""
    matrix = np.column_stack([Pose(turn, np.zeros(3)).rotation_matrix(), np.zeros(3)])
    turned = solid.transform(matrix)
    return solid.volume() + turned.volume() - 2 * (solid ^ turned).volume()


def _said(turn: np.ndarray) -> str:
    """A rotation in words."""
    length = float(np.linalg.norm(turn[1:]))
    axis = np.round(turn[1:] / length, 2) + 0.0
    return f"a turn of {np.degrees(2 * np.arctan2(length, turn[0])):.0f} degrees about {axis.tolist()}"
