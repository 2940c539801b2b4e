"""The queries about one part in images of its scene from several places of the camera."""

from __future__ import annotations

from dataclasses import replace

from kit1000.dataset.own_scenes import scenes_from_elsewhere
from kit1000.dataset.reader import Dataset
from kit1000.numerics.linear_algebra import length
from kit1000.values import Query

SAME_PART = 25e-3  # [m] level between the middles of what two images show of a part: half of a typical part, and more


def from_elsewhere(dataset: Dataset, query: Query) -> list[Query]:
    """The queries about the same part in the other images of its scene, as dataset.json states; most datasets none.

    An image that shows no part there has none.
    """
    found = []
    for scene_id in scenes_from_elsewhere(dataset.summary, query.scene_id):
        scene = dataset.recorded_scene(scene_id, truth=False)
        others = [other for other in scene.queries if other.track == query.track]
        nearest = min(others, key=lambda other: _apart(query, other), default=None)
        if nearest is not None and _apart(query, nearest) < SAME_PART:
            found.append(replace(nearest, guess=query.guess))
    return found


def _apart(query: Query, other: Query) -> float:
    """[m] level between the pivots of two queries."""
    return float(length((query.pivot - other.pivot)[:2]))
