"""Few convex pieces of kits and parts for physics engines that take the hull of every mesh, measured by booleans.

A kit is covered by prisms (`kit1000.kits.convex_pieces`). A part is cut by planes along its concave edges until no hull
exceeds it by more than a tolerance (approximate convex decomposition, Lien and Amato 2007). Pieces are then joined
while their common hull exceeds the solid by no more than the tolerance. What rests against a piece is thus never in the
true solid. Metres.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import combinations

import numpy as np
from manifold3d import Manifold, OpType
from scipy.spatial import ConvexHull

from kit1000.kits.convex_pieces import TOLERANCE, overlapping_prisms
from kit1000.mesh import Mesh, convex_hull, even_points, mesh_from_solid, solid_from_mesh
from kit1000.numerics.linear_algebra import matmul
from kit1000.parts.files.triangle_queries import point_distances
from kit1000.pose import Pose
from kit1000.values import Kit, Slot

FILM = 1e-6  # [m] thinner overlaps are rounding
CRUMB = 1e-10  # [m^3] bodies of less are left out, and halves of less than a tenth
SAME_PLANE = (0.02, 5e-5)  # [rad] and [m]: cuts nearer to each other than this count as one
FILM_GAIN = 0.9  # of the excess at most that a cut which removes only crumbs may leave
CUTS = 12  # planes tried for a cut
BALANCE = 0.5  # weight of the larger side's excess in the choice of a cut: round holes are halved, not shaved
SAMPLES = (8, 150)  # least and most points at which an excess is measured, one a square millimetre
SIMPLER = 2e-5  # [m] by which a part is simplified before it is cut


class Piece:
    """A convex piece: the hull of points (n, 3) [m]."""

    def __init__(self, points: np.ndarray) -> None:
        hull = ConvexHull(points)
        _, plane = np.unique(np.round(hull.equations[:, :3], 5), axis=0, return_inverse=True)
        at = np.unique(np.stack([hull.simplices.ravel(), np.repeat(plane.ravel(), 3)], axis=1), axis=0)
        self.corners = points[np.bincount(at[:, 0], minlength=len(points)) > 2]  # three planes meet at a corner
        self.planes = hull.equations
        self.volume, self.area = float(hull.volume), float(hull.area)
        self.low, self.high = self.corners.min(0), self.corners.max(0)

    @cached_property
    def solid(self) -> Manifold:
        """The exact solid."""
        return convex_hull(self.corners)

    def heights(self, points: np.ndarray) -> np.ndarray:
        """(n,) [m] largest signed distance of points (n, 3) from the planes, positive outside."""
        return (matmul(points, self.planes[:, :3].T) + self.planes[:, 3]).max(1)

    def touches(self, other: Piece) -> bool:
        """Whether the boxes of two pieces touch."""
        return bool((np.maximum(self.low, other.low) <= np.minimum(self.high, other.high) + FILM).all())


def kit_pieces(kit: Kit, tolerance: float = TOLERANCE) -> list[Mesh]:
    """Convex pieces of a kit that leave its cavity open; its upright walls protrude by `tolerance` [m] at most."""
    prisms = [Piece(corners) for corners in overlapping_prisms(kit, tolerance)]
    return _joined(prisms, solid_from_mesh(kit.mesh).simplify(SIMPLER), tolerance)


def part_pieces(mesh: Mesh, tolerance: float) -> list[Mesh]:
    """Convex pieces that together contain a closed mesh and exceed it by `tolerance` [m] at most."""
    solid = solid_from_mesh(mesh).simplify(SIMPLER)
    return _joined(list(_cut_pieces(solid, tolerance - SIMPLER)), solid, tolerance - SIMPLER)


def missing_and_extra(mesh: Mesh, pieces: Sequence[Mesh]) -> tuple[float, float]:
    """Volumes [m^3] of a solid outside its pieces, and of the pieces outside the solid."""
    whole, union = solid_from_mesh(mesh), union_of(pieces)
    return (whole - union).volume(), (union - whole).volume()


def clearance_left(slot: Slot, part: Sequence[Mesh], kit: Sequence[Mesh]) -> float:
    """[m] smallest distance between the pieces of a part and a kit, the part lifted off its goal by the clearance."""
    pose = Pose.from_translation((0.0, 0.0, slot.clearance)) @ slot.kit_from_part
    return union_of(kit).min_gap(union_of(part).transform(pose.matrix()[:3]), 2 * slot.clearance)


def union_of(pieces: Sequence[Mesh]) -> Manifold:
    """The exact union of closed meshes."""
    return Manifold.batch_boolean([solid_from_mesh(piece) for piece in pieces], OpType.Add)


# --- joining ------------------------------------------------------------------------------------------------------


def _joined(pieces: Sequence[Piece], solid: Manifold, tolerance: float) -> list[Mesh]:
    """Pieces joined by pairs while no hull exceeds a solid by more than a tolerance [m]; least added volume first."""
    kept = dict(enumerate(pieces))
    pairs: list[tuple[float, int, int, Piece]] = []

    def consider(i: int, j: int) -> None:
        if kept[i].touches(kept[j]):
            hull = Piece(np.concatenate([kept[i].corners, kept[j].corners]))
            heapq.heappush(pairs, (hull.volume - kept[i].volume - kept[j].volume, i, j, hull))

    for i, j in combinations(kept, 2):
        consider(i, j)
    number = len(pieces)
    while pairs:
        _, i, j, hull = heapq.heappop(pairs)
        if i not in kept or j not in kept or _exceeds(hull, solid, tolerance):
            continue
        kept = {k: piece for k, piece in kept.items() if k not in (i, j) and hull.heights(piece.corners).max() > FILM}
        kept[number] = hull
        for k in [k for k in kept if k != number]:
            consider(number, k)
        number += 1
    return [mesh_from_solid(piece.solid) for piece in kept.values()]


# --- cutting ------------------------------------------------------------------------------------------------------


def _cut_pieces(solid: Manifold, tolerance: float) -> Iterator[Piece]:
    """The hulls of a solid that is cut until none exceeds its part of the solid by more than a tolerance [m]."""
    uncut = solid.decompose()
    while uncut:
        body = uncut.pop()
        if body.volume() < CRUMB:
            continue
        hull = Piece(_vertices(body))
        halves = _best_cut(body) if _exceeds(hull, body, tolerance) else []
        if not halves:
            yield hull
        for half in halves:
            uncut += half.decompose()


def _best_cut(body: Manifold) -> list[Manifold]:
    """The halves of a solid by the plane after which the hulls exceed it least, without crumbs; none if no plane helps.

    A plane that cuts off nothing but crumbs helps if these are films, which widen the hull.
    """
    mesh = mesh_from_solid(body)
    whole = ConvexHull(mesh.vertices).volume - body.volume()
    best: tuple[float, list[Manifold]] = (np.inf, [])
    for normal, offset in _concave_planes(mesh):
        halves = [half for half in body.split_by_plane(normal, offset) if half.volume() > CRUMB / 10]
        excess = [ConvexHull(_vertices(half)).volume - half.volume() for half in halves]
        if len(halves) == 2 or sum(excess) < FILM_GAIN * whole:
            score = sum(excess) + BALANCE * max(excess)
            best = min(best, (score, halves), key=lambda pair: pair[0])
    return best[1]


def _concave_planes(mesh: Mesh) -> Iterator[tuple[np.ndarray, float]]:
    """CUTS planes, as unit normal (3,) and offset [m], along concave edges: of either face, and between the faces.

    Half of them contain the longest and sharpest edges, the others are spread over the rest.
    """
    start, along, left, right = _concave_edges(mesh)
    between = np.cross(left + right, along)
    between /= np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-12)
    normals = np.concatenate([left, right, between])
    weights = np.tile(np.linalg.norm(np.cross(left, right), axis=1) * np.linalg.norm(along, axis=1), 3)
    normals *= np.where(matmul(normals, np.array([1.0, 1e-3, 1e-6])) < 0, -1.0, 1.0)[:, None]
    offsets = np.einsum("ij,ij->i", normals, np.tile(start, (3, 1)))
    cells = np.round(np.column_stack([normals / SAME_PLANE[0], offsets / SAME_PLANE[1]]))
    _, first, plane = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(-np.bincount(plane.ravel(), weights, len(first)), kind="stable")
    rest = order[CUTS // 2 :]
    spread = rest[np.linspace(0, len(rest) - 1, min(len(rest), CUTS - CUTS // 2)).astype(int)]
    for k in first[np.concatenate([order[: CUTS // 2], spread])]:
        yield normals[k], float(offsets[k])


def _concave_edges(mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Starts and vectors (k, 3) [m] of the concave edges of a closed mesh, and the normals (k, 3) of both faces."""
    inside_out = Mesh(mesh.vertices, mesh.faces[:, ::-1])  # its convex edges are the concave ones
    ends, faces = inside_out.convex_edges
    left, right = -inside_out.normals[faces[:, 0]], -inside_out.normals[faces[:, 1]]
    start, along = mesh.vertices[ends[:, 0]], mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]]
    sharp = np.linalg.norm(np.cross(left, right), axis=1) > 0.01
    return start[sharp], along[sharp], left[sharp], right[sharp]


