"""The depth scale of a stereo camera, as far as a stated pose of an own camera tells it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose

SCALE_SPREAD = 1.7e-3  # of the depth scale of a stereo camera: uniform within 0.3 %
STATED_SPREAD = 0.9e-3  # [m] of a stated height: along one axis, if hand-eye positions are off by 1.5 mm
MOST_SCALE = 3 * SCALE_SPREAD  # beyond, no camera is believed


class DepthScale(NamedTuple):
    """Measured over true depth, as far as it is known."""

    value: float = 1.0
    spread: float = SCALE_SPREAD
    """Standard deviation."""


def stated_scale(sensor: SensorFacts, height: float) -> DepthScale:
    """The depth scale of an own camera by its stated pose, if there is one that can be right.

    height: [m] of the camera above the table.
    """
    ratio = sensor.height_ratio
    if ratio is None or abs(ratio - 1) > MOST_SCALE:
        return DepthScale()
    before, stated = SCALE_SPREAD**-2, (STATED_SPREAD / height) ** -2
    return DepthScale(1 + (ratio - 1) * stated / (before + stated), (before + stated) ** -0.5)


def in_true_lengths(world_from_camera: Pose, scale: float) -> Pose:
    """The pose of an own camera, whose height over the table was measured, by a scale (measured over true depth)."""
    x, y, z = world_from_camera.xyz
    return Pose(world_from_camera.wxyz, np.array([x, y, z / scale]))
