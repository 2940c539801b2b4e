"""Edges of the table against nothing: straight lines in the image, which show the camera's yaw and its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.camera import Camera
from kit1000.numerics.elimination import solve_positive
from kit1000.numerics.linear_algebra import matmul
from kit1000.perception.calibration.table_top import HALF_SIZES, ground, rays
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.values import View

REACH = 10  # [px] on either side of where a border is expected
LEAST = 20  # pixels of a border
BORDER_SPREAD = 0.1  # [px] standard deviation of a whole border: bodies beside it and dropouts move it, not one pixel
DROPOUT_QUANTILE = 0.9  # dropouts move a border inward only, so it lies where the outermost pixels are
TOLERANCE = 1.0  # [px] from the border, of the pixels that enter
ROUNDS = 4  # of the choice of pixels

Line = tuple[float, float, float]


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
        """The normal of the plane through camera and edge, in pixels."""
        x, y, _ = self.outward
        on_edge = self.outward * HALF_SIZES[self.axis]
        normal = matmul(np.cross((-y, x, 0.0), on_edge - pose.xyz), pose.rotation_matrix())
        return _in_pixels(normal, camera)

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
    """A border; None where the image shows too little of it."""
    columns, outward, lines, expected = _expected(view.camera, view.world_from_camera, border)
    if len(lines) < LEAST:
        return None
    steps = np.arange(-REACH, REACH + 1)
    places = np.rint(expected).astype(int)[:, None] + outward * steps
    pixels = (places, lines[:, None]) if columns else (lines[:, None], places)
    table = labels[pixels] == 0
    seen = table & (view.depth[pixels] > 0)
    inside = len(steps) - np.argmax(seen[:, ::-1], axis=1)  # up to the outermost return
    clean = table.all(axis=1) & seen.any(axis=1) & (inside < len(steps))
    if clean.sum() < LEAST:
        return None
    lines, expected = lines[clean], expected[clean]
    last = places[clean, inside[clean] - 1] + 0.5 * outward
    kept = _without_dropouts(lines.astype(float), outward * (last - expected))
    if kept.sum() < LEAST:
        return None
    return SeenBorder(border, columns, lines[kept], last[kept], BORDER_SPREAD * float(np.sqrt(kept.sum())))


def _expected(camera: Camera, pose: Pose, border: OutlineEdge) -> tuple[bool, int, np.ndarray, np.ndarray]:
    """Where a border should be in the image.

    Returns:
        Whether columns cross it, and not rows; the outward direction on them, 1 or -1; (n,) which of them cross it;
        (n,) [px] where. Only those with REACH to the border of the image.
    """
    line = a, b, _ = border.line(camera, pose)
    columns = abs(b) > abs(a)
    across, down = (camera.width, camera.height) if columns else (camera.height, camera.width)
    lines = np.arange(across)
    places = _on_line(line, columns, lines)
    points = ground(pose, rays(camera, np.stack([lines, places] if columns else [places, lines], axis=-1)))
    inside = (places >= REACH) & (places <= down - 1 - REACH) & border.shown(pose, points)
    return columns, -1 if (b if columns else a) > 0 else 1, lines[inside], places[inside]


def _on_line(line: Line, columns: bool, lines: np.ndarray) -> np.ndarray:
    """(n,) [px] where a line crosses columns or rows (n,) [px]."""
    a, b, c = line
    return -(a * lines + c) / b if columns else -(b * lines + c) / a


def _in_pixels(normal: np.ndarray, camera: Camera) -> Line:
    """a, b, c such that a u + b v + c is the product of a vector (3,) with the ray of pixel (u, v), of depth 1."""
    a, b = normal[0] / camera.fx, normal[1] / camera.fy
    return float(a), float(b), float(normal[2] - a * camera.cx - b * camera.cy)


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
    for _ in range(ROUNDS):
        kept = np.abs(beyond - line) < reach
        if kept.sum() < LEAST:
            return kept
        line = matmul(
            terms,
            solve_positive(matmul(terms[kept].T, terms[kept]) + 1e-6 * np.eye(2), matmul(terms[kept].T, beyond[kept])),
        )
        reach = max(reach / 1.6, TOLERANCE)
    return np.abs(beyond - line) < reach
