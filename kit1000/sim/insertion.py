"""A part put into its slot by a compliant hand, and let go: where does it come to rest?

The hand holds the part in the predicted orientation, HOVER out along the axis that the prediction carries, and lowers
it along that axis until it is there or is held up. Then it lets go. The hand is a critically damped spring with small
limits, so it gives way to what it touches. The world stands still and level: z up, ground at z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.kits.brackets import stand_meshes
from kit1000.kits.convex_pieces import convex_prisms
from kit1000.kits.goals import nearest_turn
from kit1000.kits.seating import HOVER, SEATED_LIMIT
from kit1000.pose import Pose, quaternion_angle, quaternion_conjugate, quaternion_multiply
from kit1000.sim.settle import LOOK_EVERY, QUIET_LOOKS, ROLLING, SLOW, SPINNING, principal_frame
from kit1000.sim.world import GRAVITY, RATE, World
from kit1000.values import Assembly, Kit, Part

SPEED = 0.1  # [m/s] of the hand
STIFFNESS = 120.0  # [rad/s] the natural frequency of part and hand: half a radian a step, which is still steady
FORCE, TORQUE = 5.0, 0.05  # [N], [N m] that the hand never exceeds: 5 N at an arm of 10 mm
HELD_UP = 5e-3  # [m] behind where it should be, at which the hand gives up
CATCH_UP = 24  # steps that the hand waits at the end of its way
LONGEST = 1.5  # [s] that a part may take to come to rest
UPSET = np.radians(20)  # a part that turns farther after it is let go has tipped
ALIGNED = np.radians(10)  # a seated part is this near to a goal
SLACK = 1e-3  # [m] that a seated part may be aside, beyond what the corner of its clearance lets it
OUTCOMES = ("seated", "jammed", "slid", "askew", "tipped", "left")
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Workpiece:
    """A part as physics has it."""

    pieces: list[np.ndarray]
    """Corners (n, 3) [m] of its convex pieces, about the centre of mass along the principal axes."""
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
    """A convex body that never moves."""

    corners: np.ndarray
    """(n, 3) [m]"""
    world_from_body: Pose


@dataclass(frozen=True, eq=False)
class Insertion:
    """What came of letting a part go."""

    released: Pose
    """world_from_part when the hand let go."""
    rest: Pose
    """world_from_part in the end."""
    held_up: bool
    """Whether the hand gave up before it was there."""
    still: bool
    """Whether the part came to rest in time."""


@dataclass(frozen=True)
class Standing:
    """How a part stands in a slot, measured from that goal which it is nearest to being seated at."""

    outcome: str
    """One of OUTCOMES."""
    height: float
    """[m] of the part's frame above the goal, along the slot's axis."""
    aside: float
    """[m] across the slot's axis."""
    angle: float
    """[rad] from the goal's orientation."""
    turned: float
    """[rad] since the part was let go."""


def obstacles(assembly: Assembly) -> list[Obstacle]:
    """All that stands there: plates as exact prisms that leave the cavities open, brackets and ribs as they are."""
    found = [
        Obstacle(prism.vertices, mount.assembly_from_kit)
        for mount in assembly.mounts
        for prism in convex_prisms(mount.kit)
    ]
    return found + [Obstacle(piece.vertices, Pose.identity()) for piece in stand_meshes(assembly.mounts)]


def insert(piece: Workpiece, standing: Sequence[Obstacle], world_from_part: Pose, axis: np.ndarray) -> Insertion:
    """Try to put a part where a prediction has it, along a unit axis (3,) in the part's frame, and let it go.

    The same arguments give the same bytes.
    """
    goal = world_from_part @ piece.part_from_body
    out = world_from_part.rotate(axis)
    with World() as world:
        world.add_ground()
        for one in standing:
            world.add_hull(one.corners, 0.0, np.zeros(3), one.world_from_body)
        hover = Pose(goal.wxyz, goal.xyz + HOVER * out)
        rolling = {"rollingFriction": ROLLING, "spinningFriction": SPINNING}
        body = world.add_pieces(piece.pieces, piece.mass, piece.moments, hover, **rolling)
        held_up = _lower(world, body, piece, goal, out)
        released = world.pose(body)
        still = _let_go(world, body)
        rest = world.pose(body)
    back = piece.part_from_body.inverse()
    return Insertion(released @ back, rest @ back, held_up, still)


