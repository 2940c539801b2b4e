"""Depth sensors with the errors of real ones, measured on public images: a stereo camera, a structured-light scanner.

What a sensor does differs from image to image: amplitude, bending, unit, stream, ramps and holes are drawn for each
(`conditions_of`), the rest belongs to the sensor. Errors come in the order of the real device, in disparity =
fx * baseline / depth: fattened edges, ramps at small jumps, no return in shadows, in holes beside jumps and at grazing
angles, noise, bending, rounding; then depth scale, range, and the grid of stored depths.

Sources: "images" are the public D415, D435 and PhoXi images of docs/reference/sensors.md, whose statistics
results/sensor-statistics.json compares with the statistics of these sensors; other sources are named beside the
numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.sim.depth_edges import blended_ramps, depths_of, punch_holes, widen_shadows, widened_edges
from kit1000.sim.noise_fields import add_enlarged, smooth_field, uniform_of, windowed_noise
from kit1000.sim.stereo import disparity_from_depth, grazing_mask, occlusion_mask
from kit1000.values import View

DEPTH_GRID = 2.0**-13  # [m] 0.12 mm: step of stored depths, exact in float32; halves their size on disk

Stream = Literal["raw", "aligned"]
"""raw: the image of the left imager; aligned: transferred to the colour camera beside it."""

COARSE = 2  # px a value of the fields that vary over some 10 px: coarse noise, extensions, holes, grazing losses
SMOOTH = 4  # px a value of those that vary along an edge
BENT = 8  # px a value of bending
PATCH, ALONG = 5, 7  # windows of these fields in their own pixels
DRAWN_DECIMALS = 9  # of numbers that are drawn: the last bits of powers differ between processors


@dataclass(frozen=True)
class Sensor:
    """The facts of a sensor and the ranges of its errors; the defaults describe an ideal sensor."""

    baseline: float = 0.0
    """[m] from the imager of the raw image to the other imager, or the projector; 0: no triangulation."""
    side: int = 1
    """1: the other one is on the right, so shadows lie on the left of near bodies; -1: the other way round."""
    convergence: float = math.inf
    """[m] distance at which the optical axes of the two cross; inf: they are parallel."""
    colour_offset: float = 0.0
    """[m] from the colour camera to the imager of the raw image, along +x: for aligned streams."""
    colour_inset_px: tuple[int, int] = (0, 0)
    """Columns and rows at each border of an aligned image that the raw one does not see."""
    amplitude_px: tuple[float, float] = (0.0, 0.0)
    """RMS of the noise of one frame [px], log-uniform."""
    fixed_share: tuple[float, float] = (0.0, 0.0)
    """Share of the noise's variance that is the same in every frame of a motionless scene."""
    fine_windows: tuple[int, int] = (1, 1)
    """[px] across and down: the fine noise is white noise under two such windows in succession."""
    coarse_windows: tuple[int, int] = (1, 1)
    """The same of the coarse noise, in steps of COARSE px."""
    coarse_share: float = 0.0
    """Share of the coarse noise in the noise's variance."""
    bending_px: tuple[float, float] = (0.0, 0.0)
    """RMS of the bending of planes at an amplitude of BENDING_AT px [px]; it grows with the root of the amplitude."""
    bending_window: int = 1
    """[px] odd, in steps of BENT px: bending is white noise under three such windows in succession."""
    least_ramp_px: float = 0.0
    """[px] of disparity: smaller jumps always become ramps."""
    ramp_px: tuple[float, float] = (0.0, 0.0)
    """[px] of disparity, drawn for each image: larger jumps never do; from one to the other uniform along edges."""
    ramp_half_px: tuple[float, float] = (0.0, 0.0)
    """Half the width of a ramp [px], uniform along edges."""
    fattening_px: float = 0.0
    """Largest extension of a near surface beyond a jump that stays sharp [px]; uniform along edges, half at ramps."""
    shadow_px: int = 0
    """Width by which shadows are wider than geometry makes them [px]."""
    hole_share: tuple[float, float] = (0.0, 0.0)
    """Share of the jumps over `hole_jump_px` that have no return beside them, in patches; drawn for each image."""
    hole_jump_px: float = math.inf
    """Least jump of disparity with holes beside it [px]."""
    hole_px: int = 1
    """Largest width of such a hole [px], odd."""
    grazing_deg: tuple[float, float] = (90.0, 90.0)
    """Angles of incidence at which the probability of no return begins to rise from 0, and at which it is 1."""
    subpixel_px: float = 0.0
    """Step to which disparity is rounded in a frame [px]; 0: none."""
    units: tuple[float, ...] = (0.0,)
    """[m] steps of depth in which frames are handed out, each in an equal share of images; 0: none."""
    aligned_share: float = 0.0
    """Share of the images whose stream is aligned."""
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


