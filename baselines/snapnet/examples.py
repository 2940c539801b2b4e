"""Queries with guesses, of which the examples of both networks are made.

One for training is a part of any scene, a goal of its slot, a fresh guess error about it and working axes at any yaw,
all drawn from one generator. Validation uses the dataset's queries with their stored guesses, along the world's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from baselines.snapnet.config import Source
from baselines.snapnet.query_volumes import ImageCache, QueryVolumes
from baselines.training.tasks.split_queries import SplitQueries, new_guess
from kit1000.dataset.reader import Dataset
from kit1000.kits.goals import nearest_about_axis
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.completion.parts import PartCompleter
from kit1000.pose import Pose, unit_vector
from kit1000.queries.motions import goal_motion
from kit1000.values import FreeAxis, Query, Truth


class Residual(NamedTuple):
    """The offset and the rotations that take a guess to a goal; along working axes."""

    offset: np.ndarray
    """(3,) [m] of the pivot, to the goal whose rotation is nearest to that of the guess."""
    rotations: Pose
    """(m,) on the left of the guess's rotation, one for each goal: any of them is correct."""
    nearest: int
    """The goal of the offset: the one with the smallest rotation."""
    axis: np.ndarray | None
    """(3,) unit: a correct rotation followed by any rotation about this axis is correct too."""


@dataclass(frozen=True, eq=False)
class QuerySample:
    """A query with a guess, its volumes and what the networks are to predict."""

    volumes: QueryVolumes
    guess: Pose
    """goal_from_now"""
    world_from_work: Pose
    """The working axes; the origin is the pivot moved by the guess."""
    residual: Residual


class QuerySampler:
    """Queries of a split: with fresh guesses for training, with stored ones for validation.

    Files are read when first needed and cached. May be pickled and forked.
    """

    def __init__(
        self,
        dataset: Dataset,
        split: str,
        source: Source,
        completer: PartCompleter | None = None,
        kit_completer: KitCompleter | None = None,
    ) -> None:
        """Nothing is read yet.

        Args:
            dataset: with its ground truth.
            split: such as train or val.
            source: of the volumes.
            completer: the network that completes parts of depth images; None fills columns.
            kit_completer: the network that completes kits, see `ObservedKits`.
        """
        self.source: Source = source
        self.queries = SplitQueries(dataset, split)
        self.images = ImageCache(completer=completer, kit_completer=kit_completer)
        self._networks = completer, kit_completer

    def __reduce__(self) -> tuple[type[QuerySampler], tuple[object, ...]]:
        queries = self.queries
        options = (queries.dataset, queries.split, self.source)
        return QuerySampler, (*options, *self._networks)

    def draw(self, rng: np.random.Generator) -> QuerySample:
        """A part of a scene, every scene with the same probability, with a fresh guess.

        The error is drawn along the working axes, not the world's, so that it fills the window of scores as it does
        without a yaw.
        """
        query, truth = self.queries.draw(rng, "snap")
        volumes = self._volumes(query, truth)
        yaw = Pose.from_rotvec((0, 0, rng.uniform(0, 2 * np.pi)))
        return query_sample(volumes, truth, new_guess(rng, query, truth, "ball", yaw), yaw)

    def keys(self, count: int) -> list[str]:
        """Ids of validation queries: `count` of the drawn targets, spread evenly, or all if there are fewer."""
        return self.queries.keys("snap", count)

    def stored(self, key: str) -> QuerySample:
        """A query by its id, with its stored guess, along the axes of the world."""
        query, truth = self.queries.stored(key)
        volumes = self._volumes(query, truth)
        return query_sample(volumes, truth, volumes.initial_guess(), Pose.identity())

    def _volumes(self, query: Query, truth: Truth) -> QueryVolumes:
        geometry = self.queries.dataset.geometry.true_geometry(truth) if self.source == "truth" else None
        return QueryVolumes(query, self.source, geometry, self.images)


def query_sample(volumes: QueryVolumes, truth: Truth, guess: Pose, yaw: Pose) -> QuerySample:
    """A query with a guess, along working axes that are the world's, rotated by a yaw."""
    work = Pose(yaw.wxyz, guess.apply(volumes.query.pivot))
    return QuerySample(volumes, guess, work, residual_of(truth, volumes.query.pivot, guess, work))


def residual_of(truth: Truth, pivot: np.ndarray, guess: Pose, world_from_work: Pose) -> Residual:
    """What takes a guess to every goal, each rotated about the free axis so that it is nearest to the guess.

    Args:
        truth: of the query.
        pivot: (3,) [m] world.
        guess: goal_from_now.
        world_from_work: the working axes; the origin is not read.
    """
    goals = goal_motion(truth.world_from_part, truth.world_from_kit, truth.slot.goals)
    free, axis = truth.slot.free_axis, None
    if free is not None:
        direction = unit_vector(truth.world_from_kit.rotate(free.direction))
        line = FreeAxis(truth.world_from_kit.apply(free.point), direction)
        goals = Pose.stack([nearest_about_axis(guess, goal, line) for goal in goals])
        axis = Pose(world_from_work.wxyz, np.zeros(3)).inverse().rotate(direction)
    axes = Pose(world_from_work.wxyz, np.zeros(3))
    rotations = axes.inverse() @ Pose((goals @ guess.inverse()).wxyz, np.zeros(3)) @ axes
    nearest = int(np.argmin(rotations.angle()))
    offset = axes.inverse().rotate(goals[nearest].apply(pivot) - guess.apply(pivot))
    return Residual(offset, rotations, nearest, axis)
