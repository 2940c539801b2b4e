"""How parts come to rest on the table: dropped by physics, then put down exactly.

On a plane a solid touches as its convex hull does. Physics leaves a part some 0.1 mm off the table and a little
askew; the facet it lies on is then made level and lowered to z = 0, so that a rest pose is a static equilibrium.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.mesh import Mesh, inertia
from kit1000.pose import Pose, quaternion_between
from kit1000.sim.world import STEP_RATE, World

REST_SPEEDS = (1e-3, 0.01)  # [m/s] and [rad/s]: a part below both is at rest
CHECK_INTERVAL, REST_CHECKS = (
    8,
    3,
)  # steps between looks, and looks in a row at rest: the turning of a rocking part is none
# By the time that passed [s], the share of its speed that a part loses in a second: what rolls on is slowed down.
DAMPING = {0.0: 0.04, 1.0: 0.9, 2.0: 0.999}
MAX_TIME = 3.0  # [s] until a part that still moves is given up
ROLLING_FRICTION = 3e-4  # [m] half of it is the arm of the resistance to rolling, that of hard wheels on a hard floor
SPINNING_FRICTION = 1e-3  # [m] likewise to turning on the spot
MAX_FACET_TILT = np.radians(
    5
)  # the facet a part lies on is this near to level: one of a round body may stand on an edge
SUPPORT_TOLERANCE = 1e-6  # [m] corners this near to the plane of a facet carry the part
POSE_GRID = 1e-6  # poses are rounded to it [m and of quaternion components]
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class Release:
    """A part let go, at rest."""

    mesh: Mesh
    mass: float
    """[kg]"""
    world_from_part: Pose


@dataclass(frozen=True, eq=False)
class RestPose:
    """Where a part came to lie."""

    world_from_part: Pose
    """On GRID; the lowest point within half of it of z = 0."""
    stable: bool
    """Whether it stopped in time, on a facet that carries it."""


@dataclass(frozen=True, eq=False)
class _Solid:
    """What carries and moves a part."""

    hull: ConvexHull
    """About the centre of mass, along the part's axes."""
    part_from_body: Pose
    """The body's frame: at the centre of mass, along the principal axes."""
    moments: np.ndarray
    """(3,) [kg m^2] about those axes."""

    @classmethod
    def of(cls, mesh: Mesh, mass: float) -> _Solid:
        return cls(ConvexHull(mesh.vertices - mesh.centroid), *principal_frame(mesh, mass))


def settle(releases: Sequence[Release]) -> list[RestPose]:
    """Let parts go, all at once, over the plane z = 0; where they come to rest. The same releases rest the same."""
    solids = [_Solid.of(release.mesh, release.mass) for release in releases]
    rests: list[RestPose] = []
    with World() as world:
        world.add_ground()
        bodies = [_add_part(world, *pair) for pair in zip(solids, releases, strict=True)]
        for rolling in (ROLLING_FRICTION, 0.0):  # what only its resistance to rolling holds in balance may roll on
            for body in bodies:
                world.change(body, rollingFriction=rolling, spinningFriction=SPINNING_FRICTION)
            still = _step_until_rest(world, bodies)
            poses = [world.pose(body) for body in bodies]
            rests = [_rest_pose(*one) for one in zip(solids, poses, still, strict=True)]
            if all(rest.stable for rest in rests) or not all(still):
                break
    return rests


def principal_frame(mesh: Mesh, mass: float) -> tuple[Pose, np.ndarray]:
    """The frame of a uniform solid at its centre of mass along its principal axes, and its moments about them.

    Returns:
        part_from_body, and (3,) [kg m^2].
    """
    tensor = inertia(mesh, mass)
    axes = principal_axes(tensor)
    turn = Pose(axes, np.zeros(3)).rotation_matrix()
    return Pose(axes, mesh.centroid), np.einsum("ji,jk,ki->i", turn, tensor, turn)


