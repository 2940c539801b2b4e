"""Calibration of a recorded view by the table, without learning and without the truth.

The table is part of the specification of every scene (docs/reference/sensors.md). Read `table` (the pixels that look
at it, its plane, and the smooth error of depths that is left on it) and `camera_pose` (the table's borders, and the
pose and the depth scale that explain plane and borders).
"""

from kit1000.perception.calibration.camera_pose import (
    OUTLINE,
    CameraEstimate,
    calibrated,
    calibrated_by,
    camera_estimate_by,
)
from kit1000.perception.calibration.table import flattened, unbent

__all__ = ["OUTLINE", "CameraEstimate", "calibrated", "calibrated_by", "camera_estimate_by", "flattened", "unbent"]
