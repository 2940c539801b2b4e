"""The plates in a depth image: large planes of the kits that face up, and which plate a point belongs to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import eigenvectors, length, matmul
from kit1000.pose import unit_vector

SAMPLE = 4000  # points that are enough
SEEDS = 96  # places at which a plane is tried
PATCH = 8e-3  # [m] about a seed, from which its plane is fitted first
WIDEST = 0.07  # [m] from a seed: a plate is no larger
EXACT, NOISY = 0.8e-3, 2e-3  # [m] of the points of a plane from it, by whether the sensor has noise
STEEPEST = float(np.cos(np.radians(52)))  # no plate is tilted by more than 45 degrees
SMALLEST = 1500e-6  # [m^2] observed, of a plate
DEEPEST = 25e-3  # [m] no cavity is deeper
ABOVE = 4e-3  # [m] above a plate, where points still belong to it
MARGIN = 12e-3  # [m] around a plate's observed points
PARALLEL = float(np.cos(np.radians(5)))  # of the floor of a cavity to its plate
ROUNDS = 4  # of refitting
MOST = 8  # plates


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
        """(3,) [m] where a ray meets its plane from above; None where it does not."""
        along = float(matmul(direction, self.normal))
        distance = -float(self.height(origin))
        return None if along > -1e-6 or distance > 0 else origin + direction * (distance / along)


TABLE = Plate(np.array([0.0, 0.0, 1.0]), np.zeros(3), 1.0)


def find_plates(kits: Mesh, area: float, noisy: bool) -> list[Plate]:
    """The plates of the kits, the largest first.

    Args:
        kits: as seen; its vertices are spread evenly over the image.
        area: [m^2] that a vertex stands for.
        noisy: whether the sensor has noise.
    """
    reach = NOISY if noisy else EXACT
    step = max(1, len(kits.vertices) // SAMPLE)
    points, area, found = kits.vertices[::step], area * step, []
    while len(points) * area > SMALLEST and len(found) < MOST:
        best = _largest_plane(points, reach)
        if best is None or int(best.sum()) * area < SMALLEST:
            break
        found.append(_plate(points[best]))
        points = points[~(np.abs(found[-1].height(points)) < 2 * reach) | ~found[-1].holds(points)]
    return [plate for plate in found if not any(_is_floor(plate, other) for other in found)]


def plate_at(plates: list[Plate], point: np.ndarray) -> Plate | None:
    """The plate that a point (3,) [m] is on, of several the nearest; None where it is on none."""
    holding = [plate for plate in plates if bool(plate.holds(point))]
    return min(holding, key=lambda plate: abs(float(plate.height(point))), default=None)


def _largest_plane(points: np.ndarray, reach: float) -> np.ndarray | None:
    """(n,) bool: the points of the plane with most of them; None where no patch faces up."""
    best: np.ndarray | None = None
    for seed in points[:: max(1, len(points) // SEEDS)]:
        inside = np.square(points - seed).sum(-1) < PATCH**2
        near = np.square(points - seed).sum(-1) < WIDEST**2
        for _ in range(ROUNDS):
            if inside.sum() < 8:
                break
            normal, middle = _fitted(points[inside])
            if normal[2] < STEEPEST:
                break
            inside = near & (np.abs(matmul(points - middle, normal)) < reach)
        else:
            if best is None or inside.sum() > best.sum():
                best = inside
    return best


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


def _is_floor(plate: Plate, other: Plate) -> bool:
    """Whether a plane is the floor of a cavity in another."""
    below = -float(other.height(plate.point))
    across = length(plate.point - other.point + below * other.normal)
    parallel = float(matmul(plate.normal, other.normal)) > PARALLEL
    return parallel and 1.5e-3 < below < DEEPEST and plate.radius < other.radius and across < other.radius
