"""Calibration of a recorded view by the table, without learning and without the truth.

The table is part of the specification of every scene (docs/reference/sensors.md). Read `plane` (the table's plane),
`borders` (its outline), `camera_pose` (the pose and the depth scale that explain them), `bending` (the smooth error of
depths that is left on the table) and `table_top` (which pixels look at the table).
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