def _lower(world: World, body: int, piece: Workpiece, goal: Pose, out: np.ndarray) -> bool:
    """Move the hand in from HOVER; whether it was held up."""
    steps = round(HOVER / SPEED * RATE)
    now = world.pose(body)
    for step in range(1, steps + CATCH_UP + 1):
        left = HOVER * max(1 - step / steps, 0.0)
        hand = goal.xyz + left * out
        moving, turning = world.velocity(body)
        pull = STIFFNESS**2 * (hand - now.xyz) + 2 * STIFFNESS * (-SPEED * (left > 0) * out - moving)
        force = _limited(piece.mass * pull, FORCE) + piece.mass * GRAVITY * UP  # the hand carries the weight besides
        world.push(body, force, _limited(_torque(piece, now, goal.wxyz, turning), TORQUE))
        world.step()
        now = world.pose(body)
        if (now.xyz - hand) @ out > HELD_UP:
            return True
    return False


def _torque(piece: Workpiece, now: Pose, wxyz: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """(3,) [N m] that turns a part towards an orientation, and slows its turning (3,) [rad/s]."""
    error = Pose(quaternion_multiply(wxyz, quaternion_conjugate(now.wxyz)), np.zeros(3)).rotvec()
    axes = now.rotation_matrix()
    return axes @ (piece.moments * (axes.T @ (STIFFNESS**2 * error - 2 * STIFFNESS * turning)))


def _limited(vector: np.ndarray, most: float) -> np.ndarray:
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-300))


def _let_go(world: World, body: int) -> bool:
    """Step until the part is at rest or time is up; whether it is at rest."""
    quiet = 0
    for _ in range(int(LONGEST * RATE / LOOK_EVERY)):
        world.step(LOOK_EVERY)
        slow = all(speed < limit for speed, limit in zip(world.speeds(body), SLOW, strict=True))
        quiet = quiet + 1 if slow else 0
        if quiet == QUIET_LOOKS:
            return True
    return False


def judged(kit: Kit, kit_from_released: Pose, kit_from_rest: Pose) -> Standing:
    """What became of a part in the frame of its kit: seated, or in which way not."""
    turned = float(quaternion_angle(kit_from_released.wxyz, kit_from_rest.wxyz))
    limits = (min(SEATED_LIMIT, kit.slot.depth / 3), kit.slot.clearance * 2**0.5 + SLACK, float(ALIGNED))
    errors = min((_errors(kit, kit_from_rest, goal) for goal in kit.slot.goals), key=lambda e: _excess(e, limits))
    outcome = "seated" if _excess(errors, limits) <= 1 else _failure(kit, kit_from_rest, errors, limits, turned)
    return Standing(outcome, *errors, turned)


def _errors(kit: Kit, pose: Pose, goal: Pose) -> tuple[float, float, float]:
    """Height [m], distance aside [m] and angle [rad] of a pose from a goal, wherever that may turn to."""
    if kit.slot.free_axis is not None:
        goal = nearest_turn(pose, goal, kit.slot.free_axis)
    x, y, z = pose.xyz - goal.xyz
    return float(z), float(np.hypot(x, y)), float(quaternion_angle(pose.wxyz, goal.wxyz))


def _excess(errors: tuple[float, float, float], limits: tuple[float, float, float]) -> float:
    """The largest error as a share of its limit."""
    return max(abs(error) / limit for error, limit in zip(errors, limits, strict=True))


def _failure(
    kit: Kit,
    pose: Pose,
    errors: tuple[float, float, float],
    limits: tuple[float, float, float],
    turned: float,
) -> str:
    """In which way a part is not seated, the gravest first."""
    height, aside, _ = errors
    if (np.abs(pose.xyz[:2]) > kit.extent[:2] / 2).any() or pose.xyz[2] < -kit.extent[2]:
        return "left"
    if turned > UPSET:
        return "tipped"
    if abs(height) > limits[0]:
        return "jammed"
    return "slid" if aside > limits[1] else "askew"
