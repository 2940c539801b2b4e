"""Facts about depth cameras by their names."""

from __future__ import annotations

import re

BASELINES = {  # [m] from the data sheets
    "D405": 0.018,
    "D415": 0.055,
    "D421": 0.050,
    "D435": 0.050,
    "D455": 0.095,
    "D456": 0.095,
}
UNITS = {"D405": 1e-4, "L515": 2.5e-4}  # [m] that 1 stands for by default, if it is not 1 mm
MILLIMETRES = re.compile(r"D4[0-9]{2}|kinect|femto|zed|oak", re.IGNORECASE)
SCANNERS = re.compile(r"phoxi|photoneo|structured.?light", re.IGNORECASE)
TIME_OF_FLIGHT = re.compile(r"kinect|l515|femto|tof|picoflexx", re.IGNORECASE)


def known_baseline(device: str) -> float | None:
    """[m] between the imagers of a camera of this name, such as Intel RealSense D435i; None if it is not known."""
    return next((baseline for name, baseline in BASELINES.items() if name in device.upper()), None)


def known_unit(device: str) -> float | None:
    """[m] that 1 in an image of integers stands for, by the name of the camera; None if it is not known."""
    special = next((unit for name, unit in UNITS.items() if name in device.upper()), None)
    return special or (1e-3 if MILLIMETRES.search(device) else None)


def is_scanner(device: str) -> bool:
    """Whether a camera of this name is a structured-light scanner."""
    return bool(SCANNERS.search(device))


def measures_time_of_flight(device: str) -> bool:
    """Whether a camera of this name measures the time of light, which blurs edges as nothing here expects."""
    return bool(TIME_OF_FLIGHT.search(device))
