"""The queries of a scene: which parts a track asks about, the draws of their guesses, and the recorded rows.

Every draw has its own random stream, keyed by the scene, the part and the track: leaving out a part or a track, or
changing their order, changes no other query. The robustness curves are a track too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from kit1000.dataset.json_rows import Row, pose_row
from kit1000.pose import Pose
from kit1000.queries.guesses import (
    FIXED_LEVELS,
    LEVELS,
    draw_ball_error,
    draw_direction,
    draw_goal,
    draw_tilt_error,
    level_angle,
    level_offset,
)
from kit1000.queries.motions import apply_error, goal_motion, goal_pose
from kit1000.queries.pivots import part_pivots
from kit1000.queries.tracks import CURVES, TRACKS, Track, curve_id, query_id
from kit1000.rng import stream
from kit1000.sim.layout import UPRIGHT
from kit1000.values import Slot, View

PAPER_TILT = float(np.radians(15))  # largest roll and largest pitch of a goal in the paper's task without a guess
ANGLE_STEP = np.radians(0.25)  # between the angles about a free axis that are tested against PAPER_TILT
POSE_DECIMALS = 12  # of goals and guesses: the last bits of sine and cosine differ between processors
GUESS_ERRORS = {"ball": draw_ball_error, "tilt": draw_tilt_error}


@dataclass(frozen=True, eq=False)
class PartInScene:
    """A part of a scene, a candidate for queries."""

    index: int
    """The i of p{i}."""
    rest_mode: str
    world_from_part: Pose
    world_from_kit: Pose
    slot: Slot
    invisibility: str | None
    """Why the part or its slot is not visible enough for a query; None if both are."""

    def motion(self, goal: int = 0, angle: float | np.ndarray = 0.0) -> Pose:
        """goal_from_now (...,) of a goal of the slot, rotated about the free axis by `angle` (...,) [rad]."""
        return goal_motion(self.world_from_part, self.world_from_kit, goal_pose(self.slot, goal, angle))


@dataclass(frozen=True, eq=False)
class GuessDraw:
    """The random draws of a guess: a goal, and the guess's error."""

    goal: int
    """Index among the goals of the slot."""
    angle: float
    """[rad] rotation of that goal about the free axis; 0 without one."""
    offset: np.ndarray
    """(3,) [m] position error, along world axes."""
    rotvec: np.ndarray
    """(3,) [rad] rotation error, along world axes."""

    @property
    def row(self) -> Row:
        """The row of the ground truth."""
        offset, rotvec = self.offset.tolist(), self.rotvec.tolist()
        return {"goal": self.goal, "turn": self.angle, "offset": offset, "rotvec": rotvec}


@dataclass(frozen=True, eq=False)
class QueryAndTruth:
    """A query with its ground truth."""

    id: str
    track: str
    sensor: str
    part: PartInScene
    pivot: np.ndarray
    goal: Pose
    """goal_from_now of the goal that the guess is drawn around; of the design pose in tracks without a guess."""
    draw: GuessDraw | None

    def row(self, drawn: bool) -> Row:
        guess = self.draw and _rounded_row(apply_error(self.goal, self.pivot, self.draw.offset, self.draw.rotvec))
        row = {"id": self.id, "track": self.track, "sensor": self.sensor, "part": self.part.index}
        return row | {"drawn": drawn, "pivot": self.pivot.tolist(), "guess": guess}

    @property
    def truth(self) -> Row:
        return {"part": self.part.index, "goal_drawn": _rounded_row(self.goal), "draw": self.draw and self.draw.row}


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
        alone: pick one track at random, of those with a visible part to ask about. Tracks that skip crowded scenes get
            double weight in the other scenes.
    """
    asking = tuple(name for name in tracks if TRACKS[name].crowded_scenes or not crowded)
    if not alone:
        return asking
    visible = [part for part in parts if part.invisibility is None]
    able = [name for name in asking if any(eligible(TRACKS[name], part) for part in visible)]

    def number(name: str) -> float:
        """The larger of two random numbers wins twice as often as a single one."""
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
    """The queries of a scene and, by query id, their ground truth: rows as in `kit1000.dataset.scene_data`.

    Args:
        scene_id: such as test-s0007.
        seed: the seed of the dataset.
        tracks: the tracks that ask in the scene; CURVES asks about the target, once for each level of guess error.
        views: depth images by sensor; tracks of other sensors get no queries.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`.
        parts: the parts of the scene.
        target: index of the scene's target.
    """
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
    """The part whose query represents the scene in split `test`; None without queries.

    It is the scene's target if the target has a query in the track, else the part whose own stream gives the smallest
    number.
    """
    if target in indices:
        return target
    return min(indices, key=lambda i: stream(seed, "query", scene_id, i, track, "drawn").random(), default=None)


def _rounded_row(pose: Pose) -> Row:
    """The row of a pose rounded to POSE_DECIMALS."""
    return pose_row(Pose(np.round(pose.wxyz, POSE_DECIMALS), np.round(pose.xyz, POSE_DECIMALS)))


def eligible(track: Track, part: PartInScene) -> bool:
    """Whether a track has queries about such a part, if it is visible."""
    if track.parts == "all" or part.rest_mode != UPRIGHT:
        return track.parts == "all"
    return track.parts == "upright" or _has_nearly_level_goal(part)


def _has_nearly_level_goal(part: PartInScene) -> bool:
    """Whether some goal needs no more roll and pitch than the paper's candidates have."""
    angles = np.arange(0, 2 * np.pi, ANGLE_STEP) if part.slot.free_axis is not None else 0.0
    goals = range(len(part.slot.goals))
    return any(bool(np.any(largest_roll_or_pitch(part.motion(i, angles)) <= PAPER_TILT)) for i in goals)


def asked_query(
    identity: str, track: Track, sensor: str, part: PartInScene, pivot: np.ndarray, rng: np.random.Generator
) -> QueryAndTruth:
    """The query of a track about a part. sensor: of its image; rng: of all its draws."""
    draw = draw_guess(rng, part, track)
    goal = part.motion() if draw is None else part.motion(draw.goal, draw.angle)
    return QueryAndTruth(identity, track.name, sensor, part, pivot, goal, draw)


def draw_guess(rng: np.random.Generator, part: PartInScene, track: Track) -> GuessDraw | None:
    """The random draws of a guess about a part; None for a track without guesses."""
    if track.guess is None:
        return None
    return GuessDraw(*draw_goal(rng, part.slot), *GUESS_ERRORS[track.guess](rng))


def largest_roll_or_pitch(goal_from_now: Pose) -> np.ndarray:
    """The larger of |roll| and |pitch| (...,) [rad]; the rotation is roll about x, then pitch about y, yaw about z."""
    x, y, z = np.moveaxis(goal_from_now.rotation_matrix()[..., 2, :], -1, 0)
    return np.maximum(np.abs(np.arctan2(y, z)), np.abs(np.arctan2(-x, np.hypot(y, z))))
