"""Noisy images to learn from: by d415 and scanner, under conditions drawn from wider ranges than those of datasets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kit1000.sim.sensors import SENSORS, Sensor, conditions_of, measured_view, with_calibration
from kit1000.values import View

WIDER = replace(
    with_calibration(SENSORS["d415"], scale_error=5e-4, position_error=5e-4, rotation_error_deg=0.03),
    amplitude_px=(0.05, 0.35),
    bending_px=(0.02, 0.14),
    ramp_px=(2.5, 10.0),
    ramp_half_px=(2.5, 5.5),
    hole_share=(0.0, 0.5),
    aligned_share=0.3,
)
"""The d415 once the table has calibrated it; bent planes leave more errors of pose and scale."""
SCANNER = replace(SENSORS["photoneo"], amplitude_px=(0.03, 0.1), hole_share=(0.3, 0.75))
WINDOWS = (0.75, 1.35)  # range of a factor on the windows of noise: networks read its correlation
FRAMES = (1, 1, 1, 1, 1, 3, 10, 30)  # of which an image is the mean, each in an equal share


def noisy_view(view: View, rng: np.random.Generator) -> View:
    """What a d415, calibrated by the table, sees of an ideal view."""
    frames = FRAMES[int(rng.integers(len(FRAMES)))]
    sensor = with_windows(WIDER, *rng.uniform(*WINDOWS, 2))
    return measured_view(sensor, view, conditions_of(sensor, rng, frames), rng)


def scanned_view(view: View, rng: np.random.Generator) -> View:
    """What a scanner sees of an ideal view."""
    return measured_view(SCANNER, view, conditions_of(SCANNER, rng, 1), rng)


def with_windows(sensor: Sensor, fine: float, coarse: float) -> Sensor:
    """The sensor with its windows of fine and of coarse noise a factor as wide, in odd numbers of pixels."""
    fine_across, fine_down = (_odd(fine * width) for width in sensor.fine_windows)
    coarse_across, coarse_down = (_odd(coarse * width) for width in sensor.coarse_windows)
    windows = {"fine_windows": (fine_across, fine_down), "coarse_windows": (coarse_across, coarse_down)}
    return replace(sensor, **windows)


def _odd(width: float) -> int:
    return 2 * int(width // 2) + 1
