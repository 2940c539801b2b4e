"""The camera pose and the depth scale that explain what a view shows of the table.

The seven unknowns are a small motion of the camera (rotation, translation, in its own frame) and the logarithm of the
depth scale. Each is pulled to 0 by the spread that the specification of the d415 gives it, so what the table does not
determine stays as recorded. Sums are loops of numpy, not BLAS: results are the same on every processor.
"""

from __future__ import annotations

from collections.abc import Sequence

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
from kit1000.perception.sensor_facts import AnySensor
from kit1000.pose import Pose
from kit1000.sim.sensors import SENSORS
from kit1000.values import View

D415 = SENSORS["d415"]
SPREADS = np.repeat(
    [np.radians(D415.rotation_error_deg) / np.sqrt(3), D415.position_error / np.sqrt(3), D415.scale_error / np.sqrt(3)],
    [3, 3, 1],
)
"""(7,) standard deviations of the unknowns: rotation vector [rad], translation [m], logarithm of the depth scale."""
ROUNDS = 4  # of Gauss and Newton


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
    labels = checked("labels", labels, view.depth.shape, np.uint8)
    plane = table_plane(view, labels, reach, correlated)
    if plane is None:
        return view
    unknowns = _solved(view, plane, [])
    seen = seen_borders(_corrected(view, unknowns), labels, borders)
    corrected = _corrected(view, _solved(view, plane, seen) if seen else unknowns)
    return flattened(corrected, labels) if flat else corrected


def calibrated_by(view: View, labels: np.ndarray, sensor: AnySensor) -> View:
    """The view as `calibrated` has it, with the borders and the reach that belong to a noisy sensor."""
    reach, correlated = reach_of(sensor, view), correlated_in(sensor)
    return calibrated(view, labels, borders=borders_of(sensor), reach=reach, correlated=correlated)


def _corrected(view: View, unknowns: np.ndarray) -> View:
    return View(view.camera, _pose(view, unknowns), view.depth * np.float32(np.exp(-unknowns[6])))


def _pose(view: View, unknowns: np.ndarray) -> Pose:
    return view.world_from_camera @ Pose.from_rotvec(unknowns[:3], unknowns[3:6])


def _solved(view: View, plane: Plane, seen: Sequence[SeenBorder]) -> np.ndarray:
    """(7,) unknowns of least squares: plane, borders, and the spread of each unknown."""

    def residuals(scaled: np.ndarray) -> np.ndarray:
        unknowns = scaled * SPREADS
        pose = _pose(view, unknowns)
        measured = plane_coefficients(pose) * np.exp(-unknowns[6])
        on_plane = matmul(plane.axes.T, measured - plane.coefficients) / plane.spreads
        return np.concatenate([scaled, on_plane, *(border.residuals(view.camera, pose) for border in seen)])

    start = np.zeros(len(SPREADS))
    for _ in range(ROUNDS):
        here = residuals(start)
        slopes = np.stack([(residuals(start + step) - here) / 1e-3 for step in 1e-3 * np.eye(len(start))], axis=-1)
        start = start - solve_positive(matmul(slopes.T, slopes), matmul(slopes.T, here))
    return start * SPREADS
