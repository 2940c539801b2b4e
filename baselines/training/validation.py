"""Which targets measure the networks of perception, while they are trained."""

from __future__ import annotations

from collections.abc import Sequence

from kit1000.dataset.reader import Dataset
from kit1000.values import Query


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
