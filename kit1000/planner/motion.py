"""Motions of the arm: straight lines of the tool, joint moves, paths around obstacles, and how long they take.

A line is inverse kinematics every LINE_SPACING on one branch. A joint move is a straight line in joint space; where it
is blocked, RRT-connect (Kuffner and LaValle 2000) with a seeded stream finds a way, which shortcuts then straighten.
Speeds and accelerations are those of the paper's release, in trapezoids; each leg starts and ends at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kit1000.numerics.linear_algebra import length
from kit1000.planner.robot import JOINT_LIMITS, inverse, within_limits
from kit1000.pose import Pose

LINE_SPEED, LINE_ACCELERATION = 0.1, 0.1  # [m/s], [m/s^2]
MOVE_SPEED, MOVE_ACCELERATION = 0.3, 0.3  # [rad/s], [rad/s^2] of the joint that moves farthest
LINE_SPACING = 2e-3  # [m]
LINE_STEP = 0.06  # [rad] of a joint in LINE_SPACING: 3 rad/s at LINE_SPEED, just under the robot's limit
MOVE_SPACING = 0.015  # [rad] of the joint that moves farthest, between positions that are tested
TREE_STEP = 0.3  # [rad] of a tree's branch
MAX_NODES = 2000  # of both trees
SHORTCUTS = 50
MARGIN = 1.0  # [rad] by which a tree's samples exceed the box of start and end

IsFree = Callable[[np.ndarray], bool]
"""Whether joint positions (n, 6) [rad] are all free of collisions."""


@dataclass(frozen=True, eq=False)
class Leg:
    """A piece of a trajectory, from rest to rest."""

    name: str
    joints: np.ndarray  # (n, 6) [rad]
    seconds: np.ndarray  # (n,) [s] since its start

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.seconds[-1])


def line_poses(start: Pose, end: Pose) -> Pose:
    """(n,) poses every LINE_SPACING from start to end, which have one orientation."""
    n = max(int(np.ceil(length(end.xyz - start.xyz) / LINE_SPACING)), 1)
    share = np.linspace(0, 1, n + 1)[:, None]
    return Pose(start.wxyz, start.xyz * (1 - share) + end.xyz * share)


def line_joints(base_from_tool: Pose) -> np.ndarray:
    """(8, n, 6) [rad] joints along a line of poses (n,), by branch; NaN throughout if a branch cannot follow it."""
    joints = np.unwrap(np.moveaxis(inverse(base_from_tool), 1, 0), axis=1)
    followed = np.isfinite(joints).all((1, 2)) & (np.abs(np.diff(joints, axis=1)).max((1, 2), initial=0) <= LINE_STEP)
    joints[~followed] = np.nan
    return joints


def turned_near(joints: np.ndarray, reference: np.ndarray) -> np.ndarray | None:
    """A line's joints (n, 6) by whole turns so that it starts nearest to a reference (6,), all within the limits.

    None if no turns keep it within them.
    """
    turns = 2 * np.pi * np.arange(-2, 3)
    low, high = joints.min(0), joints.max(0)
    allowed = (low + turns[:, None] >= -JOINT_LIMITS) & (high + turns[:, None] <= JOINT_LIMITS)
    if not allowed.any(0).all():
        return None
    distance = np.where(allowed, np.abs(joints[0] + turns[:, None] - reference), np.inf)
    return joints + turns[distance.argmin(0)]


def move_joints(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(n, 6) [rad] from start to end, no joint moving more than MOVE_SPACING between two of them."""
    n = max(int(np.ceil(np.abs(end - start).max() / MOVE_SPACING)), 1)
    return start + np.linspace(0, 1, n + 1)[:, None] * (end - start)


