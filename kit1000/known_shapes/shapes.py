"""Known shapes, the faces on which they can stand, their poses on a table, and the distance between two poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from scipy.spatial import ConvexHull, KDTree

from kit1000.known_shapes.support import Support, standing_frame
from kit1000.mesh import Mesh, surface_points
from kit1000.pose import Pose, quaternion_between
from kit1000.rng import stream

APART = np.radians(8)  # between the faces that are tried
MOST_FACES = 12
FLAT = 1e-6  # [m] by which vertices of one face may leave its plane
COPLANAR_DECIMALS = 5  # of the normals of one face
DENSE, SPARSE = 6000, 600  # points of a surface that are searched, and that are looked up
FARTHEST = 98  # percent of the points: single ones of a sparse surface may lie farther from their neighbours
MOST_YAW = 1.0  # [rad] standard deviation of a yaw that nothing shows
UP = np.array([0.0, 0.0, 1.0])
KITS = "kits"  # name of the kits among the bodies of a scene


@dataclass(frozen=True, eq=False)
class KnownShape:
    """A shape whose mesh is known, and how it can stand on a table."""

    name: str
    mesh: Mesh
    downs: np.ndarray
    """(k, 3) unit: outward normals of the faces that it can stand on, the largest first."""

    @staticmethod
    def of(name: str, mesh: Mesh) -> KnownShape:
        """A shape that may stand on any stable face of its convex hull."""
        return KnownShape(name, mesh, stable_normals(mesh))

    @staticmethod
    def upright(name: str, mesh: Mesh) -> KnownShape:
        """A shape that stands as it is, z up."""
        return KnownShape(name, mesh, -UP[None])

    @cached_property
    def corners(self) -> np.ndarray:
        """(8, 3) [m] of its box."""
        return np.array(list(product(*self.mesh.bounds.T)))

    @cached_property
    def distance(self) -> ShapeDistance:
        """The distance between two of its poses."""
        return ShapeDistance(self.mesh)

    @cached_property
    def levels(self) -> tuple[Pose, ...]:
        """table_from_body for each face down: its box is centred over the origin, its lowest point is at z = 0."""
        kept: list[np.ndarray] = []
        for down in self.downs:
            if all(down @ other < np.cos(APART) for other in kept):
                kept.append(down)
        return tuple(_level(self.mesh, down) for down in kept[:MOST_FACES])


def _level(mesh: Mesh, down: np.ndarray) -> Pose:
    upright = Pose(quaternion_between(down, -UP), np.zeros(3))
    corners = upright.apply(mesh.vertices)
    low, high = corners.min(0), corners.max(0)
    return Pose.from_translation((*(-(low + high) / 2)[:2], -low[2])) @ upright


def stable_normals(mesh: Mesh) -> np.ndarray:
    """(k, 3) outward normals of the hull's faces over which the centre of volume lies, the largest face first."""
    hull, centre = ConvexHull(mesh.vertices), mesh.centroid
    planes = np.unique(hull.equations.round(COPLANAR_DECIMALS), axis=0, return_index=True)[1]
    found = []
    for normal, offset in ((hull.equations[i, :3], hull.equations[i, 3]) for i in planes):
        corners = mesh.vertices[hull.vertices]
        on = corners[np.abs(corners @ normal + offset) < FLAT]
        flat = _flattened(on, normal)
        if len(on) < 3 or np.linalg.matrix_rank(flat[1:] - flat[0], tol=FLAT) < 2:
            continue
        face = ConvexHull(flat, qhull_options="QJ")
        if (face.equations[:, :2] @ _flattened(centre[None], normal)[0] + face.equations[:, 2]).max() <= 0:
            found.append((face.volume, normal))
    found.sort(key=lambda entry: -entry[0])
    return np.array([normal for _, normal in found])


