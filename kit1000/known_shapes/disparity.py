"""The disparity image that a sensor is expected to measure of known shapes on a table, and how well it does.

A stereo camera extends near surfaces beyond their edges by an amount that varies along the edge, and blends small jumps
into ramps. So a pixel beside an edge has a mean and a variance over what the sensor may do; `kit1000.sim.depth_edges`
does it for a few amounts. A scanner keeps edges sharp to a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter, uniform_filter

from kit1000.camera import Camera
from kit1000.known_shapes.shapes import StandingShape
from kit1000.known_shapes.support import Support
from kit1000.numerics.compiled import compiled
from kit1000.numerics.elimination import solve_positive
from kit1000.perception.sensor_facts import D415, SensorFacts
from kit1000.sim.depth_edges import blended_ramps, widened_edges
from kit1000.sim.render import inverse_depths
from kit1000.values import LabelledDepth

AMOUNTS = ((1 / 8, 3.0), (3 / 8, 6.0), (5 / 8, 3.0), (7 / 8, 6.0))
"""What the sensor may do beside an edge: share of its largest extension, and the jump [px] up to which it blends."""
FEW_AMOUNTS = ((1 / 4, 3.0), (3 / 4, 6.0))
"""The same for half an image, in which places are ranked."""
RAMP_HALF = 4.0  # [px] half the width of a ramp
SHARP = 3  # [px] side of a window in which a pixel of a sharp image may show either side of an edge
LEAST_NOISE, LEAST_BEND = 0.05, 0.03  # [px]
SEEN = 12  # [px] about a shape, of the pixels that tell where it is
CORRELATED = 30.0  # pixels whose errors are as one: windows of a stereo matcher
SLOW_ROUNDS = 2  # of reweighting
REACH = 6.0  # standard deviations beyond which a pixel counts as unexplained
MARGIN = 15  # [px] of a window about a shape


class Box(NamedTuple):
    """Rows and columns of an image."""

    top: int
    bottom: int
    left: int
    right: int

    @property
    def window(self) -> tuple[slice, slice]:
        """The pixels."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def contains(self, other: Box) -> bool:
        """Whether all pixels of another box are in this one."""
        rows = self.top <= other.top and other.bottom <= self.bottom
        return rows and self.left <= other.left and other.right <= self.right