BENDING_AT = 0.08  # [px]

SENSORS: dict[str, Sensor] = {
    "ideal": Sensor(),
    "d415": Sensor(
        baseline=0.055,  # data sheet of the D400 series
        colour_offset=0.015,  # extrinsics that its driver reports
        colour_inset_px=(50, 20),  # fields of view of 65 x 40 and 69 x 42 degrees, data sheet
        amplitude_px=(0.10, 0.30),  # images: from wood at 0.87 m to white plastic at 0.4 m
        fixed_share=(0.12, 0.22),  # images: variance that successive frames share below 20 px
        fine_windows=(15, 11),  # images: half at 7 to 8 px across and 5 to 6 px down on tiles of 48 px, ...
        coarse_windows=(17, 11),  # ... 8 to 11 and 6 to 7 px on tiles of 64 px
        coarse_share=0.45,
        bending_px=(0.06, 0.16),  # images: planes bent by 4 to 6 mm at 0.7 to 0.96 m
        bending_window=15,  # standard deviation 60 px
        least_ramp_px=2.5,  # images: nearly all jumps of 1 to 3 px are ramps, ...
        ramp_px=(4.5, 9.5),  # ... half to all of those of 3 to 5 px, none to all of 5 to 8 px, few beyond
        ramp_half_px=(3.0, 5.0),  # images: 4 to 6 px between both surfaces
        fattening_px=6.0,  # half the support of the fine windows
        shadow_px=2,  # images
        hole_share=(0.05, 0.35),  # images: 8 to 38 % of the other side's jumps, 26 to 71 % of those along columns
        hole_jump_px=1.5,
        hole_px=5,  # images: 1 to 9 px
        grazing_deg=(75.0, 87.0),  # assumed, as in the earlier model
        subpixel_px=1 / 32,  # Intel's white paper on the subpixel linearity of the D400
        units=(1e-3, 1e-4),  # 1 mm is the driver's default; the paper's release and others use 0.1 mm
        aligned_share=0.0,  # data hold the raw stream
        scale_error=0.003,  # the paper's own D415 was off by 0.36 % before calibration
        position_error=1.5e-3,  # a hand-eye calibration, as in the earlier model
        rotation_error_deg=0.15,
        min_depth=0.3,
        max_depth=3.0,
    ),
    "photoneo": Sensor(
        baseline=0.225,  # images: shadows of 0.76 to 0.87 px a px of jump if it were 0.27 m, and they should have 1
        side=-1,  # images: shadows lie on the right
        convergence=0.8,  # assumed: its working distance
        amplitude_px=(0.045, 0.062),  # images: 0.17 to 0.19 mm, white
        hole_share=(0.45, 0.62),  # images: 1 to 2 px at 74 to 84 % of jumps that cast no shadow
        hole_jump_px=1.5,
        grazing_deg=(80.0, 89.0),  # assumed
        scale_error=0.0003,
        position_error=0.15e-3,
        rotation_error_deg=0.015,
        min_depth=0.4,
        max_depth=2.0,
    ),
}


@dataclass(frozen=True)
class Conditions:
    """What holds for all pixels of an image."""

    noise_px: float
    """RMS of the noise of one frame."""
    fixed_share: float
    """Share of its variance that is the same in every frame."""
    bending_px: float
    """RMS."""
    unit: float
    """[m] of depth; 0: none."""
    stream: Stream
    ramp_px: float = 0.0
    """Jumps of more disparity never become ramps."""
    hole_share: float = 0.0
    """Share of the jumps that have a hole beside them."""
    frames: int = 1
    """Number of frames of which the image is the mean."""

    @property
    def left_px(self) -> float:
        """RMS of the noise that is left in the mean of the frames: what changes is divided by their root."""
        return self.noise_px * math.sqrt(self.fixed_share + (1 - self.fixed_share) / self.frames)


