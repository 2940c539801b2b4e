"""The plates of an assembly: large planes that face up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import eigenvectors, length, matmul
from kit1000.perception.image_kinds import Noise
from kit1000.pose import Pose, unit_vector

HYPOTHESES = 400
SAMPLE = 6000
STEEPEST = np.cos(np.radians(52))  # no plate is tilted by more than 45 degrees; the rest is noise
SMALLEST = 500e-6  # [m^2] of a plane that counts as a plate
PARALLEL = np.cos(np.radians(5))  # between the normals of a plate and the floor of its cavity
DEEPEST = 25e-3  # [m] of a floor below its plate
LEVEL = 1e-3  # [m] above a plate's face, up to which a point is not above it
DECIMALS = 9  # of a plane's normal, and of a metre for its point: the grid that ends differences in the last bit


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane that faces up."""

    normal: np.ndarray
    """(3,) unit, world."""
    point: np.ndarray
    """(3,) [m] world: the mean of its observed points."""
    area: float
    """[m^2] observed."""


def find_planes(
    points: np.ndarray, normals: np.ndarray, area: float, noise: Noise, rng: np.random.Generator
) -> list[Plane]:
    """The planes that face up, by RANSAC, those with most points first; floors of cavities are left out.

    Args:
        points: (n, 3) [m] world.
        normals: (n, 3) unit, world.
        area: [m^2] that each point represents.
        noise: distance and angle of the points of a plane.
        rng: draws the points that give hypotheses.
    """
    order = rng.permutation(len(points))[:SAMPLE]
    area *= len(points) / max(len(order), 1)
    points, normals = points[order], normals[order]
    up = normals[:, 2] > STEEPEST
    points, normals = points[up], normals[up]
    planes: list[Plane] = []
    while len(points) * area > SMALLEST and len(planes) < 8:
        normal, inliers = _best_plane(points, normals, noise.distance, np.cos(2 * noise.angle), rng)
        if inliers.sum() * area < SMALLEST:
            break
        middle = points[inliers].mean(0).round(DECIMALS)
        planes.append(Plane(normal, middle, float(inliers.sum() * area)))
        points, normals = points[~inliers], normals[~inliers]
    return [plane for plane in planes if not any(_is_floor(plane, other) for other in planes)]


def without_nested(planes: Sequence[Plane], points: np.ndarray, normals: np.ndarray, noise: Noise) -> list[Plane]:
    """The planes (largest first) without those that lie mostly within the outline of a larger one and below it.

    Slanted rims and walls of a cavity look like plates where depth is noisy. Arguments: see `find_planes`.
    """
    kept: list[Plane] = []
    outlines: list[np.ndarray] = []
    for plane in planes:
        own = points[on_plane(plane, points, normals, noise)]
        if any(map(partial(_mostly_within, own), kept, outlines)):
            continue
        try:
            outline = ConvexHull(plane_frame(plane, plane.point).inverse().apply(own)[:, :2]).equations
        except QhullError:  # points on a line are within nothing and hold nothing
            outline = np.array([[0.0, 0.0, 1.0]])
        kept.append(plane)
        outlines.append(outline)
    return kept


def on_plane(plane: Plane, points: np.ndarray, normals: np.ndarray, noise: Noise) -> np.ndarray:
    """(n,) bool: which points (n, 3) [m] with normals (n, 3) lie on a plane and face its way."""
    near = np.abs(matmul(points - plane.point, plane.normal)) < 2 * noise.distance
    return near & (matmul(normals, plane.normal) > np.cos(2 * noise.angle))


def _mostly_within(points: np.ndarray, plane: Plane, outline: np.ndarray) -> bool:
    """Whether most of points (n, 3) [m] lie below a plane's face and within its outline (m, 3), lines ax + by + c."""
    local = plane_frame(plane, plane.point).inverse().apply(points)
    across = (matmul(local[:, :2], outline[:, :2].T) + outline[:, 2]).max(-1)
    within = (across < 0) & (local[:, 2] < LEVEL) & (local[:, 2] > -DEEPEST)
    return bool(2 * within.sum() > len(points))


def _best_plane(
    points: np.ndarray, normals: np.ndarray, distance: float, cosine: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(3,) normal of the plane with most inliers, refitted, and (n,) bool of its inliers."""
    picks = rng.integers(len(points), size=min(HYPOTHESES, len(points)))
    offsets = np.einsum("ij,ij->i", points[picks], normals[picks])
    best = int(_inliers(points, normals, normals[picks], offsets, 2 * distance, cosine).argmax())
    normal, offset = normals[picks[best]], offsets[best]
    for reach in (3 * distance, 2 * distance, distance, distance):
        inliers = (np.abs(matmul(points, normal) - offset) < reach) & (matmul(normals, normal) > cosine)
        if inliers.sum() < 8:
            break
        middle = points[inliers].mean(0)
        centred = points[inliers] - middle
        normal = unit_vector(eigenvectors(matmul(centred.T, centred))[:, 0].round(DECIMALS))
        normal = normal if normal[2] > 0 else -normal
        offset = float(matmul(middle, normal))
    inliers = (np.abs(matmul(points, normal) - offset) < 2 * distance) & (matmul(normals, normal) > cosine)
    return normal, inliers


@compiled
def _inliers(points, normals, plane_normals, offsets, distance, cosine):
    """(m,) how many of points (n, 3) lie within a distance [m] of each plane and face its way.

    The planes are those of plane_normals (m, 3) and offsets (m,) [m] along them.
    """
    counts = np.zeros(len(offsets), np.int64)
    for p in range(len(points)):
        for h in range(len(offsets)):
            along, facing = -offsets[h], 0.0
            for axis in range(3):
                along += points[p, axis] * plane_normals[h, axis]
                facing += normals[p, axis] * plane_normals[h, axis]
            counts[h] += abs(along) < distance and facing > cosine
    return counts


def _is_floor(plane: Plane, other: Plane) -> bool:
    """Whether a plane is the floor of a cavity in the other."""
    below = float(matmul(other.normal, other.point - plane.point))
    across = length(plane.point - other.point - other.normal * -below)
    return bool(
        matmul(plane.normal, other.normal) > PARALLEL
        and 1.5e-3 < below < DEEPEST
        and plane.area < other.area
        and across < 0.09
    )


def plane_frame(plane: Plane, point: np.ndarray) -> Pose:
    """world_from_plate: z along the normal, the origin at the projection of a point (3,) [m] onto the plane."""
    z = plane.normal
    x = np.cross([0.0, 1.0, 0.0], z)  # tilted by less than 52 degrees: y of the world is never the normal
    x /= length(x)
    origin = point - z * float(matmul(z, point - plane.point))
    return Pose.from_rotation_matrix(np.stack([x, np.cross(z, x), z], axis=1), origin)