@dataclass(frozen=True, eq=False)
class DisparityImage:
    """A depth image as disparities, with the table and the errors of its sensor."""

    camera: Camera
    measured: np.ndarray
    """(H, W) [px]; 0 for no return."""
    gain: float
    """[px m] disparity times depth."""
    support: Support
    noise: float
    """[px] standard deviation of a pixel."""
    bend: float
    """[px] standard deviation of what varies slowly in the image."""
    extension: float
    """[pixels of this image] by which near surfaces extend beyond their edges, at most."""
    ramp: float
    """[pixels of this image] half the width of a ramp."""
    amounts: Sequence[tuple[float, float]] = AMOUNTS
    """What it may do beside an edge."""

    @staticmethod
    def of(image: LabelledDepth, sensor: SensorFacts, support: Support) -> DisparityImage:
        """The disparities of a depth image on a table."""
        view = image.view
        gain = view.camera.fx * (sensor.baseline or D415.baseline)  # of an exact image any unit will do
        depth = view.depth.astype(float)
        measured = np.where(depth > 0, gain / np.where(depth > 0, depth, 1.0), 0.0)
        noise, bend = max(support.noise * gain, LEAST_NOISE), max(support.bend * gain, LEAST_BEND)
        stereo = sensor.baseline > 0 and sensor.fattening_px > 0
        extension, ramp = (sensor.fattening_px, RAMP_HALF) if stereo else (0.0, 0.0)
        return DisparityImage(view.camera, measured, gain, support, noise, bend, extension, ramp)

    @property
    def halved(self) -> DisparityImage:
        """Every second pixel."""
        camera = self.camera
        measured = self.measured[::2, ::2]
        height, width = measured.shape
        small = Camera(width, height, camera.fx / 2, camera.fy / 2, camera.cx / 2, camera.cy / 2)
        return replace(
            self,
            camera=small,
            measured=measured,
            extension=self.extension / 2,
            ramp=self.ramp / 2,
            amounts=FEW_AMOUNTS,
        )

    @cached_property
    def table(self) -> np.ndarray:
        """(H, W) [px] the disparities of the table."""
        camera, normal = self.camera, self.support.normal
        u, v = np.arange(camera.width) - camera.cx, np.arange(camera.height) - camera.cy
        slope = normal[0] * u[None] / camera.fx + normal[1] * v[:, None] / camera.fy + normal[2]
        return self.gain * slope / self.support.offset

    def box(self, shape: StandingShape, margin: int = MARGIN) -> Box:
        """The window about a shape, with a margin [px]."""
        corners = shape.camera_from_body().apply(shape.shape.corners)
        uv, (height, width) = self.camera.project(corners), self.measured.shape
        (left, top), (right, bottom) = np.floor(uv.min(0)).astype(int) - margin, np.ceil(uv.max(0)).astype(int) + margin
        clip = (top, bottom + 1, left, right + 1), (height, height, width, width)
        return Box(*(int(np.clip(end, 0, most)) for end, most in zip(*clip, strict=True)))

    def window(
        self, shape: StandingShape, others: Sequence[StandingShape] = (), scale: float = 1.0, room: int = 0
    ) -> Window:
        """The window about a shape, with the table and other shapes behind it.

        scale: measured over true depth; room: [px] on all sides, for the shape to move.
        """
        box = self.box(shape, MARGIN + room)
        rest = self.table[box.window]
        if others:
            rest = np.maximum(rest, self.rendered(others, box, scale))
        return Window(self, box, rest, scale)

    def rendered(self, shapes: Sequence[StandingShape], box: Box, scale: float) -> np.ndarray:
        """(h, w) [px] exact disparities of shapes in a window; 0 where none is."""
        camera, (height, width) = self.camera, (box.bottom - box.top, box.right - box.left)
        window = Camera(width, height, camera.fx, camera.fy, camera.cx - box.left, camera.cy - box.top)
        bodies = (inverse_depths(window, each.shape.mesh, each.camera_from_body(scale)) for each in shapes)
        return self.gain / scale * reduce(np.maximum, bodies)

    def expected(self, exact: np.ndarray, blur: int = SHARP) -> tuple[np.ndarray, np.ndarray]:
        """The mean and variance (h, w) of what the sensor makes of exact disparities (h, w) at their edges.

        blur: [px] side of the window over which the edges of a sharp image may lie.
        """
        if self.extension == 0:
            mean = uniform_filter(exact, blur)
            return mean, np.maximum(uniform_filter(exact * exact, blur) - mean * mean, 0.0)
        bordered = np.empty((exact.shape[0] + 2, exact.shape[1] + 2), np.float32)
        bordered[1:-1, 1:-1] = exact
        bordered[0], bordered[-1] = bordered[1], bordered[-2]
        bordered[:, 0], bordered[:, -1] = bordered[:, 1], bordered[:, -2]
        amounts = np.array(self.amounts, np.float32)
        return expected_edges(bordered, amounts[:, :1, None], amounts[:, 1:, None], self.extension, self.ramp)


class Explained(NamedTuple):
    """What a shape explains of an image."""

    gain: float
    """The number of pixels that it explains and that table and others do not, less those that it spoils."""
    left: float
    """The number of pixels in and about it that are left unexplained."""
    compared: int
    """The number of pixels in and about it with a return."""

    @property
    def misfit(self) -> float:
        """What is left unexplained about it: 0 for nothing, 1 for all pixels."""
        return self.left / self.compared if self.compared else 1.0


