"""The camera pose and the depth scale that explain what a view shows of the table: its plane and its borders.

The seven unknowns are a small motion of the camera (rotation, translation, in its own frame) and the error of the depth
scale. Each is pulled to 0 by the spread that the specification of the d415 gives it, so what the table does not
determine stays as recorded. Borders are edges of the table against nothing: straight lines in the image, which show the
camera's yaw and place. Sums are loops of numpy, not BLAS, and nothing takes an exponential: results are the same on
every processor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.camera import Camera
from kit1000.errors import checked
from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.calibration.depth_scale import in_true_lengths, stated_scale
from kit1000.perception.calibration.table import (
    BENT,
    HALF_SIZES,
    PLANE_REACH,
    Plane,
    correlated_in,
    ground,
    plane_coefficients,
    rays,
    reach_of,
    table_plane,
)
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.sim.sensors import SENSORS
from kit1000.values import View

BORDER_REACH = 10  # [px] on either side of where a border is expected
LEAST_BORDER = 20  # pixels of a border
BORDER_SPREAD = 0.1  # [px] standard deviation of a whole border: bodies beside it and dropouts move it, not one pixel
DROPOUT_QUANTILE = 0.9  # dropouts move a border inward only, so it lies where the outermost pixels are
TOLERANCE = 1.0  # [px] from the border, of the pixels that enter
LINE_ROUNDS = 4  # of the choice of pixels

Line = tuple[float, float, float]
D415 = SENSORS["d415"]
SPREADS = np.repeat(
    [np.radians(D415.rotation_error_deg) / np.sqrt(3), D415.position_error / np.sqrt(3), D415.scale_error / np.sqrt(3)],
    [3, 3, 1],
)
"""(7,) standard deviations of the unknowns: rotation vector [rad], translation [m], error of the depth scale."""
ROUNDS = 4  # of Gauss and Newton


@dataclass(frozen=True)
class OutlineEdge:
    """An edge of the table against nothing."""

    axis: int
    """0: along y, at an x; 1: along x, at a y."""
    side: int
    """1 or -1: of the origin."""

    @property
    def outward(self) -> np.ndarray:
        """(3,) unit normal."""
        return self.side * np.eye(3)[self.axis]

    def line(self, camera: Camera, pose: Pose) -> Line:
        """The edge in the image: a, b, c such that a u + b v + c is 0 on it."""
        x, y, _ = self.outward
        on_edge = self.outward * HALF_SIZES[self.axis]
        normal = matmul(np.cross((-y, x, 0.0), on_edge - pose.xyz), pose.rotation_matrix())
        a, b = normal[0] / camera.fx, normal[1] / camera.fy
        return float(a), float(b), float(normal[2] - a * camera.cx - b * camera.cy)

    def shown(self, pose: Pose, points: np.ndarray) -> np.ndarray:
        """Along the edge. Nowhere if the camera is outside: from there the side of the table continues below it."""
        if matmul(pose.xyz, self.outward) > HALF_SIZES[self.axis]:
            return np.zeros(len(points), bool)
        return np.abs(points[:, 1 - self.axis]) < HALF_SIZES[1 - self.axis]


OUTLINE = tuple(OutlineEdge(axis, side) for axis in (0, 1) for side in (1, -1))


def borders_of(sensor: SensorFacts) -> tuple[OutlineEdge, ...]:
    """The edges that an image of a sensor may use: none of a scanner, whose plane suffices, and none of a table of
    unknown size."""
    return OUTLINE if sensor.kind.restores and sensor.simulated_table else ()


@dataclass(frozen=True, eq=False)
class SeenBorder:
    """A border as an image shows it: at most one place in each column, or in each row."""

    border: OutlineEdge
    columns: bool
    """Whether columns cross it, and not rows."""
    lines: np.ndarray
    """(n,) [px] the columns, or the rows."""
    places: np.ndarray
    """(n,) [px] on each, midway between the last pixel with a return and the first without."""
    spread: float
    """[px] standard deviation of each place, such that all together have that of the border."""

    def residuals(self, camera: Camera, pose: Pose) -> np.ndarray:
        """(n,) [spreads] from the places to where a camera at this pose would see the border."""
        expected = _on_line(self.border.line(camera, pose), self.columns, self.lines)
        return (expected - self.places) / self.spread


def seen_borders(view: View, labels: np.ndarray, borders: Sequence[OutlineEdge] = OUTLINE) -> list[SeenBorder]:
    """The borders that the image shows, in a view whose plane is right. labels: (H, W), 0 for the table or nothing."""
    seen = (_seen(view, labels, border) for border in borders)
    return [border for border in seen if border is not None]


def _seen(view: View, labels: np.ndarray, border: OutlineEdge) -> SeenBorder | None:
    """A border; None if the image shows too little of it."""
    columns, outward, lines, expected = _expected(view.camera, view.world_from_camera, border)
    if len(lines) < LEAST_BORDER:
        return None
    steps = np.arange(-BORDER_REACH, BORDER_REACH + 1)
    places = np.rint(expected).astype(int)[:, None] + outward * steps
    pixels = (places, lines[:, None]) if columns else (lines[:, None], places)
    table = labels[pixels] == 0
    seen = table & (view.depth[pixels] > 0)
    inside = len(steps) - np.argmax(seen[:, ::-1], axis=1)  # up to the outermost return
    clean = table.all(axis=1) & seen.any(axis=1) & (inside < len(steps))
    if clean.sum() < LEAST_BORDER:
        return None
    lines, expected = lines[clean], expected[clean]
    last = places[clean, inside[clean] - 1] + 0.5 * outward
    kept = _without_dropouts(lines.astype(float), outward * (last - expected))
    if kept.sum() < LEAST_BORDER:
        return None
    return SeenBorder(border, columns, lines[kept], last[kept], BORDER_SPREAD * float(np.sqrt(kept.sum())))


def _expected(camera: Camera, pose: Pose, border: OutlineEdge) -> tuple[bool, int, np.ndarray, np.ndarray]:
    """Where a border should be in the image.

    Returns:
        Whether columns cross it, and not rows; the outward direction on them, 1 or -1; (n,) which of them cross it;
        (n,) [px] where. Only those with BORDER_REACH to the border of the image.
    """
    line = a, b, _ = border.line(camera, pose)
    columns = abs(b) > abs(a)
    across, down = (camera.width, camera.height) if columns else (camera.height, camera.width)
    lines = np.arange(across)
    places = _on_line(line, columns, lines)
    points = ground(pose, rays(camera, np.stack([lines, places] if columns else [places, lines], axis=-1)))
    inside = (places >= BORDER_REACH) & (places <= down - 1 - BORDER_REACH) & border.shown(pose, points)
    return columns, -1 if (b if columns else a) > 0 else 1, lines[inside], places[inside]


def _on_line(line: Line, columns: bool, lines: np.ndarray) -> np.ndarray:
    """(n,) [px] where a line crosses columns or rows (n,) [px]."""
    a, b, c = line
    return -(a * lines + c) / b if columns else -(b * lines + c) / a


def _without_dropouts(places: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    """(n,) bool: the pixels of a border that lie on one line, among those that a dropout moved inward.

    Args:
        places: (n,) [px] along the border.
        beyond: (n,) [px] outward from where the border is expected.
    """
    middle = places.mean()
    terms = np.stack([np.ones_like(places), (places - middle) / max(np.ptp(places), 1.0)], axis=-1)
    line = np.full(len(places), np.quantile(beyond, DROPOUT_QUANTILE))
    reach = 3 * TOLERANCE  # wide at first: the recorded yaw tilts the line
    for _ in range(LINE_ROUNDS):
        kept = np.abs(beyond - line) < reach
        if kept.sum() < LEAST_BORDER:
            return kept
        line = matmul(
            terms,
            solve_positive(matmul(terms[kept].T, terms[kept]) + 1e-6 * np.eye(2), matmul(terms[kept].T, beyond[kept])),
        )
        reach = max(reach / 1.6, TOLERANCE)
    return np.abs(beyond - line) < reach


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


def calibrated(view: View, labels: np.ndarray, borders: Sequence[OutlineEdge] = OUTLINE) -> View:
    """The view with the camera pose and the depths that its table gives it.

    Args:
        view: as recorded by a noisy sensor.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`; 0 for the table or nothing.
        borders: of the table that are used as well as its plane.
    """
    return camera_estimate(view, labels, borders, PLANE_REACH, BENT).view


def calibrated_by(view: View, labels: np.ndarray, sensor: SensorFacts) -> View:
    """The view as `calibrated` has it, with the borders and the reach that belong to a noisy sensor."""
    return camera_estimate_by(view, labels, sensor).view


def camera_estimate_by(view: View, labels: np.ndarray, sensor: SensorFacts) -> CameraEstimate:
    """The camera of a view of a noisy sensor, by the borders and the reach that belong to it, and its stated height."""
    view = at_stated_scale(view, sensor)
    return camera_estimate(view, labels, borders_of(sensor), reach_of(sensor, view), correlated_in(sensor))


def at_stated_scale(view: View, sensor: SensorFacts) -> View:
    """A view of an own camera, whose height over the table was measured, in the scale that its stated height tells."""
    scale = stated_scale(sensor, float(view.world_from_camera.xyz[2])).value
    return View(view.camera, in_true_lengths(view.world_from_camera, scale), view.depth / np.float32(scale))


def camera_estimate(
    view: View, labels: np.ndarray, borders: Sequence[OutlineEdge], reach: float, correlated: float
) -> CameraEstimate:
    """The camera of a view, see `calibrated`; as recorded where too little of the table is seen.

    reach: [m] from the recorded plane, of pixels that may show it. correlated: how many of its pixels count as one.
    """
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
