"""Triangle meshes: measures, defects, and conversion to and from exact solids.

Vertices are in m, float64; faces are counter-clockwise seen from outside. A mesh is a solid if manifold3d accepts it;
meshes that are written to files must also be closed after float32 rounding and vertex merging, which loaders of STL and
GLB do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from manifold3d import Error, Manifold, Mesh64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from kit1000.errors import MeshRefused, ShapeError, checked
from kit1000.numerics.linear_algebra import determinant, matmul

if TYPE_CHECKING:
    from kit1000.pose import Pose

COPLANAR_SINE = 1e-9  # sine of the dihedral angle below which two faces count as coplanar
PLASTIC = 1.3247179572447460 ** -np.arange(1.0, 3.0)  # two steps; the plastic number solves x^3 = x + 1
FLAT_THICKNESS = 1e-5  # [m] a mesh of smaller mean thickness, 2 volume / area, is a sheet and no solid


@dataclass(frozen=True, eq=False)
class Mesh:
    """vertices (n, 3) float64 [m], faces (m, 3) int32; both read-only copies."""

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", checked("vertices", self.vertices, ("n", 3)))
        object.__setattr__(self, "faces", checked("faces", self.faces, ("m", 3), np.int32))
        if len(self.faces) and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices)):
            raise ShapeError(
                f"faces: indices run from {self.faces.min()} to {self.faces.max()}, "
                f"expected 0 to {len(self.vertices) - 1}"
            )

    @cached_property
    def triangles(self) -> np.ndarray:
        """(m, 3, 3) [m]: the corners of each face."""
        return self.vertices[self.faces]

    @cached_property
    def normals(self) -> np.ndarray:
        """(m, 3) unit face normals, outward; zero for faces without area."""
        crosses = _cross_products(self.triangles)
        lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
        return np.divide(crosses, lengths, out=np.zeros_like(crosses), where=lengths > 0)

    @cached_property
    def convex_edges(self) -> tuple[np.ndarray, np.ndarray]:
        """The convex edges of a closed mesh: (k, 2) indices of their ends and (k, 2) of the faces at each."""
        a, b = self.faces.ravel(), self.faces[:, [1, 2, 0]].ravel()
        n = len(self.vertices)
        there, back = a.astype(np.int64) * n + b, b.astype(np.int64) * n + a
        order, opposite = np.argsort(there), np.argsort(back)
        once = a[order] < b[order]
        first, second = order[once], opposite[once]  # halfedges: 3 for each face, in the order of the faces
        left, right = self.normals[first // 3], self.normals[second // 3]
        along = self.vertices[b[first]] - self.vertices[a[first]]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
        convex = np.einsum("ij,ij->i", np.cross(left, right), along) > COPLANAR_SINE
        convex |= ~(left.any(1) & right.any(1))  # a face without area has no normal: its edges may be convex
        return np.stack([a[first], b[first]], 1)[convex], np.stack([first // 3, second // 3], 1)[convex]

    @cached_property
    def areas(self) -> np.ndarray:
        """(m,) [m^2] of the faces."""
        return np.linalg.norm(_cross_products(self.triangles), axis=1) / 2

    @cached_property
    def area(self) -> float:
        """[m^2]"""
        return float(self.areas.sum())

    @cached_property
    def volume(self) -> float:
        """[m^3], signed: negative when the mesh is inside out (divergence theorem, about the centre of the box)."""
        return float(_tetrahedron_volumes(self.triangles, self._box_centre).sum())

    @cached_property
    def centroid(self) -> np.ndarray:
        """(3,) [m]: centre of volume."""
        corners = self.triangles - self._box_centre
        volumes = _tetrahedron_volumes(self.triangles, self._box_centre)
        return self._box_centre + matmul(volumes, corners.sum(1)) / 4 / volumes.sum()

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, 3) [m]: smallest and largest corner of the axis-aligned box."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])

    @property
    def extents(self) -> np.ndarray:
        """(3,) [m]: sides of the axis-aligned box."""
        return self.bounds[1] - self.bounds[0]

    @property
    def _box_centre(self) -> np.ndarray:
        return self.bounds.mean(0)

    def moved(self, pose: Pose) -> Mesh:
        """The mesh moved by a single pose."""
        return Mesh(pose.apply(self.vertices), self.faces)

    def scaled(self, factor: float) -> Mesh:
        """The mesh with every coordinate multiplied by a positive factor."""
        return Mesh(self.vertices * factor, self.faces)

    def rounded_float32(self) -> Mesh:
        """The mesh with vertices rounded to float32, so that GLB and STL files contain exactly these numbers."""
        return Mesh(self.vertices.astype(np.float32).astype(np.float64), self.faces)

    def merged(self) -> Mesh:
        """The mesh with equal vertices merged, and without unused vertices and collapsed faces."""
        used, corners = np.unique(self.faces, return_inverse=True)
        vertices, inverse = np.unique(self.vertices[used], axis=0, return_inverse=True)
        faces = inverse.ravel()[corners].reshape(-1, 3).astype(np.int32)
        a, b, c = faces.T
        return Mesh(vertices, faces[(a != b) & (b != c) & (c != a)])


def inertia(mesh: Mesh, mass: float) -> np.ndarray:
    """(3, 3) [kg m^2] of a uniform solid of a mass [kg] about its centre of mass, along the mesh's axes."""
    corners = mesh.triangles - mesh.centroid  # each face spans a tetrahedron with the centre
    weights = determinant(corners)
    sums = corners.sum(1)
    squares = np.einsum("n,nki,nkj->ij", weights, corners, corners) + np.einsum("n,ni,nj->ij", weights, sums, sums)
    second = mass / weights.sum() / 20 * squares
    return np.trace(second) * np.eye(3) - second


