"""Physics of an insertion: a compliant hand lowers a part into its slot and releases it; the part comes to rest.

The part starts in the predicted orientation, HOVER out along the insertion axis of the prediction. The hand lowers it
along that axis until it arrives or is blocked, then releases it. The hand is a critically damped spring of limited
force and torque, so it yields on contact. The assembly is fixed and level: z up, ground at z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.kits.brackets import support_meshes
from kit1000.kits.convex_pieces import convex_prisms
from kit1000.kits.goals import nearest_about_axis
from kit1000.kits.seating import HOVER, SEATED_LIMIT, rotation_limit
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.pose import Pose, quaternion_angle, quaternion_conjugate, quaternion_multiply
from kit1000.sim.settle import (
    CHECK_INTERVAL,
    REST_CHECKS,
    REST_SPEEDS,
    ROLLING_FRICTION,
    SPINNING_FRICTION,
    principal_frame,
)
from kit1000.sim.world import GRAVITY, STEP_RATE, World
from kit1000.values import Assembly, Kit, Part

HAND_SPEED = 0.1  # [m/s]
NATURAL_FREQUENCY = 120.0  # [rad/s] of part and hand: half a radian a step, which is still stable
MAX_FORCE, MAX_TORQUE = 5.0, 0.05  # [N], [N m] of the hand: 5 N at an arm of 10 mm
MAX_LAG = 5e-3  # [m] of the part behind the hand, at which the hand is blocked
CATCH_UP_STEPS = 24  # steps that the hand waits at the end of its path
MAX_REST_TIME = 1.5  # [s] that a part may take to come to rest
TIPPED_ANGLE = np.radians(20)  # a part that rotates farther after its release has tipped
OFFSET_TOLERANCE = 1e-3  # [m] lateral, of a seated part, beyond the diagonal of its clearance
OUTCOMES = ("seated", "jammed", "slid", "askew", "tipped", "left")
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Workpiece:
    """A part as a rigid body of the physics engine."""

    pieces: list[np.ndarray]
    """Vertices (n, 3) [m] of its convex pieces, about the centre of mass along the principal axes."""
    part_from_body: Pose
    mass: float
    """[kg]"""
    moments: np.ndarray
    """(3,) [kg m^2] about the principal axes."""

    @staticmethod
    def of(part: Part, pieces: Sequence[np.ndarray]) -> Workpiece:
        """A part and its convex pieces, (n, 3) [m] each in its frame."""
        part_from_body, moments = principal_frame(part.mesh, part.mass)
        back = part_from_body.inverse()
        return Workpiece([back.apply(piece) for piece in pieces], part_from_body, part.mass, moments)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A fixed convex body."""

    vertices: np.ndarray  # (n, 3) [m]
    world_from_body: Pose


@dataclass(frozen=True, eq=False)
class InsertionTrial:
    """The poses of a part in one simulated insertion."""

    release_pose: Pose  # world_from_part when the hand releases it
    rest_pose: Pose  # world_from_part at the end
    blocked: bool  # whether the hand stopped before the end of its path


@dataclass(frozen=True)
class InsertionOutcome:
    """The outcome of an insertion, and the pose error to the goal at which the part is nearest to being seated."""

    outcome: str  # one of OUTCOMES
    height: float  # [m] of the part's frame above the goal, along the slot's axis
    offset: float  # [m] across the slot's axis
    angle: float  # [rad] to the goal's orientation


def assembly_obstacles(assembly: Assembly) -> list[Obstacle]:
    """The convex bodies of an assembly: plates as exact prisms that leave the cavities open, brackets and ribs."""
    plates = [
        Obstacle(prism.vertices, mount.assembly_from_kit)
        for mount in assembly.mounts
        for prism in convex_prisms(mount.kit)
    ]
    return plates + [Obstacle(piece.vertices, Pose.identity()) for piece in support_meshes(assembly.mounts)]


def insert(part: Workpiece, obstacles: Sequence[Obstacle], world_from_part: Pose, axis: np.ndarray) -> InsertionTrial:
    """Insert a part to a predicted pose along a unit axis (3,), out of the cavity in the part's frame; release it.

    The same arguments give the same bytes.
    """
    target = world_from_part @ part.part_from_body
    out = world_from_part.rotate(axis)
    with World() as world:
        world.add_ground()
        for obstacle in obstacles:
            world.add_hull(obstacle.vertices, 0.0, np.zeros(3), obstacle.world_from_body)
        hover = Pose(target.wxyz, target.xyz + HOVER * out)
        friction = {"rollingFriction": ROLLING_FRICTION, "spinningFriction": SPINNING_FRICTION}
        body = world.add_pieces(part.pieces, part.mass, part.moments, hover, **friction)
        blocked = _lower_part(world, body, part, target, out)
        release = world.pose(body)
        _settle(world, body)
        rest = world.pose(body)
    body_from_part = part.part_from_body.inverse()
    return InsertionTrial(release @ body_from_part, rest @ body_from_part, blocked)


