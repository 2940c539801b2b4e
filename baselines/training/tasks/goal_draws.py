"""Queries of a split with height maps and all goals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.heights.scene_heights import RenderedHeights, SceneHeights
from baselines.training.tasks.split_queries import TRACK_OF, Guesses, SplitQueries, new_guess
from kit1000.dataset.reader import Dataset
from kit1000.pose import Pose
from kit1000.queries.motions import goal_motion, goal_pose
from kit1000.values import Query, Truth

AXIS_ANGLES = 24  # goals that stand for a free axis


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
    """Queries of a split with exact depth; may be pickled and forked."""

    def __init__(self, dataset: Dataset, split: str, heights: RenderedHeights) -> None:
        """Nothing is read yet.

        Args:
            dataset: with its ground truth.
            split: train or val.
            heights: the maps of its scenes.
        """
        self.queries, self.heights = SplitQueries(dataset, split), heights
        self._goals: dict[tuple[str, int], Pose] = {}

    def __reduce__(self) -> tuple[type[QueryDraws], tuple[Dataset, str, RenderedHeights]]:
        return QueryDraws, (self.queries.dataset, self.queries.split, self.heights)

    def draw(self, rng: np.random.Generator, guesses: Guesses) -> GoalQuery:
        """A part of a scene, every scene with the same probability, with a new guess unless guesses is place."""
        query, truth = self.queries.draw(rng, TRACK_OF[guesses])
        return self._of(query, truth, None if guesses == "place" else new_guess(rng, query, truth, guesses))

    def stored(self, key: str) -> GoalQuery:
        """A query by its id, with its stored guess, if it has one."""
        query, truth = self.queries.stored(key)
        return self._of(query, truth, query.guess)

    def _of(self, query: Query, truth: Truth, guess: Pose | None) -> GoalQuery:
        key = query.scene_id, query.part
        if key not in self._goals:
            self._goals[key] = goal_motions(truth)
        return GoalQuery(query, truth, guess, self.heights.of(query.scene_id), self._goals[key])


def goal_motions(truth: Truth) -> Pose:
    """(m,) goal_from_now: all goals of a slot, each at AXIS_ANGLES angles about a free axis."""
    slot = truth.slot
    goals = slot.goals
    if slot.free_axis is not None:
        angles = np.arange(AXIS_ANGLES) * 2 * np.pi / AXIS_ANGLES
        rotated = [goal_pose(slot, i, angles) for i in range(len(goals))]
        goals = Pose(np.concatenate([pose.wxyz for pose in rotated]), np.concatenate([pose.xyz for pose in rotated]))
    return goal_motion(truth.world_from_part, truth.world_from_kit, goals)