def principal_axes(tensor: np.ndarray) -> np.ndarray:
    """(4,) quaternion body_from_principal, on GRID; that of the axes at hand when they are principal ones."""
    aside = tensor - np.diag(np.diag(tensor))
    if np.abs(aside).max() < 1e-6 * np.trace(tensor):
        return np.array([1.0, 0.0, 0.0, 0.0])
    axes = np.linalg.eigh(tensor)[1]
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return rounded_pose(Pose.from_rotation_matrix(axes)).wxyz


def rounded_pose(pose: Pose) -> Pose:
    """The pose rounded to GRID, its quaternion's first number positive: poses that differ in last bits become one."""
    wxyz = _rounded(pose.wxyz)
    return Pose(wxyz * np.sign(wxyz[np.flatnonzero(wxyz)[0]]), _rounded(pose.xyz))


def _rounded(values: np.ndarray) -> np.ndarray:
    return np.round(values / POSE_GRID) * POSE_GRID


def _add_part(world: World, solid: _Solid, release: Release) -> int:
    start = rounded_pose(release.world_from_part) @ solid.part_from_body
    points = solid.part_from_body.inverse().apply(release.mesh.vertices)
    return world.add_hull(points, release.mass, solid.moments, start)


def _step_until_rest(world: World, bodies: list[int]) -> list[bool]:
    """Step until every part is at rest or time is up; which ones are."""
    damping = {int(seconds * STEP_RATE / CHECK_INTERVAL): share for seconds, share in DAMPING.items()}
    quiet = np.zeros(len(bodies), dtype=int)
    for look in range(int(MAX_TIME * STEP_RATE / CHECK_INTERVAL)):
        if look in damping:
            for body in bodies:
                world.change(body, linearDamping=damping[look], angularDamping=damping[look])
        world.step(CHECK_INTERVAL)
        slow = [all(v < limit for v, limit in zip(world.speeds(body), REST_SPEEDS, strict=True)) for body in bodies]
        quiet = np.where(slow, quiet + 1, 0)
        if (quiet >= REST_CHECKS).all():
            break
    return (quiet >= REST_CHECKS).tolist()


def _rest_pose(solid: _Solid, world_from_body: Pose, still: bool) -> RestPose:
    """The pose put down on that facet, of those that carry the part, which is nearest to level."""
    world_from_part = world_from_body @ solid.part_from_body.inverse()
    points, centre = solid.hull.points, solid.part_from_body.xyz
    normals = np.unique(solid.hull.equations[:, :3], axis=0)
    down = world_from_part.rotate(normals)
    leans = np.arctan2(np.linalg.norm(down[:, :2], axis=1), -down[:, 2])
    near = np.argsort(leans)[: np.count_nonzero(leans <= MAX_FACET_TILT)]
    lying = next((k for k in near if is_stable_facet(points, normals[k])), None)
    turn = Pose.identity() if lying is None else Pose(quaternion_between(down[lying], DOWN), np.zeros(3))
    level = rounded_pose(turn @ Pose(world_from_part.wxyz, np.zeros(3)))
    middle = np.array([*world_from_part.apply(centre)[:2], -level.rotate(points)[:, 2].min()])
    return RestPose(Pose(level.wxyz, _rounded(middle - level.rotate(centre))), still and lying is not None)


def is_stable_facet(points: np.ndarray, normal: np.ndarray) -> bool:
    """Whether a body stands on the plane that touches it from the side `normal`: its centre is over the support.

    points: (n, 3) [m] about the centre of mass. The support is the hull of the points on the plane; seen from a
    centre inside it, no two neighbouring corners are half a turn apart.
    """
    along = points @ normal
    support = points[along >= along.max() - SUPPORT_TOLERANCE]
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    angles = np.sort(np.arctan2(support @ np.cross(normal, across), support @ across))
    return bool(np.diff(angles, append=angles[0] + 2 * np.pi).max() < np.pi)
