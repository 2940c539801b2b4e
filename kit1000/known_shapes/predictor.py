"""The method registration-known: known shapes are registered to the image; the insertion follows from the shapes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.known_shapes.registration import SCALE_SPREAD, RegisteredBody, RegisteredScene, register_scene
from kit1000.known_shapes.shapes import KITS, KnownShape
from kit1000.perception.calibration import camera_estimate_by
from kit1000.perception.sensor_facts import SensorFacts, sensor_of
from kit1000.pose import Pose
from kit1000.predictor import PredictedMotion
from kit1000.registration.method import TrueScene, fits_in
from kit1000.registration.predictor import stated_clearances
from kit1000.values import LabelledDepth, Query, SceneShapes, TrueGeometry

CONFIDENCE_DECIMALS = 4
# Log odds that a motion is seated: constant, and weights of what part and kits leave unexplained, of the share of it
# that the part's best other pose leaves less, and of what the depth scale leaves open [mm].
ODDS = (3.0, -20.0, -1.0, -0.8)


@dataclass(frozen=True, eq=False)
class _Registered:
    """The scene of an image, in the world of its camera."""

    scene: RegisteredScene
    world_from_camera: Pose

    def world_from(self, body: RegisteredBody) -> Pose:
        return self.world_from_camera @ self.scene.camera_from_body(body)


@dataclass(frozen=True, eq=False)
class KnownShapeRegistration:
    """Predicts by the poses of known shapes."""

    dataset: Dataset
    _last: dict[tuple[str, str], _Registered] = field(default_factory=dict)

    reads = "shapes"

    def __call__(self, query: Query, shapes: SceneShapes | None, /) -> PredictedMotion:
        """The motion of the part whose registered pose is nearest to the query's pivot.

        Without a pose or an insertion: the guess or no motion, with confidence 0.
        """
        if shapes is None:
            raise InputError(f"{query.id}: registration of known shapes needs the shapes of the scene: give --shapes")
        nothing = PredictedMotion(Pose.identity() if query.guess is None else query.guess, 0.0)
        try:
            found = self._registered(query, shapes)
        except InputError:
            return nothing
        kits, *parts = found.scene.bodies
        if not parts:
            return nothing
        part = min(parts, key=lambda body: float(np.linalg.norm(self._middle(found, body) - query.pivot)))
        geometry = TrueGeometry(
            shapes.parts[part.name], found.world_from(part), shapes.assembly, found.world_from(kits)
        )
        fits = fits_in(TrueScene(query, geometry), stated_clearances(self.dataset))
        return PredictedMotion(fits[0].goal_from_now, _confidence(found.scene, kits, part)) if fits else nothing

    def _registered(self, query: Query, shapes: SceneShapes) -> _Registered:
        """The scene of a query's image; that of the last image is kept, for queries come scene by scene."""
        key = query.scene_id, query.sensor
        if key not in self._last:
            self._last.clear()
            sensor = sensor_of(self.dataset.summary, query.sensor, query.scene_id)
            image, spread = _calibrated(query.image, sensor)
            parts = [KnownShape.of(name, mesh) for name, mesh in shapes.parts.items()]
            scene = register_scene(image, sensor, KnownShape.upright(KITS, shapes.assembly), parts, spread)
            self._last[key] = _Registered(scene, image.view.world_from_camera)
        return self._last[key]

    @staticmethod
    def _middle(found: _Registered, body: RegisteredBody) -> np.ndarray:
        return found.world_from(body).apply(body.standing.shape.mesh.bounds.mean(0))


def _calibrated(image: LabelledDepth, sensor: SensorFacts) -> tuple[LabelledDepth, float]:
    """An image with the camera and the depths that its table shows, and the spread that is left in the depth scale."""
    if sensor.kind.exact:
        return image, 1e-5
    if not sensor.simulated_table:  # its world was made of the image, so its table tells nothing about the scale
        return image, SCALE_SPREAD
    estimate = camera_estimate_by(image.view, image.labels, sensor)
    spread = float(np.sqrt(np.linalg.inv(estimate.information)[6, 6])) * SCALE_SPREAD
    return LabelledDepth(estimate.view, image.labels), spread


def _confidence(scene: RegisteredScene, kits: RegisteredBody, part: RegisteredBody) -> float:
    """The share of such motions that are seated."""
    left = part.agreement.unexplained + kits.agreement.unexplained
    rival = part.agreement.rival
    ratio = 0.0 if rival is None else min(part.agreement.unexplained / max(rival, 1e-6), 1.0)
    open_mm = 1e3 * scene.scale_spread * float(np.linalg.norm(scene.camera_from_body(part).xyz))
    odds = sum(weight * value for weight, value in zip(ODDS, (1.0, left, ratio, open_mm), strict=True))
    return round(1 / (1 + math.exp(-odds)), CONFIDENCE_DECIMALS)
