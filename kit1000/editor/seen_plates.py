"""The plates that the page knows: planes of the kits as perception finds them, or of their known shape; the table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree

from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import eigenvectors, matmul
from kit1000.perception.image_kinds import Noise
from kit1000.perception.observed.pixels import oriented_points
from kit1000.perception.observed.plates import find_planes, on_plane, without_nested
from kit1000.pose import unit_vector
from kit1000.rng import stream
from kit1000.values import View

SMALLEST = 1500e-6  # [m^2] observed, of a plate
SMALLEST_OUTLINE = 400e-6  # [m^2] of a plate of known shape, cavity included
LEAST_FACE = 100e-6  # [m^2] of a plate of known shape, without its cavity
COMPACT = 0.8  # least area of the outline, over the square of its radius: brackets have narrow upper faces
LEVEL = 1e-4  # [m] above a plate, up to which an island in its cavity is level with it
STEEPEST = np.cos(np.radians(50))  # of the normal of a plate
DEEPEST = 25e-3  # [m] no cavity is deeper
ABOVE = 4e-3  # [m] above a plate, where points still belong to it
MARGIN = 12e-3  # [m] around a plate's observed points
SAMPLE = 6000  # points that are enough
JOINED = 4.0  # mean spacings of points, up to which they belong to one plate


@dataclass(frozen=True, eq=False)
class Plate:
    """The upper face of a kit, or the table."""

    normal: np.ndarray
    """(3,) unit, world, up."""
    point: np.ndarray
    """(3,) [m] world: the middle of its observed points."""
    radius: float
    """[m] from the middle to the farthest of them."""
    corners: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(k, 3) [m] world, in its plane: the convex outline of these points; none of the table."""

    def height(self, points: np.ndarray) -> np.ndarray:
        """(...,) [m] of points (..., 3) above its plane."""
        return matmul(points - self.point, self.normal)

    def projected(self, point: np.ndarray) -> np.ndarray:
        """(3,) [m] the point of its plane below or above a point (3,) [m]."""
        return point - float(self.height(point)) * self.normal

    def holds(self, points: np.ndarray) -> np.ndarray:
        """(...,) bool: whether points (..., 3) [m] are on it or in its cavity."""
        height = self.height(points)
        across = points - self.point - height[..., None] * self.normal
        near = np.square(across).sum(-1) < (self.radius + MARGIN) ** 2
        return near & (height < ABOVE) & (height > -DEEPEST)

    def lid(self) -> Mesh:
        """[m] world: its outline as a surface, without its cavity and without holes where nothing was seen."""
        fan = np.arange(1, len(self.corners) - 1, dtype=np.int32)
        return Mesh(self.corners, np.stack([np.zeros_like(fan), fan, fan + 1], axis=-1))

    def crossing(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
        """(3,) [m] where a ray meets its plane from above; None if it does not."""
        along = float(matmul(direction, self.normal))
        distance = -float(self.height(origin))
        return None if along > -1e-6 or distance > 0 else origin + direction * (distance / along)


TABLE = Plate(np.array([0.0, 0.0, 1.0]), np.zeros(3), 1.0)


def find_plates(view: View, mask: np.ndarray, noise: Noise) -> list[Plate]:
    """The plates of the kits in a depth image, the largest first. mask: (H, W) bool, the pixels of the kits."""
    points, normals, area = oriented_points(view, mask, noise.window)
    step = 1 + len(points) // SAMPLE
    points, normals, area = points[::step], normals[::step], area * step
    planes = find_planes(points, normals, area, noise, stream(0, "plates of the page"))
    planes = without_nested(planes, points, normals, noise)
    bodies = [body for plane in planes for body in _bodies(points[on_plane(plane, points, normals, noise)], area)]
    return [_plate(body) for body in sorted(bodies, key=len, reverse=True)]


def plates_of(kits: Mesh) -> list[Plate]:
    """The plates of kits of known shape [m] world, the largest first: their upper faces but those inside a cavity."""
    normals = kits.normals
    up = np.flatnonzero(normals[:, 2] > STEEPEST)
    offsets = (kits.triangles[up].mean(1) * normals[up]).sum(1)
    _, plane = np.unique(np.column_stack([normals[up].round(3), offsets.round(4)]), axis=0, return_inverse=True)
    wide = np.flatnonzero(np.bincount(plane.ravel(), kits.areas[up]) > LEAST_FACE)
    faces = [kits.faces[up[plane.ravel() == i]] for i in wide]
    plates = [_plate(kits.vertices[used]) for own in faces for used in _connected(own)]
    plates = [plate for plate in plates if _outline_area(plate) > max(SMALLEST_OUTLINE, COMPACT * plate.radius**2)]
    plates.sort(key=_outline_area, reverse=True)
    return [plate for plate in plates if not any(_is_inside(plate, other) for other in plates)]


def _connected(faces: np.ndarray) -> list[np.ndarray]:
    """Indices of the vertices of triangles (n, 3), in groups that share no vertex."""
    used, of = np.unique(faces, return_inverse=True)
    a, b, c = of.reshape(-1, 3).T
    links = coo_matrix((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, c]))), (len(used), len(used)))
    _, labels = connected_components(links, directed=False)
    return [used[labels == label] for label in range(labels.max() + 1)]


def _outline_area(plate: Plate) -> float:
    """[m^2] as seen from above."""
    return float(ConvexHull(plate.corners[:, :2]).volume)


def _is_inside(plate: Plate, other: Plate) -> bool:
    """Whether a plate is the floor of a cavity in another one, or an island there."""
    height = other.height(plate.corners)
    lower = bool((height < LEVEL).all())
    above = (plate.corners - height[:, None] * other.normal)[:, :2]
    sides = ConvexHull(other.corners[:, :2]).equations
    return plate is not other and lower and bool((matmul(above, sides[:, :2].T) + sides[:, 2] < 0).all())


def _bodies(points: np.ndarray, area: float) -> list[np.ndarray]:
    """The points (n, 3) [m] of a plane in groups that are apart, as plates in one plane are; small groups are left out.

    area: [m^2] that a point represents.
    """
    if not len(points):
        return []
    pairs = KDTree(points).sparse_distance_matrix(KDTree(points), JOINED * float(np.sqrt(area)))
    _, labels = connected_components(pairs, directed=False)
    return [points[labels == label] for label in np.flatnonzero(np.bincount(labels) * area > SMALLEST)]


def plate_at(plates: list[Plate], point: np.ndarray) -> Plate | None:
    """The plate that a point (3,) [m] is on, of several the nearest; None if it is on none."""
    holding = [plate for plate in plates if bool(plate.holds(point))]
    return min(holding, key=lambda plate: abs(float(plate.height(point))), default=None)


def _fitted(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3,) upward normal and (3,) [m] middle of the plane through points (n, 3)."""
    middle = points.mean(0)
    centred = points - middle
    normal = unit_vector(eigenvectors(matmul(centred.T, centred))[:, 0])
    return (normal if normal[2] > 0 else -normal), middle


def _plate(points: np.ndarray) -> Plate:
    """The plate with these observed points (n, 3) [m]."""
    normal, middle = _fitted(points)
    flat = points - matmul(points - middle, normal)[:, None] * normal
    outline = ConvexHull(flat[:, :2]).vertices  # as seen from above: no plate is steep
    return Plate(normal, middle, float(np.sqrt(np.square(points - middle).sum(-1).max())), flat[outline])