def _flattened(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n, 2) points (n, 3) seen along a normal."""
    return Pose(quaternion_between(normal, UP), np.zeros(3)).rotate(points)[:, :2]


@dataclass(frozen=True, eq=False)
class StandingShape:
    """A known shape that stands on the table of an image, with one of its faces down."""

    shape: KnownShape
    level: Pose
    """table_from_body, one of `KnownShape.levels`."""
    place: np.ndarray
    """(3,) x and y [m] on the table, in measured lengths, and yaw [rad]."""
    table: Pose
    """camera_from_table in measured lengths."""

    def at(self, place: np.ndarray) -> StandingShape:
        """The same shape at another place."""
        return replace(self, place=np.asarray(place, float))

    def camera_from_body(self, scale: float = 1.0) -> Pose:
        """Its pose in true lengths. scale: measured over true depth."""
        return _camera_from_body(self, scale)

    @property
    def radius(self) -> float:
        """[m] half the diagonal of its box."""
        return float(np.linalg.norm(self.shape.mesh.extents)) / 2

    def surface_spread(self, covariance: np.ndarray) -> float:
        """[m] RMS by which its surface may lie off along its normals. covariance: (3, 3) of its place.

        The yaw of a round shape, which no image shows, moves no surface.
        """
        mesh, pose = self.shape.mesh, self.table.inverse() @ self.camera_from_body()
        corners = pose.apply(mesh.vertices)[mesh.faces]
        middles = (corners + np.roll(corners, 1, axis=1)) / 2  # of edges: their mean square is that of the face
        arms = middles[..., :2] - self.place[:2]
        x, y, _ = np.broadcast_to(pose.rotate(mesh.normals)[:, None], middles.shape).T
        moves = np.stack([x, y, y * arms[..., 0].T - x * arms[..., 1].T])
        squares = np.einsum("iek,jek,k->ij", moves, moves, mesh.areas / (3 * mesh.area))
        least = np.diag([1.0, 1.0, min(1.0, MOST_YAW / np.sqrt(covariance[2, 2]))])
        return float(np.sqrt(np.trace(least @ covariance @ least @ squares)))

    def near(self, other: StandingShape, gap: float) -> bool:
        """Whether another shape may be within a gap [m]."""
        return apart(self, other) < self.radius + other.radius + gap

    @staticmethod
    def by_pose(shape: KnownShape, support: Support, camera_from_body: Pose, scale: float = 1.0) -> StandingShape:
        """The standing shape nearest to a pose in true lengths. scale: measured over true depth."""
        table = table_frame(support)
        measured = Pose(camera_from_body.wxyz, camera_from_body.xyz * scale)
        down = camera_from_body.inverse().rotate(-support.normal)
        level = max(shape.levels, key=lambda each: float(each.inverse().rotate(-UP) @ down))
        flat = (table.inverse() @ measured).rotation_matrix() @ level.rotation_matrix().T
        foot = table.inverse().apply(measured.apply(np.zeros(3)) + measured.rotate(level.inverse().xyz) * scale)
        return StandingShape(shape, level, np.array([*foot[:2], np.arctan2(flat[1, 0], flat[0, 0])]), table)


@lru_cache(maxsize=64)
def _camera_from_body(standing: StandingShape, scale: float) -> Pose:
    x, y, yaw = standing.place
    rotated = Pose(np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]), np.array([x, y, 0.0]) / scale)
    table = standing.table if scale == 1 else Pose(standing.table.wxyz, standing.table.xyz / scale)
    return table @ (rotated @ standing.level)


def table_frame(support: Support) -> Pose:
    """camera_from_table: the frame on the table in which shapes stand, its origin where the optical axis meets it."""
    return standing_frame(support, np.array([0.0, 0.0, support.offset / min(float(support.normal[2]), -1e-3)]))


class ShapeDistance:
    """The distance between poses of one shape: up to its symmetries, and those that no one declared."""

    def __init__(self, mesh: Mesh) -> None:
        """Prepare a mesh, in its own frame."""
        points = surface_points(mesh, DENSE, stream(0, "labelling", "surface"))
        self._tree, self._points = KDTree(points), points[:SPARSE]
        self._spacing = self._far(self._points + 1e-12, 2)

    def between(self, a: Pose, b: Pose) -> float:
        """[m] from the surface at one pose to that at the other, nearly the largest; 0 where they coincide."""
        moved = (a.inverse() @ b).apply(self._points)
        return max(self._far(moved, 1) - self._spacing, 0.0)

    def _far(self, points: np.ndarray, rank: int) -> float:
        """[m] to the neighbour of a rank, nearly the largest."""
        distances = np.reshape(self._tree.query(points, k=rank)[0], (len(points), rank))
        return float(np.percentile(distances[:, -1], FARTHEST))


def apart(a: StandingShape, b: StandingShape) -> float:
    """[m] along the table between the middles of two shapes."""
    return float(np.hypot(*(a.place[:2] - b.place[:2])))


def neighbours(shape: StandingShape, others: Sequence[StandingShape | None], gap: float) -> list[StandingShape]:
    """The other shapes that may be within a gap [m] of a shape."""
    return [other for other in others if other is not None and other is not shape and shape.near(other, gap)]