def on_depth_grid(depth: np.ndarray) -> np.ndarray:
    """Depths (...) float32 [m] rounded to DEPTH_GRID."""
    grid = np.float32(DEPTH_GRID)
    return np.rint(depth / grid) * grid


def sense(name: str, view: View, rng: np.random.Generator, frames: int = 1) -> View:
    """Simulate the sensor `name` of SENSORS on an ideal view, as rendered.

    Args:
        name: of the sensor.
        view: ideal depths [m].
        rng: source of all draws; their number depends only on the sensor and the image size, not on the scene.
        frames: of a motionless scene, of which the image is the mean.

    Returns:
        A view with measured depths, multiples of DEPTH_GRID, and with the recorded camera pose, which has the
        calibration error.

    Raises:
        InputError: no such sensor, or fewer frames than one.
    """
    if name not in SENSORS:
        raise InputError(f"sensor: there is no {name!r}, expected one of {', '.join(SENSORS)}")
    sensor = SENSORS[name]
    return measured_view(sensor, view, conditions_of(sensor, rng, frames), rng)


def conditions_of(sensor: Sensor, rng: np.random.Generator, frames: int = 1) -> Conditions:
    """Draw what holds for all pixels of an image that is the mean of some frames; always seven draws."""
    amplitude, fixed, bend, unit, aligned, ramp, holes = rng.random(7)
    low, high = sensor.amplitude_px
    noise = round(low * (high / low) ** amplitude, DRAWN_DECIMALS) if low > 0 else 0.0
    bending = _between(sensor.bending_px, bend) * math.sqrt(noise / BENDING_AT)
    return Conditions(
        noise_px=noise,
        fixed_share=_between(sensor.fixed_share, fixed),
        bending_px=bending,
        unit=sensor.units[int(unit * len(sensor.units))],
        stream="aligned" if aligned < sensor.aligned_share else "raw",
        ramp_px=_between(sensor.ramp_px, ramp),
        hole_share=_between(sensor.hole_share, holes),
        frames=frames,
    )


def _between(ends: tuple[float, float], share: float) -> float:
    return ends[0] + (ends[1] - ends[0]) * share


def measured_view(sensor: Sensor, view: View, conditions: Conditions, rng: np.random.Generator) -> View:
    """What a sensor measures of an ideal view under some conditions, as by `sense`."""
    scale = np.float32(1 + sensor.scale_error * rng.uniform(-1, 1))
    recorded = _recorded_pose(sensor, view.world_from_camera, rng)
    depth = scale * _measured_depth(sensor, view, conditions, rng)
    depth[(depth < sensor.min_depth) | (depth > sensor.max_depth)] = 0
    return View(view.camera, recorded, on_depth_grid(depth))


def with_calibration(
    sensor: Sensor, scale_error: float = 0.0, position_error: float = 0.0, rotation_error_deg: float = 0.0
) -> Sensor:
    """The sensor with other errors of scale and recorded pose, see `Sensor`; none by default."""
    return replace(
        sensor, scale_error=scale_error, position_error=position_error, rotation_error_deg=rotation_error_deg
    )


def _recorded_pose(sensor: Sensor, world_from_camera: Pose, rng: np.random.Generator) -> Pose:
    """The pose with its calibration error, which is drawn in the camera frame."""
    rotvec, shift = rng.standard_normal((2, 3)) / math.sqrt(3)
    if sensor.position_error == 0 and sensor.rotation_error_deg == 0:
        return world_from_camera
    rotvec *= math.radians(sensor.rotation_error_deg)
    return world_from_camera @ Pose.from_rotvec(rotvec, sensor.position_error * shift)


