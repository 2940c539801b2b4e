"""Simulated depth sensors: pure functions from an ideal view to what a D415 or a structured-light scanner measures.

Two imagers side by side, or an imager and a projector, triangulate: disparity = fx * baseline / depth. Errors are
applied to the disparity, in the order of the real device: edge fattening, blending by the matching window, no return in
shadows and at grazing angles, noise, quantisation; then depth scale, range, and the grid of stored depths. Sources:
docs/reference/sensors.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

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

DEPTH_GRID = 2.0**-13  # [m] 0.12 mm: step of stored depths, exact in float32; halves their size on disk


@dataclass(frozen=True)
class Sensor:
    """The parameters of a sensor; the defaults are those of an ideal one."""

    baseline: float = 0.0
    """[m] from the imager of the depth image to the other imager (or projector), along +x; 0: no triangulation."""
    convergence: float = math.inf
    """[m] distance at which the optical axes of the two imagers cross; inf: they are parallel."""
    noise_px: float = 0.0
    """RMS noise of the disparity of one frame [px]."""
    fixed_noise: float = 1.0
    """Share of that RMS that is the same in every frame of a scene."""
    window_px: int = 1
    """Side of the matching window [px], odd. Detail is blended over one window; noise has the correlation of two in
    succession, one that describes pixels and one that compares the descriptions."""
    quantisation_px: float = 0.0
    """Step to which disparity is rounded [px]; 0: no rounding."""
    fattening_px: float = 0.0
    """Largest extension of a near surface beyond its edge [px]; it is uniform from 0."""
    grazing_deg: tuple[float, float] = (90.0, 90.0)
    """Angles of incidence at which the probability of no return begins to rise from 0, and at which it is 1."""
    scale_error: float = 0.0
    """Half width of the uniform relative error of all depths of an image."""
    position_error: float = 0.0
    """[m] RMS length of the error of the recorded camera position; normal, isotropic."""
    rotation_error_deg: float = 0.0
    """RMS angle of the error of the recorded camera rotation; rotation vector normal, isotropic."""
    min_depth: float = 0.0
    """[m] smallest depth that gives a return."""
    max_depth: float = math.inf
    """[m] largest depth that gives a return."""


SENSORS: dict[str, Sensor] = {
    "ideal": Sensor(),
    "d415": Sensor(
        baseline=0.055,  # data sheet of the D400 series
        noise_px=0.08,  # Intel's own advice for the RMS subpixel error of a D400
        fixed_noise=1 / 3,  # Intel: averaging over time improves a motionless scene "about 3x"
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
        baseline=0.27,  # assumed, for a scanner with a working distance of 0.8 m, where the two axes cross
        convergence=0.8,
        noise_px=0.04,  # 0.1 mm at 0.8 m: this and the next errors are a tenth of the D415's, as 0.5 mm is of 5 mm
        window_px=3,  # assumed: light smoothing of measurements that are made per pixel
        grazing_deg=(80.0, 89.0),  # assumed
        scale_error=0.0003,
        position_error=0.15e-3,
        rotation_error_deg=0.015,
        min_depth=0.4,
        max_depth=2.0,
    ),
}


def on_depth_grid(depth: np.ndarray) -> np.ndarray:
    """Depths (...) float32 [m] rounded to DEPTH_GRID."""
    grid = np.float32(DEPTH_GRID)
    return np.rint(depth / grid) * grid


def sense(name: str, view: View, rng: np.random.Generator, frames: int = 1) -> View:
    """Simulate the sensor `name` on an ideal view, as rendered; the image is the median of a number of frames.

    Returns a view with measured depths, multiples of DEPTH_GRID, and with the recorded camera pose, which has the
    calibration error. The number of random draws depends only on the sensor and the image size, not on the scene.
    """
    if name not in SENSORS:
        raise InputError(f"sensor: there is no {name!r}, expected one of {', '.join(SENSORS)}")
    return measured(sensor_of_frames(SENSORS[name], frames), view, rng)


def measured(sensor: Sensor, view: View, rng: np.random.Generator) -> View:
    """What one frame of a sensor measures of an ideal view, as by `sense`."""
    scale = np.float32(1 + sensor.scale_error * rng.uniform(-1, 1))
    recorded_pose = _recorded_pose(sensor, view.world_from_camera, rng)
    depth = scale * (_measured_depth(sensor, view, rng) if sensor.baseline > 0 else view.depth)
    depth[(depth < sensor.min_depth) | (depth > sensor.max_depth)] = 0
    return View(view.camera, recorded_pose, on_depth_grid(depth))


def sensor_of_frames(sensor: Sensor, frames: int) -> Sensor:
    """The sensor whose single frames are like medians of some frames: only noise that changes in time is smaller.

    The median of n normal values has the variance pi / (2 n) for many, 1 for one; the expression is between these.
    """
    if frames < 1:
        raise InputError(f"frames: expected 1 or more, got {frames}")
    fixed, variance = sensor.fixed_noise**2, 1 / (1 + (frames - 1) * 2 / math.pi)
    return replace(sensor, noise_px=sensor.noise_px * math.sqrt(fixed + (1 - fixed) * variance))


def _recorded_pose(sensor: Sensor, world_from_camera: Pose, rng: np.random.Generator) -> Pose:
    """The pose with its calibration error, which is drawn in the camera frame."""
    rotvec, shift = rng.standard_normal((2, 3)) / math.sqrt(3)
    if sensor.position_error == 0 and sensor.rotation_error_deg == 0:
        return world_from_camera
    rotvec *= math.radians(sensor.rotation_error_deg)
    return world_from_camera @ Pose.from_rotvec(rotvec, sensor.position_error * shift)


def _measured_depth(sensor: Sensor, view: View, rng: np.random.Generator) -> np.ndarray:
    """Depths (H, W) float32 [m] from noisy disparities; 0 for no return."""
    camera, depth = view.camera, view.depth
    gain = camera.fx * sensor.baseline  # [px m] disparity x depth
    half = ((camera.height + 1) // 2, (camera.width + 1) // 2)
    noise, extension, loss = (_correlated_noise(sensor, shape, rng) for shape in (depth.shape, half, half))
    true = disparity_from_depth(depth, np.float32(gain))
    fattened = fatten_edges(true, extension, sensor.fattening_px) if sensor.fattening_px > 0 else true
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    start, end = np.radians(sensor.grazing_deg)
    missing = occlusion_mask(fattened, gain / sensor.convergence) | grazing_mask(true, intrinsics, loss, start, end)
    noise *= np.float32(sensor.noise_px)
    blended, step = blend_windows(fattened, sensor.window_px), np.float32(sensor.quantisation_px)
    return depth_from_disparity(blended, noise, missing, step, np.float32(gain))


def _correlated_noise(sensor: Sensor, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """A standard normal field of this shape, float32, with the correlation of two windows in succession."""
    white = rng.standard_normal(shape, dtype=np.float32)
    kernel = np.ones(sensor.window_px) / sensor.window_px
    power = np.sum(np.convolve(kernel, kernel) ** 2)  # remaining variance, along one axis
    return box_blur(box_blur(white, sensor.window_px), sensor.window_px) / np.float32(power)
