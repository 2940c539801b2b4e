"""Facts about the sensor of a depth image that perception needs: of simulated sensors, and of a user's own camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.perception import image_kinds
from kit1000.perception.image_kinds import ImageKind
from kit1000.sim.sensors import SENSORS, Stream

D415, SCANNER = SENSORS["d415"], SENSORS["photoneo"]
KEY = "sensors"
"""Key of dataset.json: facts by the key of the view; absent from generated datasets."""
SCENE_KEY = "scene_sensors"
"""Key of dataset.json: the same by scene, if scenes of several cameras are joined."""


@dataclass(frozen=True)
class SensorFacts:
    """What is known about a sensor; the defaults are those of the simulated d415."""

    device: str = "d415"
    """Name of the camera, for people."""
    baseline: float = D415.baseline
    """[m] between its imagers; 0: the depths are exact."""
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
    """Whether it is a structured-light scanner, which keeps edges sharp, and no stereo camera."""
    height_ratio: float | None = None
    """Measured over stated height of the camera above its table; None: no pose was stated."""

    @property
    def kind(self) -> ImageKind:
        """The kind of its images."""
        if self.baseline == 0:
            return image_kinds.IDEAL
        return image_kinds.PHOTONEO if self.scanner else image_kinds.D415

    def as_row(self) -> dict[str, Any]:
        """The facts as a JSON value."""
        return asdict(self)

    def gain(self, camera: Camera) -> float:
        """[px m] disparity times depth in the images of a camera; 0 of an exact sensor."""
        return camera.fx * self.baseline


def simulated_sensor(name: str) -> SensorFacts:
    """The facts about a sensor of `kit1000.sim.sensors.SENSORS`; its errors decide of which kind its images are."""
    sensor = SENSORS[name]
    return SensorFacts(
        device=name,
        baseline=sensor.baseline,
        fattening_px=sensor.fattening_px,
        noise_px=sensor.amplitude_px[1],
        scanner=sensor.baseline > 0 and sensor.fattening_px == 0,
    )


def sensor_of(summary: Mapping[str, Any], sensor: str, scene_id: str = "") -> SensorFacts:
    """The facts about the sensor of a view: those that dataset.json states, else those of the simulated sensor.

    Args:
        summary: dataset.json.
        sensor: key of the view.
        scene_id: scene of the view; joined folders state facts by scene.

    Raises:
        InputError: dataset.json states facts of another version.
    """
    rows = (summary.get(SCENE_KEY) or {}).get(scene_id) or summary.get(KEY) or {}
    if sensor not in rows:
        return simulated_sensor(sensor)
    try:
        return SensorFacts(**rows[sensor])
    except TypeError as error:
        raise InputError(f"dataset.json: facts of {sensor} cannot be read ({error}); import again") from None
