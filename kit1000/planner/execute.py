"""Execution of predicted motions in a scene: pick, lift, hover, straight in, let go; one outcome a part.

The robot grasps by what the depth image shows and moves as the predictions say. What happens is decided by true shapes:
whether the cup seals, whether a path collides, and, by rigid-body physics (`kit1000.sim.insertion`), where the part
comes to rest. Parts that others block are tried again after these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from kit1000.dataset.reader import RecordedScene
from kit1000.kits.convex_pieces import enclosing_prisms
from kit1000.kits.seating import HOVER, UP
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.planner.collision import Cell
from kit1000.planner.grasp import Grasp, find_grasps, is_held, touch
from kit1000.planner.motion import LINE_ACCELERATION, LINE_SPEED, Leg, arrival_times
from kit1000.planner.planning import APPROACH, COLLISION, KITS, UNREACHABLE, Plan, Refusal, Task, plan
from kit1000.planner.robot import HOME
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.insertion import InsertionTrial, Obstacle, Workpiece, assembly_obstacles, classify_outcome, insert
from kit1000.sim.world import GRAVITY
from kit1000.values import Assembly, LabelledDepth, Mount, Part

SEATED, NOT_FROM_ABOVE, NO_SEAL = "seated", "not graspable from above", "no seal"
JAMMED, TIPPED, NOT_SEATED = "jammed", "tipped", "not seated"
OUTCOMES = (SEATED, NOT_FROM_ABOVE, NO_SEAL, UNREACHABLE, COLLISION, JAMMED, TIPPED, NOT_SEATED)
# [m] of the robot's base in the world. From there all picks and 99 % of the places are in reach, whatever the scale of
# the table (kinematics alone, 120 random poses each, slots tilted by up to 45 degrees).
BASE = np.array([-0.45, 0.0, 0.20])
MAX_TURN = np.radians(60)  # of the cup from the vertical at the goal: slots are tilted by up to 45 degrees
GRIP_SECONDS = 1.0  # [s] until the cup holds; as long until it lets go
MAX_PLANS = 3  # grasps for which a way is searched
TOLERANCE = 1e-3  # [m] of the shapes of lying parts, in tests for collisions
FINE_TOLERANCE = 0.4e-3  # [m] the same of the inserted part, as that of the plates
FINE_HEIGHT = 25e-3  # [m] of a part that may touch walls: cavities are up to 20 mm deep
NEAR = 0.06  # [m] about the inserted part: bodies farther away cannot matter


@dataclass(frozen=True)
class PartRun:
    """What happened to one part."""

    part: int
    """Index among the parts of the scene."""
    outcome: str
    """One of OUTCOMES."""
    detail: str
    """More on the outcome, for people."""
    seconds: float = 0.0
    """[s] that the robot would take for it, from wherever it was."""
    grasps: int = 0
    """Number of grasps that were tried."""
    physics: Mapping[str, Any] = field(default_factory=dict)
    """Where the part came to rest: height, offset [mm] and angle [degrees] from the goal, and the outcome of the
    insertion in the terms of `kit1000.sim.insertion`. Empty if it was not picked."""


@dataclass(frozen=True, eq=False)
class Event:
    """A piece of a trace: a leg of the arm, or a part that is taken or left."""

    start: float  # [s]
    part: int
    leg: Leg | None = None
    kind: str = ""  # grasp or rest, if there is no leg
    pose: Pose | None = None  # tool_from_part after a grasp, world_from_part at rest


@dataclass(frozen=True, eq=False)
class SceneRun:
    """What happened in a scene."""

    scene_id: str
    parts: tuple[PartRun, ...]  # in the order of the scene's parts
    order: tuple[int, ...]  # the parts that were picked, in this order
    events: tuple[Event, ...]
    world_from_base: Pose


class Bench:
    """A scene before the robot: its bodies and where the parts are now."""

    def __init__(self, scene: RecordedScene, sensor: str, images: Mapping[int, LabelledDepth] | None = None) -> None:
        geometry = scene.split.dataset.geometry
        assembly, *parts = scene.scene.bodies
        self.scene_id = scene.id
        self.image: LabelledDepth = scene.labelled_depth(sensor)
        self.images = images or {}
        self.flatness = simulated_sensor(sensor).kind.flatness
        self.assembly: Assembly = geometry.assembly(assembly.id)
        self.world_from_assembly = assembly.world_from_body
        self.parts: list[Part] = [geometry.part(body.id) for body in parts]
        self.poses: list[Pose] = [body.world_from_body for body in parts]
        self.world_from_base = Pose.from_translation(BASE)
        self.inserted: set[int] = set()

    @property
    def plates(self) -> list[Obstacle]:
        """The convex bodies of the assembly, in its frame."""
        return _plates(self.assembly)

    def mount(self, part: int) -> Mount:
        """The kit in which a part belongs."""
        return next(mount for mount in self.assembly.mounts if mount.kit.slot.part_id == self.parts[part].id)

    def pieces(self, part: int, world_from_part: Pose, tolerance: float, fine_height: float) -> list[np.ndarray]:
        """Convex pieces (n, 3) [m] of a part in its frame, prisms along the vertical at a pose."""
        return _pieces(self.parts[part], tuple(world_from_part.wxyz), tolerance, fine_height)

    def grasps(self, part: int) -> list[Grasp]:
        """Where a cup seems to seal on a part, best first."""
        return find_grasps(self.images.get(part, self.image), part, self.flatness)

    def seal_height(self, part: int, grasp: Grasp) -> float | None:
        """The height [m] at which the cup of a grasp seals on a part and carries it; None if it does not."""
        height = touch(self.parts[part].mesh, self.poses[part], grasp)
        return height if is_held(grasp, self.parts[part].mass * GRAVITY) else None

    def fill(self, cell: Cell) -> None:
        """Add the kits and the parts to a robot's cell."""
        placed = [self.world_from_assembly @ plate.world_from_body for plate in self.plates]
        cell.add(
            KITS, [pose.apply(plate.vertices) for pose, plate in zip(placed, self.plates, strict=True)], Pose.identity()
        )
        for i, pose in enumerate(self.poses):
            cell.add(part_name(i), self.pieces(i, pose, TOLERANCE, np.inf), pose, movable=True)

    def insert(self, part: int, goal_from_now: Pose) -> tuple[InsertionTrial, dict[str, Any]]:
        """Insert a part by physics as predicted; where it is released and rests (world), and how that is called."""
        now, assembly_from_world = self.poses[part], self.world_from_assembly.inverse()
        axis = now.inverse().rotate(UP)
        target = assembly_from_world @ goal_from_now @ now
        workpiece = Workpiece.of(self.parts[part], self.pieces(part, now, FINE_TOLERANCE, FINE_HEIGHT))
        trial = insert(workpiece, self._around(part, target, target.rotate(axis)), target, axis)
        mount = self.mount(part)
        kit_from_assembly = mount.assembly_from_kit.inverse()
        found = classify_outcome(mount.kit, kit_from_assembly @ trial.release_pose, kit_from_assembly @ trial.rest_pose)
        release, rest = self.world_from_assembly @ trial.release_pose, self.world_from_assembly @ trial.rest_pose
        physics = {
            "insertion": found.outcome,
            "blocked": trial.blocked,
            "height_mm": round(found.height * 1e3, 3),
            "offset_mm": round(found.offset * 1e3, 3),
            "angle_deg": round(float(np.degrees(found.angle)), 3),
        }
        return InsertionTrial(release, rest, trial.blocked), physics

    def _around(self, part: int, target: Pose, out: np.ndarray) -> list[Obstacle]:
        """The bodies near the way in of a part to a pose in the assembly's frame, along `out` (3,)."""
        corners = self.parts[part].mesh.bounds
        radius = float(np.linalg.norm(corners, axis=1).max()) + NEAR
        way = np.stack([target.xyz, target.xyz + HOVER * out])
        low, high = way.min(0) - radius, way.max(0) + radius
        seated = [
            Obstacle(piece, self.world_from_assembly.inverse() @ self.poses[i])
            for i in sorted(self.inserted)
            for piece in self.pieces(i, self.poses[i], TOLERANCE, np.inf)
        ]
        return [body for body in [*self.plates, *seated] if _meets_box(body, low, high)]


