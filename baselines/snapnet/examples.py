"""What the networks learn from: volumes, points and what is right for them, made of a dataset when they are asked for.

A training example is a part of any scene, a goal of its slot, a fresh error about it and working axes of any yaw, all
drawn from one generator. To check by there are the dataset's own queries with the guesses it stores, and no yaw.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Literal, NamedTuple

import numpy as np

from baselines.snapnet.candidates import candidates, nearest
from baselines.snapnet.config import Kind, PositionConfig, RotationConfig
from baselines.snapnet.volumes import SCENES, Kept, Looks
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, did_you_mean
from kit1000.guesses import draw_ball_error, draw_goal, draw_tilt_error
from kit1000.kits.goals import nearest_turn
from kit1000.motions import apply_error, goal_motion, goal_pose
from kit1000.pose import Pose, unit_vector
from kit1000.rng import stream
from kit1000.tracks import TRACKS
from kit1000.values import FreeAxis, Query, Truth

Guesses = Literal["ball", "tilt", "place"]
"""Errors of a person's guess about any axis, about level axes, or no guess at all."""
Sensor = Literal["ideal", "d415"]
Example = dict[str, np.ndarray]

ASKED = {"ball": "snap", "tilt": "snap-tilt", "place": "place"}
"""The track whose queries are meant."""
ERRORS = {"ball": draw_ball_error, "tilt": draw_tilt_error}
START_JITTER = 3.56e-3  # [m] most along an axis, where nobody guesses: four voxels of the paper
TRIES = 1000  # scenes drawn in a row with nothing asked, before the split counts as one that asks nothing
NEAR = 64  # candidates that are hard to tell from the right one: on the ball those within some 14 degrees
SEED = 0  # of the points and turns of checked examples


class Residual(NamedTuple):
    """What is left to do after a guess; along working axes."""

    offset: np.ndarray
    """(3,) [m] of the pivot, for the goal whose rotation is nearest to that of the guess."""
    turns: Pose
    """(m,) rotations on the left of the guess's, one for each goal: any of them is right."""
    nearest: int
    """The goal of the offset: the least of the turns."""
    axis: np.ndarray | None
    """(3,) unit: a further turn about it, on the left, leaves a right turn right."""


@dataclass(frozen=True, eq=False)
class Situation:
    """A query with a guess, as the networks are asked about it."""

    looks: Looks
    guess: Pose
    """goal_from_now"""
    world_from_work: Pose
    """The working axes; their origin is where the guess takes the pivot."""
    residual: Residual


