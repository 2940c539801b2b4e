"""Plans of a pick and a place: the yaw of the hand, which branch the arm takes, and the way in between.

A tool position leaves one rotation about the cup's axis and eight branches open, at pick and at place. Pairs of lines,
to the part and to the slot, are tried in the order of how far the joints move; each line is tested once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice, product
from typing import NamedTuple

import numpy as np

from kit1000.kits.seating import HOVER, UP
from kit1000.planner.collision import TABLE, Cell, Contact, Held
from kit1000.planner.motion import (
    Leg,
    find_path,
    is_reachable,
    line_joints,
    line_leg,
    line_poses,
    move_joints,
    move_legs,
    turned_near,
)
from kit1000.pose import Pose

YAWS = 12  # of the hand that are tried
APPROACH = 0.1  # [m] above the part, where the straight way down begins
TOUCHING = 2  # samples at the end of the way down at which the cup may touch the part
DIRECT_TRIES = 48  # pairs whose joint moves are tried straight
TREE_TRIES = 3  # pairs that are tried with trees afterwards
KITS = "the kits"
UNREACHABLE, COLLISION = "unreachable", "collision"
DOWN = Pose.from_rotvec((np.pi, 0.0, 0.0))  # the tool's z axis points down


@dataclass(frozen=True, eq=False)
class Task:
    """A part to pick and to place."""

    name: str  # name of the part as an obstacle of the cell
    touch: np.ndarray  # (3,) [m] world: where the cup touches it
    world_from_part: Pose
    goal_from_now: Pose  # the motion of the part in the world
    others: frozenset[str]  # names of the other parts


@dataclass(frozen=True, eq=False)
class Plan:
    """A collision-free way to pick a part and to place it."""

    reach: list[Leg]  # from the start to the pick
    carry: list[Leg]  # from the pick to the hover pose, and straight in
    leave: list[Leg]  # back out to the hover pose
    tool_from_part: Pose


@dataclass(frozen=True)
class Refusal:
    """Why there is no plan."""

    outcome: str  # UNREACHABLE or COLLISION
    detail: str


@dataclass(eq=False)
class _Lines:
    """The straight lines to the part, or to the slot, for all yaws of the hand."""

    joints: list[np.ndarray]  # (8, n, 6) [rad] by yaw, as of `line_joints`
    contact: Callable[[np.ndarray, Held], Contact | None]  # tests the joints (n, 6) of one branch
    found: dict[tuple[int, int], Contact | None] = field(default_factory=dict)  # what the tests gave, by yaw and branch

    def blocked_by(self, yaw: int, branch: int, held: Held) -> str | None:
        """What blocks a line, or None; each line is tested once."""
        if (yaw, branch) not in self.found:
            self.found[yaw, branch] = self.contact(self.joints[yaw][branch], held)
        contact = self.found[yaw, branch]
        return None if contact is None else contact.what


class _Pair(NamedTuple):
    """Lines to the part and to the slot that the arm can follow one after the other: joints (n, 6) [rad] each."""

    held: Held
    reach: np.ndarray
    carry: np.ndarray


def plan(cell: Cell, start: np.ndarray, task: Task, rng: np.random.Generator) -> Plan | Refusal:
    """The plan of a task from joints `start` (6,), or why there is none. The part must be an obstacle of the cell."""
    picks = _pick_poses(task.touch)
    places = task.goal_from_now @ picks
    to_part = _Lines(
        [_line(cell, pick, APPROACH * UP) for pick in picks],
        lambda joints, held: _pick_contact(cell, joints, task, held),
    )
    to_slot = _Lines(
        [_line(cell, place, HOVER * task.goal_from_now.rotate(UP)) for place in places],
        lambda joints, held: _place_contact(cell, joints, task, held),
    )
    for lines, what in ((to_part, "the part"), (to_slot, "the slot")):
        if not any(is_reachable(joints).any() for joints in lines.joints):
            return Refusal(UNREACHABLE, f"no joints reach {what}")
    held = [Held(task.name, pick.inverse() @ task.world_from_part) for pick in picks]
    pairs: list[_Pair] = []
    blocked: list[str] = []
    for pair in islice(_free_pairs(to_part, to_slot, held, start, blocked), DIRECT_TRIES):
        pairs.append(pair)
        corners = [np.stack([start, pair.reach[0]]), np.stack([pair.reach[0], pair.carry[0]])]
        what = _moves_contact(cell, task, pair.held, corners)
        if what is None:
            return _to_plan(corners, pair)
        blocked.append(what)
    for pair in pairs[:TREE_TRIES]:
        found = _find_moves(cell, task, pair, start, rng)
        if found is not None:
            return _to_plan(found, pair)
    what = max(sorted(set(blocked)), key=blocked.count) if blocked else "the limits of its joints"
    return Refusal(COLLISION, f"every way is blocked, mostly by {what}")


def _pick_poses(touch: np.ndarray) -> Pose:
    """(YAWS,) world_from_tool with the cup on a point (3,) [m], pointing down."""
    rotations = Pose.from_rotvec(np.outer(2 * np.pi * np.arange(YAWS) / YAWS, UP)) @ DOWN
    return Pose(rotations.wxyz, touch)


def _line(cell: Cell, world_from_tool: Pose, offset: np.ndarray) -> np.ndarray:
    """(8, n, 6) joints of the line that ends at a pose and starts at an offset (3,) [m] from it."""
    start = Pose(world_from_tool.wxyz, world_from_tool.xyz + offset)
    return line_joints(cell.world_from_base.inverse() @ line_poses(start, world_from_tool))


def _free_pairs(
    to_part: _Lines, to_slot: _Lines, held: list[Held], start: np.ndarray, blocked: list[str]
) -> Iterator[_Pair]:
    """The pairs of lines that are free; what blocks the others is added to `blocked`. held: by yaw."""
    for yaw, pick, place in _ranked_branches(to_part, to_slot, start):
        what = to_part.blocked_by(yaw, pick, held[yaw]) or to_slot.blocked_by(yaw, place, held[yaw])
        if what is not None:
            blocked.append(what)
            continue
        reach = turned_near(to_part.joints[yaw][pick], start)
        carry = None if reach is None else turned_near(to_slot.joints[yaw][place], reach[0])
        if reach is not None and carry is not None:
            yield _Pair(held[yaw], reach, carry)


def _ranked_branches(to_part: _Lines, to_slot: _Lines, start: np.ndarray) -> list[tuple[int, int, int]]:
    """(yaw, branch to the part, branch to the slot) of reachable lines, those that move the joints least first."""
    ranked = []
    for yaw in range(YAWS):
        picks, places = to_part.joints[yaw], to_slot.joints[yaw]
        branches = np.flatnonzero(is_reachable(picks)), np.flatnonzero(is_reachable(places))
        for pick, place in product(*map(np.ndarray.tolist, branches)):
            move = _turn(places[place, 0] - picks[pick, 0]) + 0.5 * _turn(picks[pick, 0] - start)
            ranked.append((round(move, 6), yaw, pick, place))
    return [entry[1:] for entry in sorted(ranked)]


def _turn(change: np.ndarray) -> float:
    """[rad] the largest change of a joint (6,), by the shorter way round."""
    return float(np.abs(change - 2 * np.pi * np.rint(change / (2 * np.pi))).max())


def _pick_contact(cell: Cell, joints: np.ndarray, task: Task, held: Held) -> Contact | None:
    """The first collision down to the part and up again with it, on joints (n, 6) from above."""
    down = cell.contact(joints[:-TOUCHING]) or cell.contact(joints[-TOUCHING:], spare={task.name})
    if down is not None:
        return down
    with _in_hand(cell, task):
        return cell.contact(joints[::-1], held._replace(spare=task.others | {TABLE}))


def _place_contact(cell: Cell, joints: np.ndarray, task: Task, held: Held) -> Contact | None:
    """The first collision of the arm on the straight way in; whether the part goes in is for physics to say."""
    with _in_hand(cell, task):
        return cell.contact(joints[:1], held) or cell.contact(joints, held._replace(spare=task.others | {TABLE, KITS}))


def _moves_contact(cell: Cell, task: Task, held: Held, corners: list[np.ndarray]) -> str | None:
    """What blocks two joint moves, the first with an empty hand."""
    found = cell.contact(move_joints(*corners[0]))
    if found is None:
        with _in_hand(cell, task):
            found = cell.contact(move_joints(*corners[1]), held)
    return None if found is None else found.what


def _find_moves(
    cell: Cell, task: Task, pair: _Pair, start: np.ndarray, rng: np.random.Generator
) -> list[np.ndarray] | None:
    """Corners of both joint moves, found by trees; None if one is not found."""
    above, hover = pair.reach[0], pair.carry[0]
    empty = find_path(start, above, lambda joints: cell.contact(joints) is None, rng)
    if empty is None:
        return None
    with _in_hand(cell, task):
        laden = find_path(above, hover, lambda joints: cell.contact(joints, pair.held) is None, rng)
    return None if laden is None else [empty, laden]


@contextmanager
def _in_hand(cell: Cell, task: Task) -> Iterator[None]:
    """Takes a part out of the scene, where the hand has it, during a `with` block."""
    cell.move(task.name, None)
    try:
        yield
    finally:
        cell.move(task.name, task.world_from_part)


def _to_plan(corners: list[np.ndarray], pair: _Pair) -> Plan:
    return Plan(
        [*move_legs("reach", corners[0]), line_leg("lower", pair.reach, APPROACH)],
        [
            line_leg("lift", pair.reach[::-1], APPROACH),
            *move_legs("carry", corners[1]),
            line_leg("insert", pair.carry, HOVER),
        ],
        [line_leg("leave", pair.carry[::-1], HOVER)],
        pair.held.tool_from_part,
    )
