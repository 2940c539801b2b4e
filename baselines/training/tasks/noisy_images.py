"""Noisy images to learn from: by the d415 of data 1.0.0, or as measured on real ones, in wider ranges than in data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kit1000.errors import InputError
from kit1000.perception.calibration import CALIBRATED
from kit1000.sim.measured_sensors import MEASURED_SENSORS, DepthSensor, conditions_of, measured_view, with_calibration
from kit1000.sim.sensors import measured
from kit1000.values import View

SENSOR_MODELS = (1, 2)
WIDER = replace(
    with_calibration(MEASURED_SENSORS["d415"], scale_error=5e-4, position_error=5e-4, rotation_error_deg=0.03),
    amplitude_px=(0.05, 0.35),
    bending_px=(0.02, 0.14),
    ramp_px=(2.5, 10.0),
    ramp_half_px=(2.5, 5.5),
    hole_share=(0.0, 0.5),
    aligned_share=0.3,
)
"""The measured d415 once the table has calibrated it; bent planes leave more errors of pose and scale."""
WINDOWS = (0.75, 1.35)  # range of a factor on the windows of noise: networks read its correlation
FRAMES = (1, 1, 1, 1, 1, 3, 10, 30)  # of which an image is the mean, each in an equal share


def noisy_view(view: View, rng: np.random.Generator, sensor_model: int = 1) -> View:
    """What a d415, calibrated by the table, sees of an ideal view.

    sensor_model: 1 that of data 1.0.0; 2 as measured, under conditions drawn in wider ranges.
    """
    if sensor_model not in SENSOR_MODELS:
        raise InputError(f"sensor_model: expected one of {SENSOR_MODELS}, got {sensor_model}")
    if sensor_model == 1:
        return measured(CALIBRATED, view, rng)
    frames = FRAMES[int(rng.integers(len(FRAMES)))]
    sensor = with_windows(WIDER, *rng.uniform(*WINDOWS, 2))
    return measured_view(sensor, view, conditions_of(sensor, rng, frames), rng)


def with_windows(sensor: DepthSensor, fine: float, coarse: float) -> DepthSensor:
    """The sensor with its windows of fine and of coarse noise a factor as wide, in odd numbers of pixels."""
    fine_across, fine_down = (_odd(fine * width) for width in sensor.fine_windows)
    coarse_across, coarse_down = (_odd(coarse * width) for width in sensor.coarse_windows)
    windows = {"fine_windows": (fine_across, fine_down), "coarse_windows": (coarse_across, coarse_down)}
    return replace(sensor, **windows)


def _odd(width: float) -> int:
    return 2 * int(width // 2) + 1