@lru_cache(maxsize=256)
def _plates(assembly: Assembly) -> list[Obstacle]:
    """Kept, as the pieces are: other motions in the same scene meet the same bodies."""
    return assembly_obstacles(assembly)


@lru_cache(maxsize=1024)
def _pieces(part: Part, wxyz: tuple[float, ...], tolerance: float, fine_height: float) -> list[np.ndarray]:
    rotation = Pose(np.array(wxyz), np.zeros(3))
    prisms = enclosing_prisms(part.mesh.moved(rotation), tolerance, fine_height)
    return [rotation.inverse().apply(prism) for prism in prisms]


def _meets_box(body: Obstacle, low: np.ndarray, high: np.ndarray) -> bool:
    points = body.world_from_body.apply(body.vertices)
    return bool((points.min(0) <= high).all() and (points.max(0) >= low).all())


def part_name(part: int) -> str:
    """The name of a part as an obstacle."""
    return f"part {part}"


def run_scene(
    scene: RecordedScene,
    motions: Mapping[int, Pose],
    sensor: str = "ideal",
    seed: int = 0,
    images: Mapping[int, LabelledDepth] | None = None,
) -> SceneRun:
    """Carry out motions in a scene, which must have been opened with its truth.

    Args:
        scene: a recorded scene.
        motions: goal_from_now by part index; parts without one are left alone.
        sensor: of the depth image by which the robot grasps.
        seed: of the trees of the path planner.
        images: by part index, the image with other masks in which the robot finds the part; the recorded one elsewhere.
    """
    with robot_at(scene, sensor, seed, images) as robot:
        return robot.run(motions)


