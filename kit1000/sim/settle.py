"""Rest poses of parts on the table: dropped by rigid-body physics, then placed exactly on a facet of the convex hull.

On a plane a solid has the contacts of its convex hull. Physics leaves a part some 0.1 mm above the table and slightly
tilted; its contact facet is then levelled and lowered to z = 0, so that a rest pose is a static equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.mesh import Mesh, inertia
from kit1000.numerics.linear_algebra import determinant, eigenvectors, matmul
from kit1000.pose import Pose, quaternion_between
from kit1000.sim.world import STEP_RATE, World

REST_SPEEDS = (1e-3, 0.01)  # [m/s] and [rad/s]: a part below both is at rest
CHECK_INTERVAL = 8  # steps between checks for rest
REST_CHECKS = 3  # successive checks at rest: a rocking part is slow only at its turning points
# By elapsed time [s], the fraction of its speed that a part loses per second: slows parts that keep rolling.
DAMPING = {0.0: 0.04, 1.0: 0.9, 2.0: 0.999}
MAX_TIME = 3.0  # [s] after which a part that still moves counts as unstable
ROLLING_FRICTION = 3e-4  # [m] half of it is the arm of rolling resistance, that of hard wheels on a hard floor
SPINNING_FRICTION = 1e-3  # [m] likewise for spinning about the vertical
MAX_FACET_TILT = np.radians(5)  # of a contact facet from level after physics: a round body may rest on an edge
SUPPORT_TOLERANCE = 1e-6  # [m] vertices this near to the plane of a facet support the part
POSE_GRID = 1e-6  # step to which poses are rounded: [m], and of quaternion components
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class Release:
    """A part and the pose from which it is released with zero velocity."""

    mesh: Mesh
    mass: float  # [kg]
    world_from_part: Pose


@dataclass(frozen=True, eq=False)
class RestPose:
    """The rest pose of a part."""

    world_from_part: Pose  # A multiple of POSE_GRID; the lowest point is within half a step of z = 0
    stable: bool  # whether the part came to rest in time, on a stable facet


@dataclass(frozen=True, eq=False)
class _Solid:
    """The convex hull and the inertia of a part."""

    hull: ConvexHull  # about the centre of mass, along the part's axes
    part_from_body: Pose  # the body frame: at the centre of mass, along the principal axes
    moments: np.ndarray  # (3,) [kg m^2] about those axes

    @classmethod
    def of(cls, mesh: Mesh, mass: float) -> _Solid:
        return cls(ConvexHull(mesh.vertices - mesh.centroid), *principal_frame(mesh, mass))


def settle(releases: Sequence[Release]) -> list[RestPose]:
    """The rest poses of parts released together above the plane z = 0. The same releases give the same bytes."""
    solids = [_Solid.of(release.mesh, release.mass) for release in releases]
    rests: list[RestPose] = []
    with World() as world:
        world.add_ground()
        bodies = [_add_part(world, *pair) for pair in zip(solids, releases, strict=True)]
        for rolling in (ROLLING_FRICTION, 0.0):  # the second pass frees parts that only rolling friction holds
            for body in bodies:
                world.change(body, rollingFriction=rolling, spinningFriction=SPINNING_FRICTION)
            at_rest = _step_until_rest(world, bodies)
            poses = [world.pose(body) for body in bodies]
            rests = [_rest_pose(*item) for item in zip(solids, poses, at_rest, strict=True)]
            if all(rest.stable for rest in rests) or not all(at_rest):
                break
    return rests


def principal_frame(mesh: Mesh, mass: float) -> tuple[Pose, np.ndarray]:
    """The principal frame of a uniform solid, at its centre of mass, and its moments of inertia.

    Returns:
        part_from_body, and (3,) [kg m^2].
    """
    tensor = inertia(mesh, mass)
    axes = principal_axes(tensor)
    rotation = Pose(axes, np.zeros(3)).rotation_matrix()
    return Pose(axes, mesh.centroid), np.einsum("ji,jk,ki->i", rotation, tensor, rotation)


def principal_axes(tensor: np.ndarray) -> np.ndarray:
    """(4,) quaternion body_from_principal, rounded to POSE_GRID; the identity for a tensor that is diagonal already."""
    off_diagonal = tensor - np.diag(np.diag(tensor))
    if np.abs(off_diagonal).max() < 1e-6 * np.trace(tensor):
        return np.array([1.0, 0.0, 0.0, 0.0])
    axes = eigenvectors(tensor)
    axes[:, 2] *= np.sign(determinant(axes))
    return rounded_pose(Pose.from_rotation_matrix(axes)).wxyz


def rounded_pose(pose: Pose) -> Pose:
    """The pose rounded to POSE_GRID, its first non-zero quaternion component positive: removes last-bit differences."""
    wxyz = _rounded(pose.wxyz)
    sign = np.sign(wxyz[np.flatnonzero(wxyz)[0]])
    return Pose(wxyz * sign + 0.0, _rounded(pose.xyz))


def _rounded(values: np.ndarray) -> np.ndarray:
    return np.round(values / POSE_GRID) * POSE_GRID + 0.0  # never minus zero, whose sign is that of a last bit


def _add_part(world: World, solid: _Solid, release: Release) -> int:
    start = rounded_pose(release.world_from_part) @ solid.part_from_body
    points = solid.part_from_body.inverse().apply(release.mesh.vertices)
    return world.add_hull(points, release.mass, solid.moments, start)


def _step_until_rest(world: World, bodies: list[int]) -> list[bool]:
    """Step until every part is at rest or time is up; whether each is at rest."""
    damping = {int(seconds * STEP_RATE / CHECK_INTERVAL): fraction for seconds, fraction in DAMPING.items()}
    slow_checks = np.zeros(len(bodies), dtype=int)
    for check in range(int(MAX_TIME * STEP_RATE / CHECK_INTERVAL)):
        if check in damping:
            for body in bodies:
                world.change(body, linearDamping=damping[check], angularDamping=damping[check])
        world.step(CHECK_INTERVAL)
        slow = [all(v < limit for v, limit in zip(world.speeds(body), REST_SPEEDS, strict=True)) for body in bodies]
        slow_checks = np.where(slow, slow_checks + 1, 0)
        if (slow_checks >= REST_CHECKS).all():
            break
    return (slow_checks >= REST_CHECKS).tolist()


def _rest_pose(solid: _Solid, world_from_body: Pose, at_rest: bool) -> RestPose:
    """The pose moved so that the stable facet nearest to level lies on z = 0."""
    world_from_part = world_from_body @ solid.part_from_body.inverse()
    points, centre = solid.hull.points, solid.part_from_body.xyz
    normals = np.unique(solid.hull.equations[:, :3], axis=0)
    down = world_from_part.rotate(normals)
    tilts = np.arctan2(np.linalg.norm(down[:, :2], axis=1), -down[:, 2])
    candidates = np.argsort(tilts)[: np.count_nonzero(tilts <= MAX_FACET_TILT)]
    facet = next((k for k in candidates if is_stable_facet(points, normals[k])), None)
    levelling = Pose.identity() if facet is None else Pose(quaternion_between(down[facet], DOWN), np.zeros(3))
    rotation = rounded_pose(levelling @ Pose(world_from_part.wxyz, np.zeros(3)))
    world_centre = np.array([*world_from_part.apply(centre)[:2], -rotation.rotate(points)[:, 2].min()])
    xyz = _rounded(world_centre - rotation.rotate(centre))
    return RestPose(Pose(rotation.wxyz, xyz), at_rest and facet is not None)


def is_stable_facet(points: np.ndarray, normal: np.ndarray) -> bool:
    """Whether a body is in static equilibrium on its supporting plane of outward `normal` (3,).

    points: (n, 3) [m] about the centre of mass. The support polygon is the hull of the points on the plane; about a
    centre inside it, no two neighbouring vertices are half a turn apart.
    """
    along = matmul(points, normal)
    support = points[along >= along.max() - SUPPORT_TOLERANCE]
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    angles = np.sort(np.arctan2(matmul(support, np.cross(normal, across)), matmul(support, across)))
    return bool(np.diff(angles, append=angles[0] + 2 * np.pi).max() < np.pi)
