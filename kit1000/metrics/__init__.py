"""Metrics of predicted motions, volumes and masks: pure functions of arrays, in SI units.

Every score states the versions of its metrics; a change to a formula or a limit raises the version.
"""

from kit1000.metrics.pose_errors import PoseErrors, nearest_goal_motions, pose_errors
from kit1000.metrics.seating import Seatings, seatings
from kit1000.metrics.segmentation import MatchedMasks, matched_masks, mean_iou
from kit1000.metrics.targets import Targets
from kit1000.metrics.volumes import known_share, occupancy_iou, surface_chamfer

METRIC_VERSIONS: dict[str, int] = {
    "position": 1,
    "rotation": 1,
    "mssd": 1,
    "seated": 2,
    "penetration": 1,
    "occupancy_iou": 1,
    "chamfer": 1,
    "mean_iou": 1,
}
"""Version of each metric, raised when its values change."""

__all__ = [
    "METRIC_VERSIONS",
    "MatchedMasks",
    "PoseErrors",
    "Seatings",
    "Targets",
    "known_share",
    "matched_masks",
    "mean_iou",
    "nearest_goal_motions",
    "occupancy_iou",
    "pose_errors",
    "seatings",
    "surface_chamfer",
]
