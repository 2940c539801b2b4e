"""The plates of an assembly of kits: large planes that look up, each with the relief of what is cut into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.pose import Pose

HYPOTHESES = 400
SAMPLE = 6000
STEEPEST = np.cos(np.radians(52))  # no plate leans more than 45 degrees; the rest is noise
SMALLEST = 500e-6  # [m^2] of a plane that is taken for a plate
PARALLEL = np.cos(np.radians(5))  # a floor is parallel to its plate
FLOOR = 25e-3  # [m] and lies at most so far below


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane that looks up."""

    normal: np.ndarray
    """(3,) unit, world."""
    point: np.ndarray
    """(3,) [m] world: the middle of what was seen of it."""
    area: float
    """[m^2] that was seen of it."""


def find_planes(
    points: np.ndarray, normals: np.ndarray, area: float, near: float, flat: float, rng: np.random.Generator
) -> list[Plane]:
    """The planes that hold most points and look up, one after the other, floors of cavities left out.

    Args:
        points, normals: (n, 3) [m] and unit vectors, world; each stands for an area [m^2].
        near: [m] how far a point of a plane may lie from it; flat: [rad] how far a normal may lean from its own.
        rng: draws which points name planes.
    """
    order = rng.permutation(len(points))[:SAMPLE]
    area *= len(points) / max(len(order), 1)
    points, normals = points[order], normals[order]
    up = normals[:, 2] > STEEPEST
    points, normals = points[up], normals[up]
    planes: list[Plane] = []
    while len(points) * area > SMALLEST and len(planes) < 8:
        plane, members = _best_plane(points, normals, near, np.cos(2 * flat), rng)
        if members.sum() * area < SMALLEST:
            break
        planes.append(Plane(plane[:3], points[members].mean(0), float(members.sum() * area)))
        points, normals = points[~members], normals[~members]
    return [plane for plane in planes if not any(_is_floor(plane, other) for other in planes)]


def _best_plane(
    points: np.ndarray, normals: np.ndarray, near: float, agrees: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """(4,) normal and offset of the plane with most members, refitted, and (n,) bool of its members."""
    picks = rng.integers(len(points), size=min(HYPOTHESES, len(points)))
    offsets = np.einsum("ij,ij->i", points[picks], normals[picks])
    far = np.abs(points @ normals[picks].T - offsets)
    votes = ((far < 2 * near) & (normals @ normals[picks].T > agrees)).sum(0)
    best = int(votes.argmax())
    normal, offset = normals[picks[best]], offsets[best]
    for reach in (3 * near, 2 * near, near, near):
        members = (np.abs(points @ normal - offset) < reach) & (normals @ normal > agrees)
        if members.sum() < 8:
            break
        middle = points[members].mean(0)
        normal = np.linalg.eigh(np.cov((points[members] - middle).T))[1][:, 0]
        normal = normal if normal[2] > 0 else -normal
        offset = float(middle @ normal)
    members = (np.abs(points @ normal - offset) < 2 * near) & (normals @ normal > agrees)
    return np.append(normal, offset), members


def _is_floor(plane: Plane, other: Plane) -> bool:
    """Whether a plane is the floor of a cavity in the other."""
    below = float(other.normal @ (other.point - plane.point))
    across = np.linalg.norm(plane.point - other.point - other.normal * -below)
    return bool(
        plane.normal @ other.normal > PARALLEL and 1.5e-3 < below < FLOOR and plane.area < other.area and across < 0.09
    )


def frame_on(plane: Plane, above: np.ndarray) -> Pose:
    """world_from_plate: z along the normal, the origin on the plane at the foot of a place (3,) [m] of the world."""
    z = plane.normal
    x = np.cross([0.0, 1.0, 0.0], z)  # plates lean by less than 52 degrees: y of the world is never their normal
    x /= np.linalg.norm(x)
    foot = above - z * float(z @ (above - plane.point))
    return Pose.from_rotation_matrix(np.stack([x, np.cross(z, x), z], axis=1), foot)
