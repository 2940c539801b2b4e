"""Depth sensors as pure functions of the ideal view: what a D415 or a structured-light scanner makes of it.

Two eyes side by side, or an eye and a projector, triangulate: disparity = fx * baseline / depth. Errors arise in
disparity, in the order of the machine: edges grow, windows blend, shadows and grazing surfaces give no return,
noise, quantisation; then scale, range, and the grid on which depth images are stored. Sources: docs/sensors.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.sim.stereo import (
    blend_windows,
    box_blur,
    depth_from_disparity,
    disparity_from_depth,
    fatten_edges,
    grazing_mask,
    occlusion_mask,
)
from kit1000.values import View

DEPTH_GRID = 2.0**-13  # [m] 0.12 mm: depths on it are exact in float32 and take half the space on disk


@dataclass(frozen=True)
class Sensor:
    """The numbers of a sensor; the defaults are those of a perfect one."""

    baseline: float = 0.0
    """[m] from the eye whose picture it is to the other eye (or the projector), along +x; 0: no triangulation."""
    convergence: float = math.inf
    """[m] distance at which both eyes' pictures show the same place; inf: they look in parallel."""
    noise_px: float = 0.0
    """RMS noise of the disparity [px]."""
    window_px: int = 1
    """Side of the matching window [px], odd. Detail is blended over one window; noise has the correlation of two
    in succession, one in which pixels are described and one in which the descriptions are compared."""
    quantisation_px: float = 0.0
    """Step to which disparity is rounded [px]; 0: none."""
    fattening_px: float = 0.0
    """Farthest that a near surface takes over pixels beyond its edge [px]; 0 to this, uniformly."""
    grazing_deg: tuple[float, float] = (90.0, 90.0)
    """Angles of incidence at which returns begin to fail and at which none is left."""
    scale_error: float = 0.0
    """Depths come out as one plus a number in -this .. this times themselves, uniform, one a picture."""
    position_error: float = 0.0
    """[m] RMS length of the error of the believed camera position; normal, alike along all axes."""
    rotation_error_deg: float = 0.0
    """RMS angle of the error of the believed camera rotation; rotation vector normal, alike along all axes."""
    min_depth: float = 0.0
    """[m] smallest depth that gives a return."""
    max_depth: float = math.inf
    """[m] largest depth that gives a return."""


SENSORS: dict[str, Sensor] = {
    "ideal": Sensor(),
    "d415": Sensor(
        baseline=0.055,  # data sheet of the D400 series
        noise_px=0.08,  # Intel's own advice for the RMS subpixel error of a D400
        window_px=7,  # census and box windows of the R200, the predecessor whose matcher is published
        quantisation_px=1 / 32,  # white paper on the subpixel linearity of the D400
        fattening_px=6.0,  # half the support of the two windows in succession
        grazing_deg=(75.0, 87.0),  # assumed: no figure is published
        scale_error=0.003,  # the paper's own D415 was off by 0.36 % before calibration
        position_error=1.5e-3,  # a hand-eye calibration; with the rest, the 5 mm class the paper assumes
        rotation_error_deg=0.15,
        min_depth=0.3,
        max_depth=3.0,
    ),
    "photoneo": Sensor(
        baseline=0.27,  # assumed, for a scanner that works about 0.8 m away, where its eye and projector aim
        convergence=0.8,
        noise_px=0.04,  # 0.1 mm at 0.8 m: this and the next errors are a tenth of the D415's, as 0.5 mm of 5 mm
        window_px=3,  # assumed: light smoothing of a measurement that each pixel makes by itself
        grazing_deg=(80.0, 89.0),  # assumed
        scale_error=0.0003,
        position_error=0.15e-3,
        rotation_error_deg=0.015,
        min_depth=0.4,
        max_depth=2.0,
    ),
}


def sense(name: str, view: View, rng: np.random.Generator) -> View:
    """What the sensor called `name` makes of an ideal view, as rendered.

    Returns a view with measured depths, multiples of GRID, and with the camera pose that the sensor believes.
    The true one is known to the caller. How many numbers are drawn depends on the sensor and the size of the
    picture alone, never on what is seen.
    """
    if name not in SENSORS:
        raise InputError(f"sensor: there is no {name!r}, expected one of {', '.join(SENSORS)}")
    sensor = SENSORS[name]
    scale = np.float32(1 + sensor.scale_error * rng.uniform(-1, 1))
    believed = _measured_pose(sensor, view.world_from_camera, rng)
    depth = scale * (_measured_depth(sensor, view, rng) if sensor.baseline > 0 else view.depth)
    depth[(depth < sensor.min_depth) | (depth > sensor.max_depth)] = 0
    return View(view.camera, believed, np.rint(depth / np.float32(DEPTH_GRID)) * np.float32(DEPTH_GRID))


def _measured_pose(sensor: Sensor, world_from_camera: Pose, rng: np.random.Generator) -> Pose:
    """The pose with its calibration error, which is drawn in the frame of the camera."""
    turn, shift = rng.standard_normal((2, 3)) / math.sqrt(3)
    if sensor.position_error == 0 and sensor.rotation_error_deg == 0:
        return world_from_camera
    turn *= math.radians(sensor.rotation_error_deg)
    return world_from_camera @ Pose.from_rotvec(turn, sensor.position_error * shift)


def _measured_depth(sensor: Sensor, view: View, rng: np.random.Generator) -> np.ndarray:
    """Depths (H, W) float32 [m] from noisy disparities; 0 where none is found."""
    camera, depth = view.camera, view.depth
    gain = camera.fx * sensor.baseline  # [px m] disparity x depth
    half = ((camera.height + 1) // 2, (camera.width + 1) // 2)
    noise, reach, loss = (_correlated_noise(sensor, shape, rng) for shape in (depth.shape, half, half))
    true = disparity_from_depth(depth, np.float32(gain))
    grown = fatten_edges(true, reach, sensor.fattening_px) if sensor.fattening_px > 0 else true
    lens = (camera.fx, camera.fy, camera.cx, camera.cy)
    start, gone = np.radians(sensor.grazing_deg)
    lost = occlusion_mask(grown, gain / sensor.convergence) | grazing_mask(true, lens, loss, start, gone)
    noise *= np.float32(sensor.noise_px)
    return depth_from_disparity(
        blend_windows(grown, sensor.window_px), noise, lost, np.float32(sensor.quantisation_px), np.float32(gain)
    )


def _correlated_noise(sensor: Sensor, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A standard normal field with the correlation that two windows in succession leave. float32."""
    white = rng.standard_normal(shape, dtype=np.float32)
    side = np.ones(sensor.window_px) / sensor.window_px
    power = np.sum(np.convolve(side, side) ** 2)  # variance that is left, along one axis
    return box_blur(box_blur(white, sensor.window_px), sensor.window_px) / np.float32(power)
