"""The plates that the page knows: the planes of the kits that perception finds, with their outlines, and the table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
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
    """The plates of the kits, the largest first.

    Args:
        view: the depth image.
        mask: (H, W) bool, the pixels of the kits.
        noise: of the image.
    """
    points, normals, area = oriented_points(view, mask, noise.window)
    step = 1 + len(points) // SAMPLE
    points, normals, area = points[::step], normals[::step], area * step
    planes = find_planes(points, normals, area, noise, stream(0, "plates of the page"))
    planes = without_nested(planes, points, normals, noise)
    bodies = [body for plane in planes for body in _bodies(points[on_plane(plane, points, normals, noise)], area)]
    return [_plate(body) for body in sorted(bodies, key=len, reverse=True)]


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
