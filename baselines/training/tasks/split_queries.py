"""The queries of a split for training and validation: drawn at random with a new guess, or by id as they are stored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import Literal

import numpy as np

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error, draw_goal, draw_tilt_error
from kit1000.queries.motions import apply_error, goal_motion, goal_pose
from kit1000.values import Query, Truth

Guesses = Literal["ball", "tilt", "place"]
"""Errors of the guess: about any axis, about level axes; place: no guess."""
TRACK_OF: dict[str, str] = {"ball": "snap", "tilt": "snap-tilt", "place": "place"}
"""The track with such guesses."""
DRAW_ERROR = {"ball": draw_ball_error, "tilt": draw_tilt_error}
SCENES = 1200  # scenes whose queries are kept in memory, without images
TRIES = 1000  # scenes drawn in a row without a query before the split counts as empty

QueryAndTruth = tuple[Query, Truth]


class SplitQueries:
    """Queries of a split with exact depth. Files are read when first needed and cached; may be pickled and forked."""

    def __init__(self, dataset: Dataset, split: str) -> None:
        """Nothing is read yet.

        Args:
            dataset: with its ground truth.
            split: such as train or val.
        """
        self.dataset, self.split = dataset, split
        self._split = dataset.split(split, truth=True)
        self._of_scene: Callable[[str], tuple[QueryAndTruth, ...]] = lru_cache(SCENES)(self._read)

    def __reduce__(self) -> tuple[type[SplitQueries], tuple[Dataset, str]]:
        return SplitQueries, (self.dataset, self.split)

    def draw(self, rng: np.random.Generator, track: str) -> QueryAndTruth:
        """A query of a track; every scene has the same probability."""
        scene_ids = self._split.scene_ids
        for _ in range(TRIES):
            scene_id = scene_ids[rng.integers(len(scene_ids))]
            queries = [pair for pair in self._of_scene(scene_id) if pair[0].track == track]
            if queries:
                return queries[rng.integers(len(queries))]
        raise InputError(f"{self.dataset.root}: split {self.split} has no query of track {track}")

    def keys(self, track: str, count: int) -> list[str]:
        """Ids of validation queries: `count` of the drawn targets, spread evenly, or all if there are fewer."""
        drawn = [
            query.id
            for scene_id in self._split.scene_ids
            for query, _ in self._of_scene(scene_id)
            if query.drawn and query.track == track
        ]
        return [drawn[i * len(drawn) // count] for i in range(count)] if count < len(drawn) else drawn

    def stored(self, key: str) -> QueryAndTruth:
        """A query by its id, such as train-s0012-p3-snap."""
        queries = {query.id: (query, truth) for query, truth in self._of_scene(key.partition("-p")[0])}
        if key not in queries:
            raise InputError(f"no query {key!r} in split {self.split}; {did_you_mean(key, queries)}see keys()")
        return queries[key]

    def _read(self, scene_id: str) -> tuple[QueryAndTruth, ...]:
        """The queries of a scene, with their truths; they share its images and hold none in memory."""
        scene = self._split.scene(scene_id)
        read_image = partial(self.dataset.labelled_depth, scene.shard, scene_id, "ideal")
        queries = (query for query in scene.queries if query.sensor == "ideal")
        return tuple((replace(query, read_image=read_image), scene.truth_of(query.id)) for query in queries)


def new_guess(rng: np.random.Generator, query: Query, truth: Truth, guesses: Guesses, axes: Pose | None = None) -> Pose:
    """A guess, as goal_from_now, with a new error about a drawn goal.

    Args:
        rng: source of the draws.
        query: whose pivot the guess is about.
        truth: of the query.
        guesses: the kind of error: ball or tilt.
        axes: world_from_axes, a rotation: the error is drawn along these axes; by default along those of the world.
    """
    goal = goal_pose(truth.slot, *draw_goal(rng, truth.slot))
    offset, rotvec = DRAW_ERROR[guesses](rng)
    motion = goal_motion(truth.world_from_part, truth.world_from_kit, goal)
    if axes is not None:
        offset, rotvec = axes.rotate(offset), axes.rotate(rotvec)
    return apply_error(motion, query.pivot, offset, rotvec)
