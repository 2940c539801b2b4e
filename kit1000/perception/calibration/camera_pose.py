"""The camera pose and the depth scale that explain what a view shows of the table.

The seven unknowns are a small motion of the camera (rotation, translation, in its own frame) and the error of the depth
scale. Each is pulled to 0 by the spread that the specification of the d415 gives it, so what the table does not
determine stays as recorded. Sums are loops of numpy, not BLAS, and nothing takes an exponential: results are the same
on every processor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.errors import checked
from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.calibration.borders import OUTLINE, OutlineEdge, SeenBorder, borders_of, seen_borders
from kit1000.perception.calibration.plane import (
    BENT,
    PLANE_REACH,
    Plane,
    correlated_in,
    plane_coefficients,
    reach_of,
    table_plane,
)
from kit1000.perception.calibration.table_top import flattened
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.sim.sensors import SENSORS
from kit1000.values import View

D415 = SENSORS["d415"]
SPREADS = np.repeat(
    [np.radians(D415.rotation_error_deg) / np.sqrt(3), D415.position_error / np.sqrt(3), D415.scale_error / np.sqrt(3)],
    [3, 3, 1],
)
"""(7,) standard deviations of the unknowns: rotation vector [rad], translation [m], error of the depth scale."""
ROUNDS = 4  # of Gauss and Newton


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """A camera as its view of the table shows it."""

    view: View
    """With the corrected pose and depths."""
    information: np.ndarray
    """(7, 7) inverse covariance of what is left of the unknowns, each in standard deviations of SPREADS."""

    def spread_of(self, motion: Pose, point: np.ndarray) -> float:
        """[m] standard deviation that is left of where a motion measured in this view takes a point of the world.

        An error of the camera moves the point (3,) [m] and its goal, and matters as far as it moves them unlike.
        """
        goal = motion.apply(point)
        slopes = self._moved(goal) - matmul(motion.rotation_matrix(), self._moved(point))
        variance = sum(matmul(row, solve_positive(self.information, row)) for row in slopes * SPREADS)
        return float(np.sqrt(variance))

    def _moved(self, point: np.ndarray) -> np.ndarray:
        """(3, 7) by how much a point of the world moves with each unknown."""
        pose = self.view.world_from_camera
        seen = pose.inverse().apply(point)
        turned = np.cross(np.eye(3), seen).T
        return matmul(pose.rotation_matrix(), np.column_stack([turned, np.eye(3), -seen]))


def calibrated(
    view: View,
    labels: np.ndarray,
    flat: bool = False,
    borders: Sequence[OutlineEdge] = OUTLINE,
    reach: float = PLANE_REACH,
    correlated: float = BENT,
) -> View:
    """The view with the camera pose and the depths that its table gives it.

    Args:
        view: as recorded by a noisy sensor.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`; 0 for the table or nothing.
        flat: put the pixels of the table exactly on its plane; those without a return get one.
        borders: of the table that are used as well as its plane.
        reach: [m] from the recorded plane, of pixels that may show it.
        correlated: how many of the pixels that enter the plane count as one.
    """
    corrected = camera_estimate(view, labels, borders, reach, correlated).view
    return flattened(corrected, labels) if flat and corrected is not view else corrected


def calibrated_by(view: View, labels: np.ndarray, sensor: SensorFacts) -> View:
    """The view as `calibrated` has it, with the borders and the reach that belong to a noisy sensor."""
    return camera_estimate_by(view, labels, sensor).view


def camera_estimate_by(view: View, labels: np.ndarray, sensor: SensorFacts) -> CameraEstimate:
    """The camera of a view of a noisy sensor, by the borders and the reach that belong to it."""
    return camera_estimate(view, labels, borders_of(sensor), reach_of(sensor, view), correlated_in(sensor))


def camera_estimate(
    view: View, labels: np.ndarray, borders: Sequence[OutlineEdge], reach: float, correlated: float
) -> CameraEstimate:
    """The camera of a view, see `calibrated`; as recorded where too little of the table is seen."""
    labels = checked("labels", labels, view.depth.shape, np.uint8)
    plane = table_plane(view, labels, reach, correlated)
    if plane is None:
        return CameraEstimate(view, np.eye(len(SPREADS)))
    unknowns, information = _solved(view, plane, [])
    seen = seen_borders(_corrected(view, unknowns), labels, borders)
    if seen:
        unknowns, information = _solved(view, plane, seen)
    return CameraEstimate(_corrected(view, unknowns), information)


def _corrected(view: View, unknowns: np.ndarray) -> View:
    return View(view.camera, _pose(view, unknowns), view.depth / np.float32(1 + unknowns[6]))


def _pose(view: View, unknowns: np.ndarray) -> Pose:
    return view.world_from_camera @ Pose.from_rotvec(unknowns[:3], unknowns[3:6])


def _solved(view: View, plane: Plane, seen: Sequence[SeenBorder]) -> tuple[np.ndarray, np.ndarray]:
    """Least squares of plane, borders, and the spread of each unknown.

    Returns:
        (7,) unknowns; (7, 7) see `CameraEstimate.information`.
    """

    def residuals(scaled: np.ndarray) -> np.ndarray:
        unknowns = scaled * SPREADS
        pose = _pose(view, unknowns)
        measured = plane_coefficients(pose) / (1 + unknowns[6])
        on_plane = matmul(plane.axes.T, measured - plane.coefficients) / plane.spreads
        return np.concatenate([scaled, on_plane, *(border.residuals(view.camera, pose) for border in seen)])

    start, information = np.zeros(len(SPREADS)), np.eye(len(SPREADS))
    for _ in range(ROUNDS):
        here = residuals(start)
        slopes = np.stack([(residuals(start + step) - here) / 1e-3 for step in 1e-3 * np.eye(len(start))], axis=-1)
        information = matmul(slopes.T, slopes)
        start = start - solve_positive(information, matmul(slopes.T, here))
    return start * SPREADS, information