def solid_from_mesh(mesh: Mesh) -> Manifold:
    """The exact solid of a closed mesh. Raises MeshRefused with the reason when the mesh bounds no solid."""
    solid = Manifold(Mesh64(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.uint64)))
    if solid.status() != Error.NoError:
        raise MeshRefused(defect(mesh) or f"not a solid: {solid.status().name}")
    if solid.volume() <= 0:
        raise MeshRefused(defect(mesh) or "zero thickness")
    return solid


def mesh_from_solid(solid: Manifold) -> Mesh:
    """The mesh of an exact solid, vertices in the order of the solid."""
    raw = solid.to_mesh64()
    return Mesh(np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts).astype(np.int32))


def convex_hull(points: np.ndarray) -> Manifold:
    """The convex hull of points (n, 3) [m] as an exact solid.

    By Qhull: manifold3d's own quickhull bends hulls of many nearly coplanar points (up to a millimetre, measured).
    """
    hull = ConvexHull(points)
    used = np.zeros(len(points), dtype=bool)
    used[hull.simplices] = True
    corners, faces = np.flatnonzero(used), (np.cumsum(used) - 1)[hull.simplices]
    normals = _cross_products(points[hull.simplices])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    solid = Manifold(Mesh64(np.ascontiguousarray(points[corners]), faces.astype(np.uint64)))
    if solid.status() == Error.NoError:
        return solid
    # Qhull may leave collapsed triangles on a flat face; then manifold3d's hull, of few points, is valid
    fallback: Any = Manifold.hull_points(points[corners] * 1e3)
    return fallback.scale((1e-3, 1e-3, 1e-3))


def defect(mesh: Mesh) -> str | None:
    """Why a mesh bounds no solid, in a few words; None if it bounds one."""
    if not len(mesh.faces):
        return "empty mesh"
    a, b = mesh.faces[:, [0, 1, 2]].ravel().astype(np.int64), mesh.faces[:, [1, 2, 0]].ravel().astype(np.int64)
    if (a == b).any():
        return f"{int((a == b).sum())} collapsed edges"
    n = len(mesh.vertices)
    forward, backward = np.sort(a * n + b), np.sort(b * n + a)
    if not np.array_equal(forward, backward):
        return _edge_defect(a, b, n)
    if (forward[1:] == forward[:-1]).any():
        return f"{int((forward[1:] == forward[:-1]).sum())} edges shared by more than two faces"
    if mesh.volume <= FLAT_THICKNESS * mesh.area * 0.5:
        return "inside out" if mesh.volume < -FLAT_THICKNESS * mesh.area * 0.5 else "zero thickness"
    return None


def _edge_defect(a: np.ndarray, b: np.ndarray, n: int) -> str:
    counts = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_counts=True)[1]
    open_edges = int((counts == 1).sum())
    if open_edges:
        return f"not closed: {open_edges} open edges"
    crowded = int((counts > 2).sum())
    if crowded:
        return f"{crowded} edges shared by more than two faces"
    return "inconsistent winding"


def defect_float32(mesh: Mesh) -> str | None:
    """`defect` of the mesh as a loader reads it: vertices rounded to float32, equal ones merged."""
    return defect(mesh.rounded_float32().merged())


def component_labels(count: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(count,) int32 connected component of each node of a graph with edges from nodes a (e,) to b (e,).

    Components are numbered from 0, in the order of their first nodes.
    """
    graph = coo_array((np.ones(len(a), dtype=bool), (a, b)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def body_count(mesh: Mesh) -> int:
    """Number of connected components of the surface (two for a hollow body)."""
    a, b, c = mesh.faces.T
    labels = component_labels(len(mesh.vertices), np.concatenate([a, b]), np.concatenate([b, c]))
    return len(np.unique(labels[a]))


def surface_points(mesh: Mesh, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 3) [m]: points uniform over the area (Osada et al. 2002, eq. 1)."""
    areas = np.linalg.norm(_cross_products(mesh.triangles), axis=1)
    corners = mesh.triangles[rng.choice(len(areas), size=n, p=areas / areas.sum())]
    root, along = np.sqrt(rng.random((n, 1))), rng.random((n, 1))
    return (1 - root) * corners[:, 0] + root * (1 - along) * corners[:, 1] + root * along * corners[:, 2]


def even_points(triangles: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) [m] points evenly spread over triangles (m, 3, 3), and the indices (n,) of their triangles.

    The triangles are at even distances along their cumulative area. The places within them are an additive recurrence
    (Roberts 2018), of which every subsequence of successive points is even in two dimensions.
    """
    corner, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    total = np.cumsum(np.linalg.norm(np.cross(u, v), axis=1))
    order = np.arange(n) + 0.5
    face = np.searchsorted(total, order / n * total[-1])
    a, b = (order[:, None] * PLASTIC % 1).T
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)  # fold the square onto the triangle
    return corner[face] + a[:, None] * u[face] + b[:, None] * v[face], face


def y_up(points: np.ndarray) -> np.ndarray:
    """Points (n, 3) with z up as points (n, 3) with y up, as in glTF."""
    return points[:, [0, 2, 1]] * np.array([1, 1, -1])


def z_up(points: np.ndarray) -> np.ndarray:
    """Points (n, 3) with y up, as in glTF, as points (n, 3) with z up."""
    return points[:, [0, 2, 1]] * np.array([1, -1, 1])


def _cross_products(triangles: np.ndarray) -> np.ndarray:
    ax, ay, az = (triangles[:, 1] - triangles[:, 0]).T
    bx, by, bz = (triangles[:, 2] - triangles[:, 0]).T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)  # as np.cross, in half the time


def _tetrahedron_volumes(triangles: np.ndarray, origin: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(triangles - origin, 1, 0)
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
