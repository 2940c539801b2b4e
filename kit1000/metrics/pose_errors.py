"""Position error, rotation error and MSSD of predicted motions, symmetry-aware: any of several equal goals is right.

Each query is measured against its nearest goal: the one of smallest MSSD, over all goals and, where the slot has a free
axis, over all angles about it. Position and rotation errors are against that same goal. Metres and radians.
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
    """(n,) [m] between the anchor under the predicted motion and under the nearest goal."""
    rotation: np.ndarray
    """(n,) [rad] geodesic angle to the nearest goal, 0 to pi."""
    mssd: np.ndarray
    """(n,) [m] maximum symmetry-aware surface distance: of the worst vertex of the part, to the nearest goal."""
    goal: np.ndarray
    """(n,) int: index of the nearest goal, among those of its query."""
    angle: np.ndarray
    """(n,) [rad] of the nearest goal about the free axis, -pi to pi; 0 without one."""
    position_plain: np.ndarray
    """(n,) [m] as `position`, but against the drawn goal, without symmetry."""
    rotation_plain: np.ndarray
    """(n,) [rad] as `rotation`, but against the drawn goal, without symmetry."""

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).setflags(write=False)


def pose_errors(predicted: Pose, targets: Targets) -> PoseErrors:
    """The errors of predicted motions (n,) goal_from_now, one for each of n targets, in their order."""
    check_poses("predicted", predicted, len(targets))
    goal, angle, mssd = _nearest_goals(predicted, targets)
    goal_motions = _goal_motions(targets, goal, angle)
    position, rotation = _position_and_rotation(predicted, goal_motions, targets.anchors)
    position_plain, rotation_plain = _position_and_rotation(predicted, targets.goals_drawn, targets.anchors)
    return PoseErrors(position, rotation, mssd, goal, angle, position_plain, rotation_plain)


def nearest_goal_motions(targets: Targets, errors: PoseErrors) -> Pose:
    """(n,) goal_from_now of the nearest goals, at their angles about the free axes."""
    return _goal_motions(targets, errors.goal, errors.angle)


def _nearest_goals(predicted: Pose, targets: Targets) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest goals, their angles about the free axes [rad] and the MSSD [m], (n,) each."""
    query, free = targets.query_of_goal, targets.has_free_axis
    predicted_poses = predicted @ targets.world_from_part
    goal_poses = targets.goals @ targets.world_from_part[query]
    directions = np.where(free[:, None], targets.axis_directions, 0.0)
    goal, angle, mssd = nearest_goals(
        *(predicted_poses.rotation_matrix(), predicted_poses.xyz),
        *(goal_poses.rotation_matrix(), goal_poses.xyz),
        targets.goal_starts,
        *(free, np.where(free[:, None], targets.axis_points, 0.0), directions),
        _twist(predicted[query], targets.goals, directions[query]),
        *(targets.hulls, targets.hull_starts, targets.hull_index),
    )
    return goal, angle - 2 * np.pi * np.round(angle / (2 * np.pi)), mssd


def _twist(predicted: Pose, goals: Pose, directions: np.ndarray) -> np.ndarray:
    """(m,) [rad] angles of the goals about directions (m, 3) with the smallest rotation error.

    The twist of the rotation from goal to prediction: 2 atan2(n . q_xyz, q_w).
    """
    relative = quaternion_multiply(predicted.wxyz, quaternion_conjugate(goals.wxyz))
    return 2 * np.arctan2(np.sum(relative[:, 1:] * directions, axis=1), relative[:, 0])


def _goal_motions(targets: Targets, goal: np.ndarray, angle: np.ndarray) -> Pose:
    """(n,) goal_from_now of one goal a query, rotated by an angle [rad] about the free axis where there is one."""
    free = targets.has_free_axis[:, None]
    points = np.where(free, targets.axis_points, 0.0)
    about = Pose.from_rotvec(np.where(free, angle[:, None] * targets.axis_directions, 0.0))
    about = Pose(about.wxyz, points - about.rotate(points))
    chosen = targets.goals[targets.goal_starts[:-1] + goal]
    rotated = about @ chosen
    return Pose(np.where(free, rotated.wxyz, chosen.wxyz), np.where(free, rotated.xyz, chosen.xyz))


def _position_and_rotation(predicted: Pose, goals: Pose, anchors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) [m] between the anchors under two motions, (n,) [rad] between their rotations."""
    distance = np.linalg.norm(predicted.apply(anchors) - goals.apply(anchors), axis=1)
    return distance, quaternion_angle(predicted.wxyz, goals.wxyz)
