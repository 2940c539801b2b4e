"""The queries of a dataset that an edit is about: those that a method is asked, and those that the edit answers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from kit1000.dataset.reader import RecordedScene
from kit1000.errors import InputError
from kit1000.values import Query


def editable_queries(scene: RecordedScene, sensor: str) -> dict[int, Query]:
    """A query for each part that can be edited, by index; without the recorded guess, for which the hand stands in.

    Raises InputError where there is none.
    """
    track = _track("snap", sensor)
    found = {query.part: replace(query, guess=None) for query in scene.queries if query.track == track}
    if not found:
        raise InputError(f"{scene.id}: no part of it can be edited from the {sensor} depth image")
    return dict(sorted(found.items()))


def answered_queries(queries: Iterable[Query], sensor: str) -> dict[str, Query]:
    """Queries that an edit answers, by id: of `snap`, the hand instead of the recorded guess, and of `place`."""
    tracks = _track("snap", sensor), _track("place", sensor)
    return {query.id: query for query in queries if query.track in tracks}


def _track(kind: str, sensor: str) -> str:
    return kind if sensor == "ideal" else f"{kind}-{sensor}"
