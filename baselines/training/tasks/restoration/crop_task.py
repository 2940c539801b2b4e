"""Training tasks that learn from crops of fresh views: measured by a crop of each of some recorded images."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from baselines.training.tasks.restoration.views import Example, ViewCrops, box_about
from baselines.training.validation import drawn_targets
from kit1000.dataset.reader import Dataset
from kit1000.perception.restoration.disparity import cropped_inputs
from kit1000.values import View

VALIDATION_SCENES = 30  # spread evenly over the validation split

Views = TypeVar("Views", bound=ViewCrops)


class Key(NamedTuple):
    """A validation example: a crop about a pixel of a recorded image."""

    scene_id: str
    row: int
    column: int


class Recorded(NamedTuple):
    """What a recorded scene gives to a task."""

    view: View
    place: np.ndarray
    """(3,) [m] world: shown in the middle of the crop."""
    whole: Example
    """Example of the whole image."""


@dataclass
class CropTask(ABC, Generic[Views]):
    """Its examples; a task adds its network, loss and measures."""

    training: Views
    dataset: Dataset
    split: str
    kept: dict[Key, Example] = field(default_factory=dict, kw_only=True)
    """The validation examples, once they are made: an image takes longer to read than to measure."""

    @abstractmethod
    def recorded(self, scene_id: str) -> Recorded:
        """A scene as the d415 recorded it."""

    def example(self, rng: np.random.Generator) -> Example:
        """One of the crops of fresh views."""
        return self.training[int(rng.integers(len(self.training)))]

    def validation_keys(self) -> Sequence[Key]:
        """A crop of each of VALIDATION_SCENES scenes."""
        if not self.kept:
            targets = drawn_targets(self.dataset, self.split, VALIDATION_SCENES)
            for scene_id in dict.fromkeys(query.scene_id for query, _ in targets):
                self._keep(scene_id)
        return list(self.kept)

    def validation_example(self, key: Key) -> Example:
        """The crop."""
        if key not in self.kept:
            self._keep(key.scene_id)
        return self.kept[key]

    def _keep(self, scene_id: str) -> None:
        """Make the example of a scene."""
        view, place, whole = self.recorded(scene_id)
        column, row = np.rint(view.camera.project(view.world_from_camera.inverse().apply(place))).astype(int).tolist()
        self.kept[Key(scene_id, row, column)] = cropped_inputs(whole, box_about(row, column))
