"""What is wrong with a motion that does not seat its part: which of its errors, mended alone, would let it pass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.metrics.pose_errors import nearest_goal_motions
from kit1000.metrics.seating import GeometrySource
from kit1000.pose import Pose
from kit1000.values import Truth

SEATS = "nothing"
WRONG_PLATE, ROTATION, POSITION, EITHER, BOTH = "wrong plate", "rotation", "position", "rotation or position", "both"
KINDS = (SEATS, WRONG_PLATE, ROTATION, POSITION, EITHER, BOTH)
"""The seating test passes the motion; the part is nearer to another plate than to its own; the motion with the rotation
of the nearest goal passes; that with its position; each of them alone; neither, so both are wrong."""


def failure_kinds(motions: Pose, truths: Sequence[Truth], targets: Targets, geometry: GeometrySource) -> list[str]:
    """One of KINDS for each of n motions goal_from_now (n,). targets: of the same truths."""
    anchors = targets.anchors
    goals = nearest_goal_motions(targets, pose_errors(motions, targets))
    turned = _about(goals, anchors, motions.apply(anchors))
    shifted = _about(motions, anchors, goals.apply(anchors))
    passed, with_rotation, with_position = (
        seatings(tried, truths, geometry).seated for tried in (motions, turned, shifted)
    )
    kinds = []
    for i, truth in enumerate(truths):
        if passed[i]:
            kinds.append(SEATS)
        elif not _is_at_own_plate(motions[i].apply(truth.anchor), truth, geometry):
            kinds.append(WRONG_PLATE)
        else:
            found = {(True, True): EITHER, (True, False): ROTATION, (False, True): POSITION, (False, False): BOTH}
            kinds.append(found[bool(with_rotation[i]), bool(with_position[i])])
    return kinds


def _about(motions: Pose, points: np.ndarray, images: np.ndarray) -> Pose:
    """Motions (n,) with their rotations that take points (n, 3) [m] to images (n, 3) [m]."""
    return Pose(motions.wxyz, images - motions.rotate(points))


def _is_at_own_plate(middle: np.ndarray, truth: Truth, geometry: GeometrySource) -> bool:
    """Whether the middle (3,) [m] of a moved part is nearest to the plate with its slot."""
    mounts = geometry.assembly(truth.assembly_id).mounts
    own = next(i for i, mount in enumerate(mounts) if mount.kit.id == truth.part_id)
    in_assembly = mounts[own].assembly_from_kit.apply(truth.world_from_kit.inverse().apply(middle))
    distances = [float(np.sqrt(((mount.assembly_from_kit.xyz - in_assembly) ** 2).sum())) for mount in mounts]
    return int(np.argmin(distances)) == own
