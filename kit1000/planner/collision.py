"""Collisions of the arm and of the part in its hand with everything around them, for many joint positions at once.

The arm is capsules, parts and plates are convex pieces (pybullet), the table and the column under the base are closed
form. ROOM is kept to everything; where parts may touch, as at pick and slot, the caller names what is spared.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from types import TracebackType
from typing import NamedTuple

import numpy as np

from kit1000.planner import robot
from kit1000.pose import Pose
from kit1000.sim.world import World

ROOM = 2e-3  # [m] that every path keeps between what moves and what does not
SELF_PAIRS = tuple((a, b) for a, first in enumerate((4, 4, 5, 6, 7)) for b in range(first, len(robot.ARM) + 1))
"""Capsules of the arm that can meet: neighbours of neighbours cannot within the limits of the joints."""
COLUMN_RADIUS = 0.075  # [m] of the column from the table to the base
TABLE, COLUMN, SELF = "the table", "its column", "itself"
FAR = np.array([0.0, 0.0, -10.0])  # [m] where cups and held parts wait that are not in use
FARTHER = np.array([10.0, 0.0, -10.0])  # [m] the same of obstacles: there they touch none of these
MOVING, FIXED = 1, 2  # collision groups


class Contact(NamedTuple):
    """The first collision of a path."""

    sample: int  # index of the joint position
    what: str  # name of the obstacle


class Held(NamedTuple):
    """A part in the hand."""

    name: str
    tool_from_part: Pose
    spare: frozenset[str] = frozenset()  # obstacles that it may touch; also TABLE


class Cell:
    """The robot's surroundings: obstacles by name, each of convex pieces, some of which the hand can hold."""

    def __init__(self, world_from_base: Pose) -> None:
        self.world_from_base = world_from_base
        self.cup = robot.CUPS[0]
        """[m] radius of the cup at the nozzle's end."""
        self._world = World()
        self._obstacles: dict[int, str] = {}
        self._bodies: dict[str, int] = {}
        self._pieces: dict[str, np.ndarray] = {}
        self._hands: dict[str, int] = {}

    def __enter__(self) -> Cell:
        self._world.__enter__()
        self._arm = [self._add_capsule(capsule) for capsule in robot.ARM]
        self._nozzles = {cup: self._add_capsule(robot.shape(cup)[-1]) for cup in robot.CUPS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._world.__exit__(kind, error, trace)

    def add(self, name: str, pieces: Sequence[np.ndarray], world_from_body: Pose, movable: bool = False) -> None:
        """Add a fixed obstacle of convex pieces, each (n, 3) [m] in its frame; a movable one can be held too."""
        body = self._world.add_pieces(pieces, 0.0, np.zeros(3), world_from_body)
        self._filter(body, FIXED)
        self._bodies[name], self._obstacles[body] = body, name
        self._pieces[name] = np.concatenate(pieces)
        if movable:
            self._hands[name] = self._world.add_pieces(pieces, 1.0, np.ones(3), Pose.from_translation(FAR))
            self._filter(self._hands[name], MOVING)

    def move(self, name: str, world_from_body: Pose | None) -> None:
        """Put an obstacle elsewhere; None takes it out of the scene."""
        self._place(self._bodies[name], Pose.from_translation(FARTHER) if world_from_body is None else world_from_body)

    def contact(self, joints: np.ndarray, held: Held | None = None, spare: Collection[str] = ()) -> Contact | None:
        """The first collision along joint positions (n, 6) [rad], or None.

        Args:
            joints: in the order of the path; the caller samples it finely enough.
            held: the part in the hand, which must not be in the scene as an obstacle.
            spare: obstacles that the arm may touch.
        """
        ends = robot.capsule_ends(joints, self.cup)
        closed = _closed_form_contact(ends, self.cup, self.world_from_base)
        for nozzle in self._nozzles.values():
            self._place(nozzle, Pose.from_translation(FAR))
        world_from_held = None
        if held is not None:
            world_from_held = self.world_from_base @ robot.tool_pose(joints) @ held.tool_from_part
            if TABLE not in held.spare:
                lowest = world_from_held[:, None].apply(self._pieces[held.name])[..., 2].min(1)
                closed = _first(closed, lowest < ROOM, TABLE)
        last = len(joints) if closed is None else closed.sample
        capsules = _capsule_poses(ends, self.world_from_base)
        hand = None if held is None else self._hands[held.name]
        try:
            for sample in range(last):
                if hand is not None and world_from_held is not None:
                    self._place(hand, world_from_held[sample])
                what = self._contact_of(capsules[sample], hand, spare, frozenset() if held is None else held.spare)
                if what is not None:
                    return Contact(sample, what)
        finally:
            if hand is not None:
                self._place(hand, Pose.from_translation(FAR))
        return closed

    def _contact_of(
        self, capsules: np.ndarray, hand: int | None, spare: Collection[str], held_spare: Collection[str]
    ) -> str | None:
        """What the arm, at capsules (k, 7), or the hand's part touches."""
        bullet, client = self._world.engine, self._world.client
        for body, row in zip((*self._arm, self._nozzles[self.cup]), capsules.tolist(), strict=True):
            bullet.resetBasePositionAndOrientation(body, row[:3], row[3:], physicsClientId=client)
        bullet.performCollisionDetection(physicsClientId=client)
        for point in bullet.getContactPoints(physicsClientId=client):
            name = self._obstacles.get(point[1]) or self._obstacles.get(point[2])
            spared = held_spare if hand in point[1:3] else spare
            if name is not None and name not in spared and point[8] < ROOM:
                return name
        return None

    def _add_capsule(self, capsule: robot.Capsule) -> int:
        bullet, client = self._world.engine, self._world.client
        long = float(np.linalg.norm(np.subtract(capsule.end, capsule.start)))
        shape = bullet.createCollisionShape(
            bullet.GEOM_CAPSULE, radius=capsule.radius, height=long, physicsClientId=client
        )
        body = bullet.createMultiBody(1.0, shape, -1, FAR.tolist(), physicsClientId=client)
        self._filter(body, MOVING)
        return body

    def _filter(self, body: int, group: int) -> None:
        """Let what moves meet what is fixed, and nothing else."""
        other = FIXED if group == MOVING else MOVING
        self._world.engine.setCollisionFilterGroupMask(body, -1, group, other, physicsClientId=self._world.client)

    def _place(self, body: int, pose: Pose) -> None:
        bullet, client = self._world.engine, self._world.client
        bullet.resetBasePositionAndOrientation(
            body, pose.xyz.tolist(), np.roll(pose.wxyz, -1).tolist(), physicsClientId=client
        )


def _capsule_poses(ends: np.ndarray, world_from_base: Pose) -> np.ndarray:
    """(n, capsules, 7) the middles [m] and quaternions xyzw of capsules whose own axis is z, in the world."""
    start, end = world_from_base.apply(ends[..., 0, :]), world_from_base.apply(ends[..., 1, :])
    axis = end - start
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    # the half-way quaternion from z to the axis; opposite to z any half turn about a level axis
    w = 1 + axis[..., 2]
    quaternion = np.stack([-axis[..., 1], axis[..., 0], np.zeros_like(w), w], axis=-1)
    quaternion[w < 1e-9] = (1.0, 0.0, 0.0, 0.0)
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.concatenate([(start + end) / 2, quaternion], axis=-1)


def _closed_form_contact(ends: np.ndarray, cup: float, world_from_base: Pose) -> Contact | None:
    """The first collision of capsules (n, capsules, 2, 3) [m] with the table, the column and each other."""
    arm = robot.shape(cup)
    radii = np.array([capsule.radius for capsule in arm])
    moving = [i for i, capsule in enumerate(arm) if capsule.link > 0]
    height = world_from_base.apply(ends)[..., 2].min(-1) - radii
    rooms = np.full(len(arm), ROOM)
    rooms[-1] = 0.0  # the cup itself goes down to parts as flat as a millimetre
    contact = _first(None, (height < rooms)[:, moving].any(1), TABLE)
    base = world_from_base.xyz
    column = np.array([[0, 0, -base[2]], [0, 0, 0]])
    far = [i for i in moving if arm[i].link > 2]
    gaps = [segment_distance(ends[:, i], np.broadcast_to(column, ends[:, i].shape)) - radii[i] for i in far]
    contact = _first(contact, np.min(gaps, 0) < COLUMN_RADIUS + ROOM, COLUMN)
    pairs = np.array(SELF_PAIRS)
    gap = segment_distance(ends[:, pairs[:, 0]], ends[:, pairs[:, 1]]) - radii[pairs].sum(1)
    return _first(contact, (gap < ROOM).any(1), SELF)


def _first(before: Contact | None, blocked: np.ndarray, what: str) -> Contact | None:
    """The earlier of a contact and the first of blocked samples (n,) bool."""
    if not blocked.any():
        return before
    sample = int(np.argmax(blocked))
    return Contact(sample, what) if before is None or sample < before.sample else before


def segment_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(...,) [m] the smallest distance between segments (..., 2, 3) (Ericson, Real-Time Collision Detection, 5.1)."""
    p, q = a[..., 0, :], b[..., 0, :]
    u, v, w = a[..., 1, :] - p, b[..., 1, :] - q, p - q
    uu, vv, uv = (np.einsum("...i,...i->...", x, y) for x, y in ((u, u), (v, v), (u, v)))
    uw, vw = np.einsum("...i,...i->...", u, w), np.einsum("...i,...i->...", v, w)
    uu, vv = np.maximum(uu, 1e-18), np.maximum(vv, 1e-18)
    area = uu * vv - uv * uv
    s = np.where(area > 1e-12 * uu * vv, np.clip((uv * vw - uw * vv) / np.maximum(area, 1e-30), 0, 1), 0.0)
    t = np.clip((uv * s + vw) / vv, 0, 1)
    s = np.clip((uv * t - uw) / uu, 0, 1)
    return np.sqrt((((p + s[..., None] * u) - (q + t[..., None] * v)) ** 2).sum(-1))
