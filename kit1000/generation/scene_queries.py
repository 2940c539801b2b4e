"""Queries of a scene by track, each with its pivot and its guess, and the ground truth of their random draws.

Every draw has its own random stream, keyed by the scene, the part and the track: leaving out a part or a track, or
changing their order, changes no other query. The curves are a track too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from kit1000.dataset.asked_queries import GuessDraw, PartInScene, QueryAndTruth, asked_query, eligible
from kit1000.dataset.tables import Row
from kit1000.errors import InputError
from kit1000.queries.guesses import (
    FIXED_LEVELS,
    LEVELS,
    draw_direction,
    draw_goal,
    level_angle,
    level_offset,
)
from kit1000.queries.pivots import part_pivots
from kit1000.queries.tracks import CURVES, TRACKS, curve_id, query_id
from kit1000.rng import stream
from kit1000.values import View


def asking_tracks(
    scene_id: str, seed: int, tracks: Sequence[str], parts: Sequence[PartInScene], *, crowded: bool, alone: bool
) -> tuple[str, ...]:
    """The tracks that ask in a scene.

    Args:
        scene_id: such as test-s0007.
        seed: the seed of the dataset.
        tracks: the tracks of the dataset.
        parts: the parts of the scene.
        crowded: whether the scene is crowded; tracks without `crowded_scenes` do not ask there.
        alone: draw one of the tracks that have a visible part to ask about. Those that do not ask in crowded scenes are
            twice as likely as the others where they do ask.
    """
    asking = tuple(name for name in tracks if TRACKS[name].crowded_scenes or not crowded)
    if not alone:
        return asking
    visible = [part for part in parts if part.invisibility is None]
    able = [name for name in asking if any(eligible(TRACKS[name], part) for part in visible)]

    def number(name: str) -> float:
        """The larger of two random numbers wins twice as often as one."""
        return stream(seed, "asking", scene_id, name).random(1 if TRACKS[name].crowded_scenes else 2).max()

    return (max(able, key=number),) if able else ()


def scene_queries(
    scene_id: str,
    seed: int,
    tracks: Sequence[str],
    views: Mapping[str, View],
    labels: np.ndarray,
    parts: Sequence[PartInScene],
    target: int,
) -> tuple[list[Row], dict[str, Row]]:
    """The queries of a scene and, by query id, their ground truth: rows as in `kit1000.dataset.schema`.

    Args:
        scene_id: such as test-s0007.
        seed: the seed of the dataset.
        tracks: the tracks that ask in the scene; CURVES asks about the target, once for each level of guess error.
        views: depth images by sensor; tracks of other sensors get no queries.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`.
        parts: the parts of the scene.
        target: index of the scene's target.
    """
    if CURVES in tracks and not scene_id.startswith("test-"):
        raise InputError(f"curves: expected a scene of the test split, got {scene_id}")
    rows: list[Row] = []
    truths: dict[str, Row] = {}
    visible = [part for part in parts if part.invisibility is None]
    pivots = {sensor: part_pivots(view, labels) for sensor, view in views.items()}
    for name in tracks:
        if name == CURVES:
            queries = list(_curve_queries(scene_id, seed, visible, pivots["ideal"], target))
            drawn = target
        else:
            queries = list(_track_queries(scene_id, seed, name, visible, pivots.get(TRACKS[name].sensor, {})))
            drawn = _drawn_part(seed, scene_id, name, [query.part.index for query in queries], target)
        for query in queries:
            rows.append(query.row(query.part.index == drawn))
            truths[query.id] = query.truth
    return rows, truths


def _track_queries(
    scene_id: str, seed: int, name: str, parts: Sequence[PartInScene], pivots: Mapping[int, np.ndarray]
) -> Iterator[QueryAndTruth]:
    """The queries of a track about the visible parts from which its sensor has a return."""
    track = TRACKS[name]
    for part in parts:
        if part.index in pivots and eligible(track, part):
            identity, rng = query_id(scene_id, part.index, name), stream(seed, "query", scene_id, part.index, name)
            yield asked_query(identity, track, track.sensor, part, pivots[part.index], rng)


def _curve_queries(
    scene_id: str, seed: int, parts: Sequence[PartInScene], pivots: Mapping[int, np.ndarray], target: int
) -> Iterator[QueryAndTruth]:
    """Queries about the target with every level of guess error: one goal, one direction, one axis."""
    part = next((part for part in parts if part.index == target), None)
    if part is None or target not in pivots:
        return
    rng = stream(seed, "query", scene_id, target, CURVES)
    goal, angle = draw_goal(rng, part.slot)
    direction, axis = draw_direction(rng), draw_direction(rng)
    for varied, level, fixed in product(("pos", "rot"), range(LEVELS), FIXED_LEVELS):
        k, j = (level, fixed) if varied == "pos" else (fixed, level)
        draw = GuessDraw(goal, angle, level_offset(k) * direction, level_angle(j) * axis)
        identity = curve_id(scene_id, target, varied, level, fixed)
        yield QueryAndTruth(identity, CURVES, "ideal", part, pivots[target], part.motion(goal, angle), draw)


def _drawn_part(seed: int, scene_id: str, track: str, indices: list[int], target: int) -> int | None:
    """The part whose query stands for the scene in split `test`: the scene's target if it has a query in the track,
    else the part whose own stream gives the smallest number; None without queries."""
    if target in indices:
        return target
    return min(indices, key=lambda i: stream(seed, "query", scene_id, i, track, "drawn").random(), default=None)
