"""Plans of a pick and a place: where the hand turns, which branch the arm takes, and the way in between.

A tool position leaves one turn about the cup's axis and eight branches open, at pick and at place. The pairs are tried
in the order of how far the joints move; lines that some pair needs are tested once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

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

YAWS = 12  # turns of the hand that are tried
APPROACH = 0.1  # [m] above the part, where the straight way down begins
TOUCHING = 2  # samples at the end of the way down at which the cup may touch the part
DIRECT_TRIES = 48  # pairs whose joint moves are tried straight
TREE_TRIES = 3  # pairs that are tried with trees afterwards
KITS = "the kits"
DOWN = Pose.from_rotvec((np.pi, 0.0, 0.0))  # the tool's z axis points down


@dataclass(frozen=True, eq=False)
class Task:
    """A part to pick and to place."""

    name: str
    """Of the part as an obstacle of the cell."""
    touch: np.ndarray
    """(3,) [m] world: where the cup touches it."""
    world_from_part: Pose
    goal_from_now: Pose
    """The motion of the part in the world."""
    others: frozenset[str]
    """Names of the other parts."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A collision-free way to pick a part and to place it."""

    reach: list[Leg]
    """From the start to the pick."""
    carry: list[Leg]
    """From the pick to the hover pose, and straight in."""
    leave: list[Leg]
    """Back out to the hover pose."""
    tool_from_part: Pose


@dataclass(frozen=True)
class Refusal:
    """Why there is no plan."""

    outcome: str
    """unreachable or collision"""
    detail: str


@dataclass(eq=False)
class _Lines:
    """The straight lines of a task by yaw: joints (8, n, 6) each, and what the tests of them found."""

    pick: list[np.ndarray]
    place: list[np.ndarray]
    found: dict[tuple[str, int, int], Contact | None] = field(default_factory=dict)


def plan(cell: Cell, start: np.ndarray, task: Task, rng: np.random.Generator) -> Plan | Refusal:
    """The plan of a task from joints `start` (6,), or why there is none. The part must be an obstacle of the cell."""
    picks = _pick_poses(task.touch)
    places = task.goal_from_now @ picks
    lines = _Lines(
        [_line(cell, pick, APPROACH * UP) for pick in picks],
        [_line(cell, place, HOVER * task.goal_from_now.rotate(UP)) for place in places],
    )
    for lines_of, what in ((lines.pick, "the part"), (lines.place, "the slot")):
        if not any(is_reachable(joints).any() for joints in lines_of):
            return Refusal("unreachable", f"no joints reach {what}")
    tool_from_part = [pick.inverse() @ task.world_from_part for pick in picks]
    blocked: list[str] = []
    ready = []
    for yaw, pick, place in _ranked_pairs(lines, start):
        held = Held(task.name, tool_from_part[yaw])
        what = _line_contact(cell, lines, task, held, yaw, pick, place)
        if what is not None:
            blocked.append(what)
            continue
        reach = turned_near(lines.pick[yaw][pick], start)
        carry = None if reach is None else turned_near(lines.place[yaw][place], reach[0])
        if reach is None or carry is None:
            continue
        ready.append((held, reach, carry))
        if len(ready) == DIRECT_TRIES:
            break
    for held, reach, carry in ready:
        corners = [np.stack([start, reach[0]]), np.stack([reach[0], carry[0]])]
        what = _moves_contact(cell, task, held, corners)
        if what is None:
            return _to_plan(corners, reach, carry, held)
        blocked.append(what)
    for held, reach, carry in ready[:TREE_TRIES]:
        found = _find_moves(cell, task, held, start, reach, carry, rng)
        if found is not None:
            return _to_plan(found, reach, carry, held)
    what = max(sorted(set(blocked)), key=blocked.count) if blocked else "the limits of its joints"
    return Refusal("collision", f"every way is blocked, mostly by {what}")


def _pick_poses(touch: np.ndarray) -> Pose:
    """(YAWS,) world_from_tool with the cup on a point (3,) [m], pointing down."""
    turns = Pose.from_rotvec(np.outer(2 * np.pi * np.arange(YAWS) / YAWS, UP)) @ DOWN
    return Pose(turns.wxyz, touch)


def _line(cell: Cell, world_from_tool: Pose, offset: np.ndarray) -> np.ndarray:
    """(8, n, 6) joints of the line that ends at a pose and starts at an offset (3,) [m] from it."""
    start = Pose(world_from_tool.wxyz, world_from_tool.xyz + offset)
    return line_joints(cell.world_from_base.inverse() @ line_poses(start, world_from_tool))


def _ranked_pairs(lines: _Lines, start: np.ndarray) -> list[tuple[int, int, int]]:
    """(yaw, branch at pick, branch at place) of reachable lines, those that move the joints least first."""
    ranked = []
    for yaw in range(YAWS):
        picks, places = lines.pick[yaw], lines.place[yaw]
        branches = np.flatnonzero(is_reachable(picks)), np.flatnonzero(is_reachable(places))
        for pick, place in product(*map(np.ndarray.tolist, branches)):
            move = _turn(places[place, 0] - picks[pick, 0]) + 0.5 * _turn(picks[pick, 0] - start)
            ranked.append((round(move, 6), yaw, pick, place))
    return [entry[1:] for entry in sorted(ranked)]


def _turn(change: np.ndarray) -> float:
    """[rad] the largest change of a joint (6,), by the shorter way round."""
    return float(np.abs(change - 2 * np.pi * np.rint(change / (2 * np.pi))).max())


def _line_contact(cell: Cell, lines: _Lines, task: Task, held: Held, yaw: int, pick: int, place: int) -> str | None:
    """What blocks the straight lines of a pair; each line is tested once."""
    for kind, branch in (("pick", pick), ("place", place)):
        key = (kind, yaw, branch)
        if key not in lines.found:
            test = _pick_contact if kind == "pick" else _place_contact
            lines.found[key] = test(cell, getattr(lines, kind)[yaw][branch], task, held)
        found = lines.found[key]
        if found is not None:
            return found.what
    return None


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
    cell: Cell,
    task: Task,
    held: Held,
    start: np.ndarray,
    reach: np.ndarray,
    carry: np.ndarray,
    rng: np.random.Generator,
) -> list[np.ndarray] | None:
    """Corners of both joint moves, found by trees; None where one is not found."""
    empty = find_path(start, reach[0], lambda joints: cell.contact(joints) is None, rng)
    if empty is None:
        return None
    with _in_hand(cell, task):
        laden = find_path(reach[0], carry[0], lambda joints: cell.contact(joints, held) is None, rng)
    return None if laden is None else [empty, laden]


class _in_hand:
    """Takes a part out of the scene, where the hand has it, during a `with` block."""

    def __init__(self, cell: Cell, task: Task) -> None:
        self.cell, self.task = cell, task

    def __enter__(self) -> None:
        self.cell.move(self.task.name, None)

    def __exit__(self, *_: object) -> None:
        self.cell.move(self.task.name, self.task.world_from_part)


def _to_plan(corners: list[np.ndarray], reach: np.ndarray, carry: np.ndarray, held: Held) -> Plan:
    return Plan(
        [*move_legs("reach", corners[0]), line_leg("lower", reach, APPROACH)],
        [
            line_leg("lift", reach[::-1], APPROACH),
            *move_legs("carry", corners[1]),
            line_leg("insert", carry, HOVER),
        ],
        [line_leg("leave", carry[::-1], HOVER)],
        held.tool_from_part,
    )