@contextmanager
def robot_at(
    scene: RecordedScene, sensor: str = "ideal", seed: int = 0, images: Mapping[int, LabelledDepth] | None = None
) -> Iterator[Robot]:
    """A robot before a scene, for motions that come one after another; arguments as those of `run_scene`."""
    bench = Bench(scene, sensor, images)
    with Cell(bench.world_from_base) as cell:
        yield Robot(bench, cell, seed)


class Robot:
    """The robot at work in one scene."""

    def __init__(self, bench: Bench, cell: Cell, seed: int) -> None:
        self.bench, self.cell, self.seed = bench, cell, seed
        self.filled = False
        """Whether kits and parts are in the cell: not before a part is held by a cup, for most of the work is there."""
        self.joints, self.now = HOME, 0.0
        self.events: list[Event] = []
        self.order: list[int] = []

    def run(self, motions: Mapping[int, Pose]) -> SceneRun:
        """Carry out motions of parts not moved before, goal_from_now by part index; the events are those of all calls.

        A part whose way is blocked is tried again after another has been moved.
        """
        runs: dict[int, PartRun] = {}
        waiting = sorted(motions)
        while waiting:
            moved = len(self.order)
            runs |= {part: self._run_part(part, motions[part]) for part in waiting}
            waiting = [part for part in waiting if runs[part].outcome == COLLISION]
            if len(self.order) == moved:
                break
        return SceneRun(
            self.bench.scene_id,
            tuple(runs[part] for part in sorted(runs)),
            tuple(self.order),
            tuple(self.events),
            self.bench.world_from_base,
        )

    def _run_part(self, part: int, motion: Pose) -> PartRun:
        up = motion.rotate(UP)
        if up[2] < np.cos(MAX_TURN):
            tilt = np.degrees(np.arctan2(np.hypot(up[0], up[1]), up[2]))
            return PartRun(part, NOT_FROM_ABOVE, f"at the goal its upper side would be tilted by {tilt:.0f} degrees")
        tried, seconds, refusals = 0, 0.0, []
        for grasp in self.bench.grasps(part):
            tried += 1
            height = self.bench.seal_height(part, grasp)
            if height is None:
                seconds += 2 * _line_seconds(APPROACH) + GRIP_SECONDS
                continue
            found = self._plan(part, motion, grasp, height, tried)
            if isinstance(found, Plan):
                return self._carry_out(part, motion, found, tried, seconds)
            refusals.append(found)
            if len(refusals) == MAX_PLANS:
                break
        if refusals:
            return PartRun(part, refusals[0].outcome, refusals[0].detail, seconds, tried)
        why = "no flat, level spot is seen" if tried == 0 else f"no cup holds at any of {tried} spots"
        return PartRun(part, NO_SEAL, why, seconds, tried)

    def _plan(self, part: int, motion: Pose, grasp: Grasp, height: float, number: int) -> Plan | Refusal:
        """A way for a grasp whose cup seals at a height [m]. number: of the grasp, for the stream of the planner."""
        if not self.filled:
            self.bench.fill(self.cell)
            self.filled = True
        self.cell.cup = grasp.cup
        task = Task(
            part_name(part),
            np.array([*grasp.point[:2], height]),
            self.bench.poses[part],
            motion,
            frozenset(part_name(i) for i in range(len(self.bench.parts)) if i != part),
        )
        return plan(self.cell, self.joints, task, stream(self.seed, "plan", self.bench.scene_id, part, number))

    def _carry_out(self, part: int, motion: Pose, found: Plan, tried: int, seconds: float) -> PartRun:
        before = self.now
        self.now += seconds
        self._move(part, found.reach)
        self.now += GRIP_SECONDS
        self.events.append(Event(self.now, part, kind="grasp", pose=found.tool_from_part))
        self._move(part, found.carry)
        trial, physics = self.bench.insert(part, motion)
        self.now += GRIP_SECONDS
        self.events.append(Event(self.now, part, kind="rest", pose=trial.rest_pose))
        self._move(part, found.leave)
        self.bench.poses[part] = trial.rest_pose
        self.bench.inserted.add(part)
        self.cell.move(part_name(part), trial.rest_pose)
        self.order.append(part)
        outcome, detail = _outcome_of(physics)
        return PartRun(part, outcome, detail, round(self.now - before, 3), tried, physics)

    def _move(self, part: int, legs: Sequence[Leg]) -> None:
        for leg in legs:
            self.events.append(Event(self.now, part, leg))
            self.now += leg.duration
            self.joints = leg.joints[-1]


def _line_seconds(distance: float) -> float:
    """[s] that a straight line takes."""
    return float(arrival_times(np.array([distance]), distance, LINE_SPEED, LINE_ACCELERATION)[0])


def _outcome_of(physics: Mapping[str, Any]) -> tuple[str, str]:
    """The outcome of an insertion and its detail."""
    where = "{height_mm:.1f} mm high, {offset_mm:.1f} mm aside, {angle_deg:.1f} degrees".format(**physics)
    found = physics["insertion"]
    outcome = found if found in (SEATED, JAMMED, TIPPED) else NOT_SEATED
    words = {"left": "it lies beside its plate", "slid": "it slid aside", "askew": "it lies askew"}
    return outcome, f"{words[found]}, {where}" if found in words else where
