"""What measures the networks of perception while they are trained: recorded targets and their examples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.values import Query

Key = TypeVar("Key", bound=Hashable)
Example = dict[str, np.ndarray]


@dataclass
class RecordedTask(ABC, Generic[Key]):
    """The validation examples of a task, from recorded images, which take longer to read than to measure."""

    kept: dict[Key, Example] = field(default_factory=dict, kw_only=True)
    """Those that are made already."""

    @abstractmethod
    def recorded(self, key: Key) -> Example:
        """Make an example."""

    def validation_example(self, key: Key) -> Example:
        """An example, made once."""
        if key not in self.kept:
            self.kept[key] = self.recorded(key)
        return self.kept[key]


def drawn_targets(dataset: Dataset, split: str, most: int) -> Sequence[tuple[Query, str]]:
    """The drawn targets of scenes spread evenly over a split, with a sensor each: all by one, then all by the other.

    Args:
        dataset: with ideal depth, and perhaps that of the d415.
        split: of the scenes.
        most: scenes.
    """
    scenes = list(dataset.split(split))
    chosen = scenes[:: max(len(scenes) // most, 1)][:most]
    sensors = [name for name in ("ideal", "d415") if name in chosen[0].sensors]
    targets = [next(query for query in scene.queries if query.drawn) for scene in chosen]
    return [(target, sensor) for sensor in sensors for target in targets]