@dataclass(frozen=True, eq=False)
class Window:
    """A part of an image about a shape, in which the shape moves before the table and other shapes."""

    image: DisparityImage
    box: Box
    rest: np.ndarray
    """(h, w) [px] exact disparities of the table and the other shapes."""
    scale: float
    """Measured over true depth."""

    @property
    def measured(self) -> np.ndarray:
        """(h, w) [px]; 0 for no return."""
        return self.image.measured[self.box.window]

    def cropped(self, box: Box) -> Window:
        """The window with fewer pixels. box: all in this one."""
        rows = slice(box.top - self.box.top, box.bottom - self.box.top)
        columns = slice(box.left - self.box.left, box.right - self.box.left)
        found = Window(self.image, box, self.rest[rows, columns], self.scale)
        vars(found)["_without"] = tuple(each[rows, columns] for each in self._without)  # computed once for all of them
        return found

    def exact(self, shape: StandingShape) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) [px] exact disparities with a shape, and (h, w) bool: where it is seen."""
        near = self.image.rendered([shape], self.box, self.scale)
        return np.maximum(near, self.rest), (near > 0) & (near >= self.rest)

    def compared(self, inside: np.ndarray, used: np.ndarray | None = None) -> np.ndarray:
        """(h, w) bool: pixels with a return in and about a shape. inside: (h, w) bool, of the shape; used: (H, W)."""
        compared = (maximum_filter(inside, 2 * SEEN + 1) > 0) & (self.measured > 0)
        return compared if used is None else compared & used[self.box.window]

    def explained(self, shape: StandingShape, used: np.ndarray | None = None) -> Explained:
        """What a shape explains that table and others do not, and what they all leave unexplained about it.

        used: (H, W) bool, the pixels that are compared; all if None.
        """
        exact, inside = self.exact(shape)
        compared = self.compared(inside, used)
        if not compared.any():
            return Explained(0.0, 0.0, 0)
        left = self._unexplained(*self.image.expected(exact), compared)
        return Explained(self._unexplained(*self._without, compared) - left, left, int(compared.sum()))

    @cached_property
    def _without(self) -> tuple[np.ndarray, np.ndarray]:
        return self.image.expected(self.rest)

    def _unexplained(self, mean: np.ndarray, variance: np.ndarray, compared: np.ndarray) -> float:
        """The pixels among some that are not explained, after the slow error that explains the most is taken away."""
        total = variance + self.image.noise**2
        return float(unexplained(self.measured - mean, total, compared, CORRELATED / (REACH * self.image.bend) ** 2))


@compiled
def expected_edges(exact, shares, jumps, extension, ramp):
    """The mean and variance (h, w) of what a stereo camera makes of exact disparities at their edges.

    Args:
        exact: (h + 2, w + 2) float32 [px] with a border.
        shares: (k, 1, 1) float32 of what it may do, the share of the largest extension.
        jumps: (k, 1, 1) float32 [px] up to which it then blends.
        extension: [px] the largest.
        ramp: [px] half the width of a ramp.
    """
    rows, columns = exact.shape
    mean, variance = np.zeros((rows - 2, columns - 2)), np.zeros((rows - 2, columns - 2))
    half, size = np.full((1, 1), np.float32(ramp)), max(rows, columns)
    for k in range(len(shares)):
        found = blended_ramps(widened_edges(exact, shares[k], jumps[k], size, extension), jumps[k], half, size)
        for v in range(rows - 2):
            for u in range(columns - 2):
                value = np.float64(found[v + 1, u + 1])
                mean[v, u] += value / len(shares)
                variance[v, u] += value * value / len(shares)
    for v in range(rows - 2):
        for u in range(columns - 2):
            variance[v, u] = max(variance[v, u] - mean[v, u] ** 2, 0.0)
    return mean, variance


@compiled
def unexplained(residual, total, compared, certainty):
    """The number of pixels that are not explained, after a slow error (a constant and two slopes) is taken away.

    Args:
        residual: (h, w) [px] measured less expected disparities.
        total: (h, w) [px^2] their variances.
        compared: (h, w) bool, the pixels that count.
        certainty: [1/px^2] of a slow error of 0, in units of the weight of one pixel.
    """
    rows, columns = residual.shape
    slow = np.zeros(3)
    for _ in range(SLOW_ROUNDS):
        g, gx, gy = 0.0, 0.0, 0.0
        w, wx, wy, wxx, wxy, wyy = certainty, 0.0, 0.0, certainty, 0.0, certainty
        a, b, c = slow
        for v in range(rows):
            y = 2 * v / rows - 1
            for u in range(columns):
                if compared[v, u]:
                    x, r, limit = 2 * u / columns - 1, residual[v, u], total[v, u] * REACH**2
                    share = min((r - a - b * x - c * y) ** 2 / limit, 1.0)
                    weight = (1 - share) ** 2 / limit  # Tukey's, see `tukey_weights`
                    w, wx, wy = w + weight, wx + weight * x, wy + weight * y
                    wxx, wxy, wyy = wxx + weight * x * x, wxy + weight * x * y, wyy + weight * y * y
                    g, gx, gy = g + weight * r, gx + weight * r * x, gy + weight * r * y
        slow = solve_positive(np.array(((w, wx, wy), (wx, wxx, wxy), (wy, wxy, wyy))), np.array((g, gx, gy)))
    left = certainty * (slow * slow).sum()
    a, b, c = slow
    for v in range(rows):
        for u in range(columns):
            if compared[v, u]:
                off = residual[v, u] - a - b * (2 * u / columns - 1) - c * (2 * v / rows - 1)
                left += min(off**2 / (total[v, u] * REACH**2), 1.0)
    return left


def slow_errors(compared: np.ndarray) -> np.ndarray:
    """(3, n) a constant and slopes across and down at the n pixels (h, w) bool that are compared."""
    v, u = np.nonzero(compared)
    rows, columns = compared.shape
    return np.stack([np.ones(len(v)), 2 * u / columns - 1, 2 * v / rows - 1])
