"""The disparity image that a sensor is expected to measure of known shapes on a table, and how well it does.

A stereo camera extends near surfaces beyond their edges by an amount that varies along the edge, and blends small jumps
into ramps. So a pixel beside an edge has a mean and a variance over what the sensor may do; `kit1000.sim.depth_edges`
does it for a few amounts. A scanner keeps edges sharp to a pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter

from kit1000.camera import Camera
from kit1000.known_shapes.shapes import StandingShape
from kit1000.known_shapes.support import Support
from kit1000.perception.sensor_facts import D415, SensorFacts
from kit1000.pose import Pose
from kit1000.sim.depth_edges import blended_ramps, widened_edges
from kit1000.sim.render import render
from kit1000.values import LabelledDepth

AMOUNTS = ((1 / 8, 3.0), (3 / 8, 6.0), (5 / 8, 3.0), (7 / 8, 6.0))
"""What the sensor may do beside an edge: share of its largest extension, and the jump [px] up to which it blends."""
RAMP_HALF = 4.0  # [px] half the width of a ramp
SHARP = 3  # [px] side of a window in which a pixel of a sharp image may show either side of an edge
LEAST_NOISE, LEAST_BEND = 0.05, 0.03  # [px]
SEEN = 12  # [px] about a shape, of the pixels that tell where it is
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
        return replace(self, camera=small, measured=measured, extension=self.extension / 2, ramp=self.ramp / 2)

    @cached_property
    def table(self) -> np.ndarray:
        """(H, W) [px] the disparities of the table."""
        camera, normal = self.camera, self.support.normal
        u, v = np.arange(camera.width) - camera.cx, np.arange(camera.height) - camera.cy
        slope = normal[0] * u[None] / camera.fx + normal[1] * v[:, None] / camera.fy + normal[2]
        return self.gain * slope / self.support.offset

    def box(self, shape: StandingShape) -> Box:
        """The window about a shape."""
        corners = shape.camera_from_body().apply(shape.shape.mesh.vertices)
        uv, (height, width) = self.camera.project(corners), self.measured.shape
        (left, top), (right, bottom) = np.floor(uv.min(0)).astype(int) - MARGIN, np.ceil(uv.max(0)).astype(int) + MARGIN
        clip = (top, bottom + 1, left, right + 1), (height, height, width, width)
        return Box(*(int(np.clip(end, 0, most)) for end, most in zip(*clip, strict=True)))

    def rendered(self, shapes: Sequence[StandingShape], box: Box, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) [px] exact disparities of shapes and table in a window, and (h, w) bool: where the first shape is."""
        camera, (height, width) = self.camera, (box.bottom - box.top, box.right - box.left)
        window = Camera(width, height, camera.fx, camera.fy, camera.cx - box.left, camera.cy - box.top)
        bodies = [(each.shape.mesh, each.camera_from_body(scale)) for each in shapes]
        image = render(window, Pose.identity(), bodies, threads=1)
        depth = scale * image.depth.astype(float)
        near = np.where(depth > 0, self.gain / np.where(depth > 0, depth, 1.0), 0.0)
        return np.maximum(near, self.table[box.window]), image.body_ids == 1

    def expected(self, exact: np.ndarray, blur: int = SHARP) -> tuple[np.ndarray, np.ndarray]:
        """The mean and variance (h, w) of what the sensor makes of exact disparities (h, w) at their edges.

        blur: [px] side of the window over which the edges of a sharp image may lie.
        """
        if self.extension == 0:
            mean = uniform_filter(exact, blur)
            return mean, np.maximum(uniform_filter(exact * exact, blur) - mean * mean, 0.0)
        padded, size = np.pad(exact, 1, mode="edge").astype(np.float32), max(exact.shape) + 2
        found = []
        for share, jump in AMOUNTS:
            one = [np.full((1, 1), value, np.float32) for value in (share, jump, self.ramp)]
            wide = widened_edges(padded, one[0], one[1], size, self.extension)
            found.append(blended_ramps(wide, one[1], one[2], size)[1:-1, 1:-1])
        several = np.stack(found).astype(float)
        return several.mean(0), several.var(0)

    def misfit(
        self,
        shape: StandingShape,
        others: Sequence[StandingShape] = (),
        scale: float = 1.0,
        used: np.ndarray | None = None,
    ) -> float:
        """What a shape and those beside it leave unexplained about it: 0 for nothing, 1 for all pixels.

        used: (H, W) bool, the pixels that are compared; all if None.
        """
        box = self.box(shape)
        exact, inside = self.rendered([shape, *others], box, scale)
        compared = self.compared(box, inside, used)
        if not compared.any():
            return 1.0
        return float(self._unexplained(exact, box)[compared].mean())

    def gain_of(
        self, shape: StandingShape, others: Sequence[StandingShape] = (), used: np.ndarray | None = None
    ) -> float:
        """The number of pixels that a shape explains and that others and the table do not, less those that it spoils.

        used: (H, W) bool, the pixels that are compared; all if None.
        """
        box = self.box(shape)
        exact, inside = self.rendered([shape, *others], box, 1.0)
        without = self.rendered(others, box, 1.0)[0] if others else self.table[box.window]
        compared = self.compared(box, inside, used)
        return float((self._unexplained(without, box) - self._unexplained(exact, box))[compared].sum())

    def _unexplained(self, exact: np.ndarray, box: Box) -> np.ndarray:
        mean, variance = self.expected(exact)
        square = np.square(self.measured[box.window] - mean) / (variance + self.noise**2 + self.bend**2)
        return np.minimum(square / REACH**2, 1.0)

    def compared(self, box: Box, inside: np.ndarray, used: np.ndarray | None) -> np.ndarray:
        """(h, w) bool: pixels with a return in and about a shape. inside: (h, w) bool, of the shape; used: (H, W)."""
        compared = np.asarray(binary_dilation(inside, iterations=SEEN), bool) & (self.measured[box.window] > 0)
        return compared if used is None else compared & used[box.window]
