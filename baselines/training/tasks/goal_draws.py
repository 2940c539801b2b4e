"""Queries of a split with height maps and goals: with fresh guesses for training, with stored ones for validation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.perception.heights.scene_heights import SCENES, RenderedHeights, SceneHeights
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error, draw_goal, draw_tilt_error
from kit1000.queries.motions import apply_error, goal_motion, goal_pose
from kit1000.values import Query, Truth

Guesses = Literal["ball", "tilt", "place"]
"""Errors of the guess: about any axis, about level axes; place: no guess."""
TRACK_OF: dict[str, str] = {"ball": "snap", "tilt": "snap-tilt", "place": "place"}
"""The track with such guesses."""
DRAW_ERROR = {"ball": draw_ball_error, "tilt": draw_tilt_error}
AXIS_ANGLES = 24  # goals that stand for a free axis
TRIES = 1000  # scenes drawn in a row without a query before the split counts as empty


@dataclass(frozen=True, eq=False)
class GoalQuery:
    """A query with its height maps and all its goals."""

    query: Query
    truth: Truth
    guess: Pose | None
    """goal_from_now"""
    heights: SceneHeights
    goals: Pose
    """(m,) goal_from_now; AXIS_ANGLES of each goal stand for a free axis."""


class QueryDraws:
    """Queries of a split. Files are read when first needed and cached; may be pickled and forked."""

    def __init__(self, dataset: Dataset, split: str, heights: RenderedHeights) -> None:
        """Nothing is read yet.

        Args:
            dataset: with its ground truth.
            split: train or val.
            heights: the maps of its scenes.
        """
        self.dataset, self.split, self.heights = dataset, split, heights
        self._split = dataset.split(split, truth=True)
        self._goals: dict[tuple[str, int], Pose] = {}
        self._queries: Callable[[str], tuple[tuple[Query, Truth], ...]] = lru_cache(SCENES)(self._read)

    def __reduce__(self) -> tuple[type[QueryDraws], tuple[Dataset, str, RenderedHeights]]:
        return QueryDraws, (self.dataset, self.split, self.heights)

    def draw(self, rng: np.random.Generator, guesses: Guesses) -> GoalQuery:
        """A part of a scene, every scene with the same probability, with a fresh guess if there is to be one."""
        query, truth = self._draw_query(rng, TRACK_OF[guesses])
        if guesses == "place":
            return self._of(query, truth, None)
        goal = goal_pose(truth.slot, *draw_goal(rng, truth.slot))
        motion = goal_motion(truth.world_from_part, truth.world_from_kit, goal)
        return self._of(query, truth, apply_error(motion, query.pivot, *DRAW_ERROR[guesses](rng)))

    def keys(self, track: str, count: int) -> list[str]:
        """Ids of validation queries: `count` of the drawn targets, spread evenly, or all if there are fewer."""
        drawn = [
            query.id
            for scene_id in self._split.scene_ids
            for query, _ in self._queries(scene_id)
            if query.drawn and query.track == track
        ]
        return [drawn[i * len(drawn) // count] for i in range(count)] if count < len(drawn) else drawn

    def stored(self, key: str) -> GoalQuery:
        """A query by its id, with its stored guess, if it has one."""
        queries = {query.id: (query, truth) for query, truth in self._queries(key.partition("-p")[0])}
        if key not in queries:
            raise InputError(f"no query {key!r} in split {self.split}; {did_you_mean(key, queries)}see keys()")
        query, truth = queries[key]
        return self._of(query, truth, query.guess)

    def _of(self, query: Query, truth: Truth, guess: Pose | None) -> GoalQuery:
        key = query.scene_id, query.part
        if key not in self._goals:
            self._goals[key] = goal_motions(truth)
        return GoalQuery(query, truth, guess, self.heights.of(query.scene_id), self._goals[key])

    def _draw_query(self, rng: np.random.Generator, track: str) -> tuple[Query, Truth]:
        scene_ids = self._split.scene_ids
        for _ in range(TRIES):
            queries = [
                pair for pair in self._queries(scene_ids[rng.integers(len(scene_ids))]) if pair[0].track == track
            ]
            if queries:
                return queries[rng.integers(len(queries))]
        raise InputError(f"{self.dataset.root}: split {self.split} has no query of track {track}")

    def _read(self, scene_id: str) -> tuple[tuple[Query, Truth], ...]:
        """The queries of a scene with exact depth, with their truths."""
        scene = self._split.scene(scene_id)
        return tuple((query, scene.truth_of(query.id)) for query in scene.queries if query.sensor == "ideal")


def goal_motions(truth: Truth) -> Pose:
    """(m,) goal_from_now: all goals of a slot, each at AXIS_ANGLES angles about a free axis."""
    slot = truth.slot
    goals = slot.goals
    if slot.free_axis is not None:
        angles = np.arange(AXIS_ANGLES) * 2 * np.pi / AXIS_ANGLES
        rotated = [goal_pose(slot, i, angles) for i in range(len(goals))]
        goals = Pose(np.concatenate([pose.wxyz for pose in rotated]), np.concatenate([pose.xyz for pose in rotated]))
    return goal_motion(truth.world_from_part, truth.world_from_kit, goals)