def _lower_part(world: World, body: int, part: Workpiece, target: Pose, out: np.ndarray) -> bool:
    """Move the hand from HOVER to the target, world_from_body; whether it is blocked. out: (3,) axis in the world."""
    steps = round(HOVER / HAND_SPEED * STEP_RATE)
    now = world.pose(body)
    for step in range(1, steps + CATCH_UP_STEPS + 1):
        left = HOVER * max(1 - step / steps, 0.0)
        hand = target.xyz + left * out
        linear, angular = world.velocity(body)
        hand_velocity = -HAND_SPEED * (left > 0) * out
        pull = NATURAL_FREQUENCY**2 * (hand - now.xyz) + 2 * NATURAL_FREQUENCY * (hand_velocity - linear)
        force = clamp_norm(part.mass * pull, MAX_FORCE) + part.mass * GRAVITY * UP  # the hand also carries the weight
        world.push(body, force, clamp_norm(_torque(part, now, target.wxyz, angular), MAX_TORQUE))
        world.step()
        now = world.pose(body)
        if matmul(now.xyz - hand, out) > MAX_LAG:
            return True
    return False


def _torque(part: Workpiece, now: Pose, wxyz: np.ndarray, angular: np.ndarray) -> np.ndarray:
    """(3,) [N m] that rotates a part towards an orientation (4,), and damps its angular velocity (3,) [rad/s]."""
    error = Pose(quaternion_multiply(wxyz, quaternion_conjugate(now.wxyz)), np.zeros(3)).rotvec()
    axes = now.rotation_matrix()
    return matmul(axes, part.moments * matmul(axes.T, NATURAL_FREQUENCY**2 * error - 2 * NATURAL_FREQUENCY * angular))


def clamp_norm(vector: np.ndarray, limit: float) -> np.ndarray:
    """A vector (3,), shortened to a length if it is longer."""
    return vector * min(1.0, limit / max(length(vector), 1e-300))


def _settle(world: World, body: int) -> None:
    """Step until the part is at rest or time is up."""
    slow_checks = 0
    for _ in range(int(MAX_REST_TIME * STEP_RATE / CHECK_INTERVAL)):
        world.step(CHECK_INTERVAL)
        slow = all(speed < limit for speed, limit in zip(world.speeds(body), REST_SPEEDS, strict=True))
        slow_checks = slow_checks + 1 if slow else 0
        if slow_checks == REST_CHECKS:
            return


def classify_outcome(kit: Kit, kit_from_release: Pose, kit_from_rest: Pose) -> InsertionOutcome:
    """The outcome of an insertion, from the part's poses at release and at rest in the frame of its kit."""
    rotation = float(quaternion_angle(kit_from_release.wxyz, kit_from_rest.wxyz))
    limits = (
        min(SEATED_LIMIT, kit.slot.depth / 3),
        kit.slot.clearance * 2**0.5 + OFFSET_TOLERANCE,
        rotation_limit(kit.slot.clearance),
    )
    errors = min((_errors(kit, kit_from_rest, goal) for goal in kit.slot.goals), key=lambda e: _excess(e, limits))
    outcome = "seated" if _excess(errors, limits) <= 1 else _failure_kind(kit, kit_from_rest, errors, limits, rotation)
    return InsertionOutcome(outcome, *errors)


def _errors(kit: Kit, pose: Pose, goal: Pose) -> tuple[float, float, float]:
    """Height [m], lateral distance [m] and angle [rad] of a pose from a goal at its best angle about the free axis."""
    if kit.slot.free_axis is not None:
        goal = nearest_about_axis(pose, goal, kit.slot.free_axis)
    x, y, z = pose.xyz - goal.xyz
    return float(z), float(np.hypot(x, y)), float(quaternion_angle(pose.wxyz, goal.wxyz))


def _excess(errors: tuple[float, float, float], limits: tuple[float, float, float]) -> float:
    """The largest error as a fraction of its limit."""
    return max(abs(error) / limit for error, limit in zip(errors, limits, strict=True))


def _failure_kind(
    kit: Kit, pose: Pose, errors: tuple[float, float, float], limits: tuple[float, float, float], rotation: float
) -> str:
    """The outcome of a part that is not seated: the first that applies, the most severe first."""
    height, offset, _ = errors
    if (np.abs(pose.xyz[:2]) > kit.extent[:2] / 2).any() or pose.xyz[2] < -kit.extent[2]:
        return "left"
    if rotation > TIPPED_ANGLE:
        return "tipped"
    if abs(height) > limits[0]:
        return "jammed"
    return "slid" if offset > limits[1] else "askew"