def _exceeds(hull: Piece, body: Manifold, tolerance: float) -> bool:
    """Whether some point of a hull is farther than a tolerance [m] from a solid."""
    if hull.volume - body.volume() > tolerance * hull.area:
        return True  # on average already
    parts = [part for part in (hull.solid - body).decompose() if part.volume() > FILM * part.surface_area()]
    if any(2 * part.volume() > tolerance * part.surface_area() for part in parts):
        return True  # the mean thickness of a sheet
    return any(_depth(hull, part) > tolerance for part in parts)


def _depth(hull: Piece, excess: Manifold) -> float:
    """[m] largest distance, over samples, from the faces of an excess on its hull to its other faces."""
    mesh = mesh_from_solid(excess)
    on_planes = matmul(mesh.triangles.mean(1), hull.planes[:, :3].T) + hull.planes[:, 3] > -1e-7
    outer = (on_planes & (matmul(mesh.normals, hull.planes[:, :3].T) > 0)).any(1)
    if outer.all() or not outer.any():
        return 0.0
    points, _ = even_points(mesh.triangles[outer], int(np.clip(mesh.areas[outer].sum() / 1e-6, *SAMPLES)))
    others = mesh.triangles[~outer]
    apart = point_distances(np.repeat(points, len(others), axis=0), np.tile(others, (len(points), 1, 1)))
    return float(apart.reshape(len(points), -1).min(1).max())


def _vertices(solid: Manifold) -> np.ndarray:
    return np.asarray(solid.to_mesh64().vert_properties)[:, :3]