def find_path(start: np.ndarray, end: np.ndarray, is_free: IsFree, rng: np.random.Generator) -> np.ndarray | None:
    """Corners (k, 6) [rad] of a free path between two free positions, or None: RRT-connect, then shortcuts."""
    if is_free(move_joints(start, end)):
        return np.stack([start, end])
    low = np.maximum(np.minimum(start, end) - MARGIN, -JOINT_LIMITS)
    high = np.minimum(np.maximum(start, end) + MARGIN, JOINT_LIMITS)
    trees = [_Tree(start), _Tree(end)]
    while sum(len(tree.nodes) for tree in trees) < MAX_NODES:
        reached = trees[0].grow(rng.uniform(low, high), is_free, many=False)
        if reached is not None:
            met = trees[1].grow(trees[0].nodes[reached], is_free, many=True)
            if met is not None and np.array_equal(trees[1].nodes[met], trees[0].nodes[reached]):
                path = [*trees[0].to_root(reached)[::-1], *trees[1].to_root(met)[1:]]
                forward = path if np.array_equal(path[0], start) else path[::-1]
                return _shortened(np.array(forward), is_free, rng)
        trees.reverse()
    return None


class _Tree:
    """A tree of free positions."""

    def __init__(self, root: np.ndarray) -> None:
        self.nodes, self.parents = [root], [-1]

    def grow(self, target: np.ndarray, is_free: IsFree, many: bool) -> int | None:
        """Step towards a target, once or until blocked; the last node added, None when there is none."""
        nearest = int(np.argmin(((np.array(self.nodes) - target) ** 2).sum(1)))
        added = None
        while len(self.nodes) < MAX_NODES:
            here = self.nodes[nearest]
            away = target - here
            share = min(1.0, TREE_STEP / max(float(np.abs(away).max()), 1e-12))
            there = target if share == 1.0 else here + share * away
            if not is_free(move_joints(here, there)[1:]):
                return added
            self.nodes.append(there)
            self.parents.append(nearest)
            nearest = added = len(self.nodes) - 1
            if share == 1.0 or not many:
                return added
        return added

    def to_root(self, node: int) -> list[np.ndarray]:
        """Positions from a node to the root."""
        path = []
        while node >= 0:
            path.append(self.nodes[node])
            node = self.parents[node]
        return path


def _shortened(path: np.ndarray, is_free: IsFree, rng: np.random.Generator) -> np.ndarray:
    """A path with corners left out if the straight way is free."""
    for _ in range(SHORTCUTS):
        if len(path) <= 2:
            break
        a, b = np.sort(rng.choice(len(path), 2, replace=False))
        if b - a > 1 and is_free(move_joints(path[a], path[b])):
            path = np.concatenate([path[: a + 1], path[b:]])
    return path


def line_leg(name: str, joints: np.ndarray, distance: float) -> Leg:
    """A line of evenly spaced joints (n, 6) over a distance [m]."""
    share = np.linspace(0, 1, len(joints))
    return Leg(name, joints, arrival_times(share * distance, distance, LINE_SPEED, LINE_ACCELERATION))


def move_legs(name: str, corners: np.ndarray) -> list[Leg]:
    """Joint moves from corner to corner (k, 6)."""
    legs = []
    for start, end in pairwise(corners):
        joints = move_joints(start, end)
        farthest = float(np.abs(end - start).max())
        share = np.linspace(0, 1, len(joints))
        legs.append(Leg(name, joints, arrival_times(share * farthest, farthest, MOVE_SPEED, MOVE_ACCELERATION)))
    return legs


def arrival_times(travelled: np.ndarray, distance: float, speed: float, acceleration: float) -> np.ndarray:
    """[s] (n,) at which distances `travelled` (n,) are reached on a way from rest to rest, in a trapezoid of speed.

    A way too short for the full speed has a triangle. All lengths in one unit.
    """
    ramp = min(speed * speed / (2 * acceleration), distance / 2)  # length of either ramp
    top = np.sqrt(2 * acceleration * ramp)
    total = 2 * top / acceleration + (distance - 2 * ramp) / speed
    rising = np.sqrt(2 * np.clip(travelled, 0, None) / acceleration)
    falling = total - np.sqrt(2 * np.clip(distance - travelled, 0, None) / acceleration)
    cruising = top / acceleration + (travelled - ramp) / speed
    return np.where(travelled <= ramp, rising, np.where(travelled >= distance - ramp, falling, cruising))


def is_reachable(joints: np.ndarray) -> np.ndarray:
    """(8,) bool: the branches of a line (8, n, 6) that can follow it."""
    return np.asarray(within_limits(joints).all(1))
