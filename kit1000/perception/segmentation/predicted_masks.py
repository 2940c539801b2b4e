"""Queries with predicted masks in place of the given ones: what a method scores that has depth alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from kit1000.perception.segmentation.instances import segmented
from kit1000.perception.sensor_facts import SensorFacts, sensor_of, simulated_sensor
from kit1000.predictor import PredictedMotion, Predictor
from kit1000.queries.pivots import part_pivots
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, TrueGeometry, View
from kit1000.weights import WEIGHTS

if TYPE_CHECKING:
    from kit1000.perception.restoration.restorer import Restorer
    from kit1000.perception.segmentation.part_finder import PartFinder

MASKS_WEIGHTS = ("restoration-unmasked", "segmentation")
"""Weights of the network that restores noisy images, and of the one that separates parts in them."""
WINDOW = 10  # [px] around the pivot: the part where no instance is found


@dataclass(frozen=True, eq=False)
class OnPredictedMasks:
    """A method whose queries get predicted masks."""

    predictor: Predictor
    scale: float = 1.0
    """Scale of the dataset's scenes."""
    summary: Mapping[str, Any] = field(default_factory=dict)
    """Its dataset.json, which may state facts about its sensors."""

    def __call__(self, query: Query, geometry: TrueGeometry | None, /) -> PredictedMotion:
        """What the method predicts; segmentation is part of the method."""
        sensor = sensor_of(self.summary, query.sensor, query.scene_id)
        return self.predictor(with_predicted_masks(query, self.scale, sensor), geometry)


def with_predicted_masks(query: Query, scale: float = 1.0, sensor: SensorFacts | None = None) -> Query:
    """The query with masks from its depth image alone. Its pivot says which instance is the part: the nearest one.

    sensor: facts about it; None: those of the simulated sensor of its name.
    """
    seen_by = sensor or simulated_sensor(query.sensor)
    labels = _labels(query.view, seen_by, scale).copy()
    own = FIRST_PART_LABEL + query.part
    pivots = part_pivots(query.view, labels)
    if pivots:
        distances = {part: float(np.sqrt(((pivot - query.pivot) ** 2).sum())) for part, pivot in pivots.items()}
        found = FIRST_PART_LABEL + min(distances, key=lambda part: distances[part])
        swap = np.arange(256, dtype=np.uint8)
        swap[[own, found]] = found, own
        labels = swap[labels]
    else:
        labels[_around_pivot(query)] = own
    image = LabelledDepth(query.view, labels)
    return replace(query, read_image=lambda: image)


@lru_cache(maxsize=1)
def _labels(view: View, sensor: SensorFacts, scale: float) -> np.ndarray:
    """(H, W) uint8 labels of an image; queries come scene by scene, and those of one scene share an image."""
    restorer, finder = mask_networks() if sensor.kind.restores else (None, None)
    return segmented(view, sensor, scale, restorer, finder)


@lru_cache(maxsize=1)
def mask_networks() -> tuple[Restorer, PartFinder]:
    """The networks of MASKS_WEIGHTS."""
    from kit1000.perception.restoration.restorer import Restorer
    from kit1000.perception.segmentation.part_finder import PartFinder

    restoration, parts = MASKS_WEIGHTS
    return Restorer(WEIGHTS / restoration), PartFinder(WEIGHTS / parts)


def _around_pivot(query: Query) -> np.ndarray:
    """(H, W) bool: the pixels about the pivot's place in the image that have a return."""
    camera, view = query.view.camera, query.view
    u, v = camera.project(view.world_from_camera.inverse().apply(query.pivot))
    rows, columns = np.ogrid[: camera.height, : camera.width]
    return (np.abs(rows - v) <= WINDOW) & (np.abs(columns - u) <= WINDOW) & (view.depth > 0)
