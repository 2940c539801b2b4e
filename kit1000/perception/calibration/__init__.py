"""Calibration of a recorded view by the table, without learning and without the truth.

The table is part of the specification of every scene, and what the sensor does not see of it is part of its own
(docs/reference/sensors.md). Read `plane` (the table's plane), `borders` (its outline, and the band that the second
imager does not see), `camera_pose` (the pose and the depth scale that explain them) and `table_top` (which pixels
look at the table).
"""

from kit1000.perception.calibration.borders import BLIND_BAND, BORDERS, OUTLINE
from kit1000.perception.calibration.camera_pose import CALIBRATED, calibrated, calibrated_by
from kit1000.perception.calibration.table_top import flattened

__all__ = ["BLIND_BAND", "BORDERS", "CALIBRATED", "OUTLINE", "calibrated", "calibrated_by", "flattened"]