class Situations:
    """Queries of a split: with fresh guesses to learn from, and with stored ones to check by.

    Files are read when first needed and what is read of them is kept. May be pickled and forked.
    """

    def __init__(
        self, dataset: Dataset, split: str, kind: Kind, guesses: Guesses = "ball", sensor: Sensor = "ideal"
    ) -> None:
        """Nothing is read yet.

        Args:
            dataset: with its truth.
            split: such as train or val.
            kind: of the volumes.
            guesses: what the errors are like; of place, only parts that lie upright are asked about.
            sensor: whose depth images and pivots.

        Raises:
            InputError: no such errors, or a sensor that the dataset does not ask about with them.
        """
        if guesses not in ASKED:
            raise InputError(f"guesses {guesses!r}: {did_you_mean(guesses, ASKED)}there are {', '.join(ASKED)}")
        self.dataset, self.split = dataset, split
        self.kind: Kind = kind
        self.guesses: Guesses = guesses
        self.sensor: Sensor = sensor
        self.track = ASKED[guesses] if sensor == "ideal" else f"{ASKED[guesses]}-{sensor}"
        if self.track not in TRACKS:
            raise InputError(f"sensor {sensor!r}: no track {self.track}; there are {', '.join(TRACKS)}")
        self._split = dataset.split(split, truth=True)
        self._kept = Kept(dataset)
        self._asked: Callable[[str], tuple[tuple[Query, Truth], ...]] = lru_cache(SCENES)(self._read)

    def __reduce__(self) -> tuple[type[Situations], tuple[Dataset, str, Kind, Guesses, Sensor]]:
        return Situations, (self.dataset, self.split, self.kind, self.guesses, self.sensor)

    def draw(self, rng: np.random.Generator) -> Situation:
        """A part of a scene, every scene as likely, with a fresh guess.

        The error is drawn along the working axes, not the world's, so that it fills the window of scores as it does
        when there is no yaw.
        """
        query, truth = self._drawn(rng)
        looks = Looks(query, truth, self.kind, self.dataset, self._kept)
        yaw = Pose.from_rotvec((0, 0, rng.uniform(0, 2 * np.pi)))
        if self.guesses == "place":
            shift = yaw.rotate(rng.uniform(-START_JITTER, START_JITTER, 3))
            return situation(looks, Pose.from_translation(shift) @ looks.start(), yaw)
        goal = goal_pose(truth.slot, *draw_goal(rng, truth.slot))
        offset, rotvec = ERRORS[self.guesses](rng)
        home = goal_motion(truth.world_from_part, truth.world_from_kit, goal)
        return situation(looks, apply_error(home, query.pivot, yaw.rotate(offset), yaw.rotate(rotvec)), yaw)

    def keys(self, count: int) -> list[str]:
        """Ids of queries to check by: of those drawn for their scenes, `count` spread evenly, or all if fewer."""
        asked = [query.id for scene_id in self._split.scene_ids for query, _ in self._asked(scene_id) if query.drawn]
        return [asked[i * len(asked) // count] for i in range(count)] if count < len(asked) else asked

    def stored(self, key: str) -> Situation:
        """A query of the track by its id, with the guess that the dataset stores, if any, and the axes of the world."""
        scene_id = key.partition("-p")[0]  # train-s0012-p3-snap
        found = {query.id: (query, truth) for query, truth in self._asked(scene_id)}
        if key not in found:
            raise InputError(f"no query {key!r} of track {self.track}; {did_you_mean(key, found)}see keys()")
        looks = Looks(*found[key], self.kind, self.dataset, self._kept)
        return situation(looks, looks.start(), Pose.identity())

    def _drawn(self, rng: np.random.Generator) -> tuple[Query, Truth]:
        scene_ids = self._split.scene_ids
        for _ in range(TRIES):
            asked = self._asked(scene_ids[rng.integers(len(scene_ids))])
            if asked:
                return asked[rng.integers(len(asked))]
        raise InputError(f"{self.dataset.root}: split {self.split} asks nothing of track {self.track}")

    def _read(self, scene_id: str) -> tuple[tuple[Query, Truth], ...]:
        """The queries of the track about a scene; they share its images, and hold on to none."""
        recorded = self._split.scene(scene_id)
        look = partial(self.dataset.labelled_depth, recorded.shard, scene_id, self.sensor)
        asked = (query for query in recorded.queries if query.track == self.track)
        return tuple((replace(query, read_image=look), recorded.truth_of(query.id)) for query in asked)


class PositionExamples:
    """Examples for the network that finds where a part goes.

    `part`, `kit` (nx, ny, nz) float32 volumes; `offset` (3,) float32 [m] from where the guess takes the pivot to where
    it belongs, along working axes; `inside` () bool, whether the cell nearest to the offset is one of the window's.
    """

    def __init__(self, situations: Situations, config: PositionConfig) -> None:
        """Of situations, in the sizes of a config."""
        self.situations = situations
        self.config = config

    def draw(self, rng: np.random.Generator) -> Example:
        """An example to learn from; the same generator gives the same bytes."""
        return self._of(self.situations.draw(rng))

    def keys(self, count: int) -> list[str]:
        """See `Situations.keys`."""
        return self.situations.keys(count)

    def check(self, key: str) -> Example:
        """The example of a stored query."""
        return self._of(self.situations.stored(key))

    def _of(self, asked: Situation) -> Example:
        config, looks, work = self.config, asked.looks, asked.world_from_work
        window = np.array(config.window)
        cell = np.floor(asked.residual.offset / (2 * config.voxel) + window // 2 + 0.5)
        return looks.for_position(asked.guess, work, config) | {
            "offset": asked.residual.offset.astype(np.float32),
            "inside": np.asarray(((cell >= 0) & (cell < window)).all()),
        }


class RotationExamples:
    """Examples for the network that tells turned copies of a part apart.

    `part_points` (P, 3) and `kit_points` (K, 3) float32 [m] along working axes, of the part laid by the guess, about
    its pivot, and of the kits, about where the pivot belongs but for a jitter; `turns` (C, 4) float64 wxyz candidates
    on the left of the guess; `nearest` () int64, the right one among them; `distances` (C,) float32 [rad] of each to
    the nearest right turn; where the config has distances, `kit_volume` (nx, ny, nz) float32.
    In training C is `config.shown`: the right one and others, in any order.
    """

    def __init__(self, situations: Situations, config: RotationConfig) -> None:
        """Of situations, in the sizes of a config. Raises InputError when its candidates are for other guesses."""
        guesses = situations.guesses
        if config.candidates.startswith("place") != (guesses == "place"):
            raise InputError(f"guesses {guesses!r}: the candidates {config.candidates!r} are not made for them")
        self.situations = situations
        self.config = config
        self.candidates = candidates(config.candidates)

    def draw(self, rng: np.random.Generator) -> Example:
        """An example to learn from; the same generator gives the same bytes."""
        return self._of(self.situations.draw(rng), rng)

    def keys(self, count: int) -> list[str]:
        """See `Situations.keys`."""
        return self.situations.keys(count)

    def check(self, key: str, every: bool = False) -> Example:
        """The example of a stored query; always the same points, jitter and candidates, or `every` one in order."""
        return self._of(self.situations.stored(key), stream(SEED, "check", key), every)

    def _of(self, asked: Situation, rng: np.random.Generator, every: bool = False) -> Example:
        config, looks, work = self.config, asked.looks, asked.world_from_work
        jitter = rng.uniform(-config.jitter, config.jitter, 3)
        place = work @ Pose.from_translation(asked.residual.offset + jitter)
        right, distances = nearest(self.candidates, asked.residual.turns, asked.residual.axis)
        chosen = np.arange(len(distances)) if every else shown(rng, distances, config.shown, config.hard)
        return looks.for_rotation(asked.guess, place, config, rng) | {
            "turns": self.candidates.wxyz[chosen],
            "nearest": np.asarray(np.flatnonzero(chosen == right)[0], np.int64),
            "distances": distances[chosen].astype(np.float32),
        }


def situation(looks: Looks, guess: Pose, yaw: Pose) -> Situation:
    """A query whose truth is known, a guess, and working axes that are those of the world turned by a yaw."""
    assert looks.truth is not None
    work = Pose(yaw.wxyz, guess.apply(looks.query.pivot))
    return Situation(looks, guess, work, residual_of(looks.truth, looks.query.pivot, guess, work))


def residual_of(truth: Truth, pivot: np.ndarray, guess: Pose, world_from_work: Pose) -> Residual:
    """What a guess lacks of every goal, each turned about the free axis so that it is nearest to the guess.

    Args:
        truth: of the query.
        pivot: (3,) [m] world.
        guess: goal_from_now.
        world_from_work: the working axes; where they begin is not read.
    """
    goals = goal_motion(truth.world_from_part, truth.world_from_kit, truth.slot.goals)
    free, axis = truth.slot.free_axis, None
    if free is not None:
        direction = unit_vector(truth.world_from_kit.rotate(free.direction))
        line = FreeAxis(truth.world_from_kit.apply(free.point), direction)
        goals = Pose.stack([nearest_turn(guess, goal, line) for goal in goals])
        axis = Pose(world_from_work.wxyz, np.zeros(3)).inverse().rotate(direction)
    axes = Pose(world_from_work.wxyz, np.zeros(3))
    turns = axes.inverse() @ Pose((goals @ guess.inverse()).wxyz, np.zeros(3)) @ axes
    least = int(np.argmin(turns.angle()))
    offset = axes.inverse().rotate(goals[least].apply(pivot) - guess.apply(pivot))
    return Residual(offset, turns, least, axis)


def shown(rng: np.random.Generator, distances: np.ndarray, most: int, hard: float = 0.0) -> np.ndarray:
    """Candidates to learn from: the right one and others, in any order.

    Args:
        rng: source of the draw.
        distances: (n,) [rad] of all candidates to the nearest right turn.
        most: that are shown; all if there are fewer.
        hard: share of the others that is drawn among the NEAR nearest.

    Returns:
        (most,) indices.
    """
    order = np.argsort(distances, kind="stable")
    others = min(most, len(order)) - 1
    near = min(round(hard * others), NEAR, others)
    drawn = rng.choice(order[1 : NEAR + 1], near, replace=False) if near else order[:0]
    rest = rng.choice(np.setdiff1d(order[1:], drawn), others - near, replace=False)
    return rng.permutation(np.concatenate([order[:1], drawn, rest]))
