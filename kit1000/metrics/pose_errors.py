"""How far predicted motions are from home: position, rotation and MSSD, blind to which of several right goals is meant.

One goal judges a query, the one of smallest MSSD over all goals and, where the slot leaves one free, over all turns
about its axis; position and rotation are read against that same goal. Pure functions of arrays: metres and radians.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from kit1000.metrics.nearest_goal import nearest_goals
from kit1000.metrics.targets import Targets, check_poses
from kit1000.pose import Pose, quaternion_angle, quaternion_conjugate, quaternion_multiply


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors of n predictions, one row a query; read-only."""

    position: np.ndarray
    """(n,) [m] from where the anchor is taken to where the judging goal wants it."""
    rotation: np.ndarray
    """(n,) [rad] geodesic angle to the judging goal, 0 to pi."""
    mssd: np.ndarray
    """(n,) [m] maximum symmetry-aware surface distance: of the worst point of the part to its place."""
    goal: np.ndarray
    """(n,) int: the judging goal, among those of its query."""
    angle: np.ndarray
    """(n,) [rad] by which the judging goal is turned about the free axis, -pi to pi; 0 without one."""
    position_plain: np.ndarray
    """(n,) [m] the same as `position` against the drawn goal, whatever the symmetry."""
    rotation_plain: np.ndarray
    """(n,) [rad] the same as `rotation` against the drawn goal."""

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).setflags(write=False)


def pose_errors(predicted: Pose, targets: Targets) -> PoseErrors:
    """Measure predicted motions (n,) goal_from_now, one for each of n targets, in their order."""
    check_poses("predicted", predicted, len(targets))
    goal, turn, mssd = _judged(predicted, targets)
    home = _turned(targets, goal, turn)
    position, rotation = _apart(predicted, home, targets.anchors)
    position_plain, rotation_plain = _apart(predicted, targets.goals_drawn, targets.anchors)
    return PoseErrors(position, rotation, mssd, goal, turn, position_plain, rotation_plain)


def nearest_goal_motions(targets: Targets, errors: PoseErrors) -> Pose:
    """(n,) goal_from_now of the goals that predictions were judged by, turned as they were judged."""
    return _turned(targets, errors.goal, errors.angle)


def _judged(predicted: Pose, targets: Targets) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The judging goals, their turns [rad] and the MSSD [m], (n,) each."""
    owner, free = targets.owner, targets.free
    moved = predicted @ targets.world_from_part
    wanted = targets.goals @ targets.world_from_part[owner]
    directions = np.where(free[:, None], targets.axis_directions, 0.0)
    goal, turn, mssd = nearest_goals(
        *(moved.rotation_matrix(), moved.xyz),
        *(wanted.rotation_matrix(), wanted.xyz),
        targets.goal_starts,
        *(free, np.where(free[:, None], targets.axis_points, 0.0), directions),
        _twist(predicted[owner], targets.goals, directions[owner]),
        *(targets.hulls, targets.hull_starts, targets.shape),
    )
    return goal, turn - 2 * np.pi * np.round(turn / (2 * np.pi)), mssd


def _twist(predicted: Pose, goals: Pose, directions: np.ndarray) -> np.ndarray:
    """(m,) [rad] turns of the goals about directions (m, 3) that come nearest to the predicted rotations.

    The twist of the rotation from goal to prediction: 2 atan2(n . q_xyz, q_w).
    """
    relative = quaternion_multiply(predicted.wxyz, quaternion_conjugate(goals.wxyz))
    return 2 * np.arctan2(np.sum(relative[:, 1:] * directions, axis=1), relative[:, 0])


def _turned(targets: Targets, goal: np.ndarray, turn: np.ndarray) -> Pose:
    """(n,) one goal a query, turned [rad] about the free axis where there is one."""
    free = targets.free[:, None]
    points = np.where(free, targets.axis_points, 0.0)
    about = Pose.from_rotvec(np.where(free, turn[:, None] * targets.axis_directions, 0.0))
    about = Pose(about.wxyz, points - about.rotate(points))
    chosen = targets.goals[targets.goal_starts[:-1] + goal]
    turned = about @ chosen
    return Pose(np.where(free, turned.wxyz, chosen.wxyz), np.where(free, turned.xyz, chosen.xyz))


def _apart(predicted: Pose, home: Pose, anchors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) [m] between the anchors under two motions, (n,) [rad] between their rotations."""
    distance = np.linalg.norm(predicted.apply(anchors) - home.apply(anchors), axis=1)
    return distance, quaternion_angle(predicted.wxyz, home.wxyz)