def _measured_depth(sensor: Sensor, view: View, conditions: Conditions, rng: np.random.Generator) -> np.ndarray:
    """Depths (H, W) float32 [m] from disparities with noise; 0 for no return."""
    if sensor.baseline == 0:
        return view.depth
    camera, noise = view.camera, _noise(sensor, view.depth.shape, conditions, rng)
    gain = np.float32(camera.fx * sensor.baseline)  # [px m] disparity x depth
    patches = [smooth_field(rng, _coarse(view.depth.shape, COARSE), PATCH) for _ in range(4)]
    along = [smooth_field(rng, _coarse(view.depth.shape, SMOOTH), ALONG) for _ in range(2)]
    extension, chance, size, loss = patches
    true = disparity_from_depth(view.depth, gain)
    d = true
    edge = _spread((sensor.least_ramp_px, conditions.ramp_px), along[0])
    if sensor.fattening_px > 0:
        d = widened_edges(d, uniform_of(extension), _every_other(edge, extension.shape), COARSE, sensor.fattening_px)
    jumps = d
    if conditions.ramp_px > 0:
        d = blended_ramps(d, edge, _spread(sensor.ramp_half_px, along[1]), SMOOTH)
    missing = _shadows(sensor, jumps, camera.fx, conditions.stream)
    if conditions.hole_share > 0:
        chances, sizes = uniform_of(chance), uniform_of(size)
        punch_holes(missing, jumps, chances, sizes, COARSE, sensor.hole_jump_px, conditions.hole_share, sensor.hole_px)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    missing |= grazing_mask(true, intrinsics, loss, *np.radians(sensor.grazing_deg))
    single = conditions.frames == 1  # rounding averages out, for noise moves each frame by more than a step
    step, unit = (sensor.subpixel_px, conditions.unit) if single else (0.0, 0.0)
    return depths_of(d, noise, missing, np.float32(step), np.float32(unit), gain)


def _noise(sensor: Sensor, shape: tuple[int, int], conditions: Conditions, rng: np.random.Generator) -> np.ndarray:
    """(H, W) float32 [px]: fine and coarse noise and bending."""
    noise = windowed_noise(rng, shape, sensor.fine_windows)
    noise *= np.float32(conditions.left_px * math.sqrt(1 - sensor.coarse_share))
    if sensor.coarse_share > 0:
        coarse = windowed_noise(rng, _coarse(shape, COARSE), sensor.coarse_windows)
        add_enlarged(noise, coarse, COARSE, np.float32(conditions.left_px * math.sqrt(sensor.coarse_share)))
    if sensor.bending_px[1] > 0:
        bending = smooth_field(rng, _coarse(shape, BENT), sensor.bending_window)
        add_enlarged(noise, bending, BENT, np.float32(conditions.bending_px))
    return noise


def _shadows(sensor: Sensor, d: np.ndarray, fx: float, stream: Stream) -> np.ndarray:
    """Pixels (bool, with the border) that one of the imagers does not see, and those beside them."""
    seen_from = d if sensor.side > 0 else np.ascontiguousarray(d[:, ::-1])
    shift = fx * sensor.baseline / sensor.convergence
    if stream == "raw":
        missing = occlusion_mask(seen_from, shift)
    else:
        offset = sensor.colour_offset / sensor.baseline  # of one imager; the other one is a baseline farther
        missing = occlusion_mask(seen_from * np.float32(1 + offset), shift)
        missing |= occlusion_mask(seen_from * np.float32(offset), 0.0)
        missing |= _outside_raw(seen_from * np.float32(1 + offset), sensor.colour_inset_px)
    if sensor.shadow_px > 0:
        widen_shadows(missing, seen_from, sensor.shadow_px)
    return missing if sensor.side > 0 else np.ascontiguousarray(missing[:, ::-1])


def _outside_raw(d: np.ndarray, inset: tuple[int, int]) -> np.ndarray:
    """Pixels (bool, with the border) of an aligned image that the imagers, of a narrower view, do not see."""
    columns, rows = inset
    place = np.arange(d.shape[1], dtype=np.float32) - d
    outside = (place < columns) | (np.arange(d.shape[1]) >= d.shape[1] - columns)
    outside[: rows + 1] = True
    outside[d.shape[0] - rows - 1 :] = True
    return outside & (d > 0)


def _coarse(shape: tuple[int, int], factor: int) -> tuple[int, int]:
    """The shape of a field with one value in `factor` px of an image of some shape."""
    return -(-shape[0] // factor), -(-shape[1] // factor)


def _every_other(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A field of SMOOTH px a value as one of COARSE px a value, of some shape."""
    factor = SMOOTH // COARSE
    return np.ascontiguousarray(field.repeat(factor, 0).repeat(factor, 1)[: shape[0], : shape[1]])


def _spread(ends: tuple[float, float], field: np.ndarray) -> np.ndarray:
    """A standard normal field as one that is uniform between two ends."""
    low, high = (np.float32(end) for end in ends)
    return low + (high - low) * uniform_of(field)
