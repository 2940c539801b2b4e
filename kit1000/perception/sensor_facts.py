"""Facts about the sensor of a depth image that perception needs: those of simulated sensors, or of the user's own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeAlias

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.sim.sensors import SENSORS, Sensor, Stream

D415, SCANNER = SENSORS["d415"], SENSORS["photoneo"]
FINE = ("ideal", "photoneo")  # sensors whose edges are where they should be
KEY = "sensors"
"""Key of dataset.json: facts by the key of the view; absent from generated datasets."""
SCENE_KEY = "scene_sensors"
"""Key of dataset.json: the same by scene, where scenes of several cameras are joined."""


@dataclass(frozen=True)
class SensorFacts:
    """What is known about a sensor; the defaults are those of the simulated d415."""

    device: str = "d415"
    """Name of the camera, for people."""
    baseline: float = D415.baseline
    """[m] between its imagers."""
    fattening_px: float = D415.fattening_px
    """Largest extension of a near surface beyond its edge [px]."""
    focal_length: float | None = None
    """[px] as recorded, before the image was resampled; None: not resampled."""
    unit: float = 0.0
    """[m] step of its depths; 0: finer than that of recordings."""
    noise_px: float = D415.amplitude_px[1]
    """[px] of disparity: noise and bending of the table together."""
    stream: Stream = "raw"
    """raw: the image of its own left imager, with the invalid depth band; aligned: another camera's."""
    simulated_table: bool = True
    """Whether the table is that of generated scenes, 1.2 m x 1.6 m about the origin."""
    scanner: bool = False
    """Whether it is a structured-light scanner, whose edges are where they should be, and no stereo camera."""

    def as_row(self) -> dict[str, Any]:
        """The facts as a JSON value."""
        return asdict(self)


AnySensor: TypeAlias = "str | SensorFacts"
"""A simulated sensor by its name, or the facts about another one."""


def sensor_of(summary: Mapping[str, Any], sensor: str, scene_id: str = "") -> AnySensor:
    """The facts that a dataset.json states about the sensor of a view, by its key; the key where it states none.

    scene_id: scene of the view, of which it may state others than of the rest.
    """
    rows = (summary.get(SCENE_KEY) or {}).get(scene_id) or summary.get(KEY) or {}
    if sensor not in rows:
        return sensor
    try:
        return SensorFacts(**rows[sensor])
    except TypeError as error:
        raise InputError(f"dataset.json: facts of {sensor} cannot be read ({error}); import again") from None


def model_of(sensor: AnySensor) -> Sensor:
    """The sensor model: how far disparities and edges are off."""
    if isinstance(sensor, str):
        return SENSORS[sensor]
    model = SCANNER if sensor.scanner else D415
    return replace(model, baseline=sensor.baseline, fattening_px=sensor.fattening_px)


def key_of(sensor: AnySensor) -> str:
    """The simulated sensor as whose images those of a sensor are read: the key of its views, and in names of tracks."""
    if isinstance(sensor, str):
        return sensor
    return "photoneo" if sensor.scanner else "d415"


def gain_of(camera: Camera, sensor: AnySensor) -> float:
    """[px m] disparity times depth; 0 of an ideal sensor."""
    return camera.fx * model_of(sensor).baseline


def needs_restoring(sensor: AnySensor) -> bool:
    """Whether its edges are bent and its noise reaches far, as those of stereo cameras do."""
    return key_of(sensor) not in FINE


def table_is_simulated(sensor: AnySensor) -> bool:
    """Whether the table is that of generated scenes, 1.2 m x 1.6 m about the origin."""
    return isinstance(sensor, str) or sensor.simulated_table
