"""What is asked about a scene: queries by track, each with its pivot and its guess, and the truth about their draws.

Every draw has a stream of its own, named by the scene, the part and what is drawn: leaving out a part or a track, or
another order of them, changes no other query.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from kit1000.dataset.tables import Row, pose_row
from kit1000.errors import InputError
from kit1000.guesses import (
    FIXED_LEVELS,
    LEVELS,
    draw_ball_error,
    draw_direction,
    draw_goal,
    draw_tilt_error,
    level_angle,
    level_offset,
)
from kit1000.motions import apply_error, goal_motion, goal_pose
from kit1000.pivots import part_pivots
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.layout import UPRIGHT
from kit1000.tracks import CURVES, TRACKS, Track, curve_id, query_id
from kit1000.values import Slot, View

PAPER_TILT = float(np.radians(15))  # most roll and most pitch of a goal that the paper asks for without a guess
ANGLE_STEP = np.radians(0.25)  # at which turns about a free axis are tried against PAPER_TILT
GUESS_ERRORS = {"ball": draw_ball_error, "tilt": draw_tilt_error}


@dataclass(frozen=True, eq=False)
class PartInScene:
    """A part of a scene about which may be asked."""

    index: int
    """i of p{i}."""
    rest_mode: str
    world_from_part: Pose
    world_from_kit: Pose
    slot: Slot
    rejection: str | None
    """Why the part or its slot is not seen well enough to ask; None when both are."""

    def motion(self, goal: int = 0, turn: float | np.ndarray = 0.0) -> Pose:
        """goal_from_now of a goal of the slot, turned about the free axis by `turn` (...,) [rad]."""
        return goal_motion(self.world_from_part, self.world_from_kit, goal_pose(self.slot, goal, turn))


@dataclass(frozen=True, eq=False)
class GuessDraw:
    """What is drawn of a guess: a goal, and an error about it."""

    goal: int
    """Index among the goals of the slot."""
    angle: float
    """[rad] of that goal about the free axis; 0 where there is none."""
    offset: np.ndarray
    """(3,) [m] along world axes."""
    rotvec: np.ndarray
    """(3,) [rad] along world axes."""

    @property
    def row(self) -> Row:
        """As the truth records it."""
        offset, rotvec = self.offset.tolist(), self.rotvec.tolist()
        return {"goal": self.goal, "turn": self.angle, "offset": offset, "rotvec": rotvec}


def scene_queries(
    scene_id: str,
    split: str,
    seed: int,
    views: Mapping[str, View],
    labels: np.ndarray,
    parts: Sequence[PartInScene],
    drawn: int,
    curves: bool,
) -> tuple[list[Row], dict[str, Row]]:
    """The queries of a scene and, by query id, the truth about them: rows as `kit1000.dataset.schema` has them.

    Args:
        scene_id: such as test-s0007, of this split.
        seed: of the dataset.
        views: by sensor; a sensor that is not there is not asked about.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`.
        parts: those of the scene.
        drawn: index of the target that was drawn for the scene.
        curves: whether the drawn target is asked about at every level of error too.
    """
    if curves and split != "test":
        raise InputError(f"curves: expected a scene of the test split, got {scene_id} of {split}")
    rows: list[Row] = []
    truths: dict[str, Row] = {}
    seen = [part for part in parts if part.rejection is None]
    pivots = {sensor: part_pivots(view, labels) for sensor, view in views.items()}
    for name, track in TRACKS.items():
        queries = list(_track_queries(scene_id, seed, name, seen, pivots.get(track.sensor, {})))
        target = _target(seed, scene_id, track.stream, [query.part.index for query in queries], drawn)
        for query in queries:
            rows.append(query.row(query.part.index == target))
            truths[query.id] = query.truth
    for query in _curve_queries(scene_id, seed, seen, pivots["ideal"], drawn) if curves else ():
        rows.append(query.row(True))
        truths[query.id] = query.truth
    return rows, truths


@dataclass(frozen=True, eq=False)
class _QueryAndTruth:
    """A query with what is true of it."""

    id: str
    track: str
    sensor: str
    part: PartInScene
    pivot: np.ndarray
    goal: Pose
    """The goal that the guess is drawn around; the design pose where nobody guesses."""
    draw: GuessDraw | None

    def row(self, drawn: bool) -> Row:
        guess = self.draw and pose_row(apply_error(self.goal, self.pivot, self.draw.offset, self.draw.rotvec))
        told = {"id": self.id, "track": self.track, "sensor": self.sensor, "part": self.part.index}
        return told | {"drawn": drawn, "pivot": self.pivot.tolist(), "guess": guess}

    @property
    def truth(self) -> Row:
        return {"part": self.part.index, "goal_drawn": pose_row(self.goal), "draw": self.draw and self.draw.row}


def _all(_: PartInScene) -> bool:
    return True


def _upright(part: PartInScene) -> bool:
    return part.rest_mode == UPRIGHT


def _nearly_level(part: PartInScene) -> bool:
    """Lying upright, and some goal needs no more roll and pitch than the paper's candidates have."""
    angles = np.arange(0, 2 * np.pi, ANGLE_STEP) if part.slot.free_axis is not None else 0.0
    goals = range(len(part.slot.goals))
    return _upright(part) and any(bool(np.any(_largest_roll_or_pitch(part.motion(i, angles)) <= PAPER_TILT)) for i in goals)


_ELIGIBLE = {"all": _all, "upright": _upright, "upright with a nearly level goal": _nearly_level}


def eligible(track: Track, part: PartInScene) -> bool:
    """Whether a track asks about a part that is well visible."""
    return _ELIGIBLE[track.parts](part)


def _track_queries(
    scene_id: str, seed: int, name: str, parts: Sequence[PartInScene], pivots: Mapping[int, np.ndarray]
) -> Iterator[_QueryAndTruth]:
    """What a track asks about the parts that are seen, where its sensor has a return from them."""
    track = TRACKS[name]
    for part in parts:
        if part.index in pivots and eligible(track, part):
            draw = _draw_guess(scene_id, seed, part, track)
            goal = part.motion() if draw is None else part.motion(draw.goal, draw.angle)
            yield _QueryAndTruth(query_id(scene_id, part.index, name), name, track.sensor, part, pivots[part.index], goal, draw)


def _curve_queries(
    scene_id: str, seed: int, parts: Sequence[PartInScene], pivots: Mapping[int, np.ndarray], drawn: int
) -> Iterator[_QueryAndTruth]:
    """The drawn target's snap query, its goal missed by every level along one direction and about one axis."""
    for snap in _track_queries(scene_id, seed, "snap", [part for part in parts if part.index == drawn], pivots):
        assert snap.draw is not None
        rng = stream(seed, "query", scene_id, drawn, CURVES)
        direction, axis = draw_direction(rng), draw_direction(rng)
        for runs, level, fixed in product(("pos", "rot"), range(LEVELS), FIXED_LEVELS):
            k, j = (level, fixed) if runs == "pos" else (fixed, level)
            draw = replace(snap.draw, offset=level_offset(k) * direction, rotvec=level_angle(j) * axis)
            yield replace(snap, id=curve_id(scene_id, drawn, runs, level, fixed), track=CURVES, draw=draw)


def _draw_guess(scene_id: str, seed: int, part: PartInScene, track: Track) -> GuessDraw | None:
    if track.guess is None:
        return None
    rng = stream(seed, "query", scene_id, part.index, track.stream)
    return GuessDraw(*draw_goal(rng, part.slot), *GUESS_ERRORS[track.guess](rng))


def _target(seed: int, scene_id: str, draws: str, indices: list[int], drawn: int) -> int | None:
    """The target drawn for the scene if it is asked about, else the part whose own stream gives the least number."""
    if drawn in indices:
        return drawn
    return min(indices, key=lambda i: stream(seed, "query", scene_id, i, draws, "drawn").random(), default=None)


def _largest_roll_or_pitch(goal_from_now: Pose) -> np.ndarray:
    """(...,) [rad] the larger of |roll| and |pitch|: the turn is by roll about x, pitch about y, then yaw about z."""
    x, y, z = np.moveaxis(goal_from_now.rotation_matrix()[..., 2, :], -1, 0)
    return np.maximum(np.abs(np.arctan2(y, z)), np.abs(np.arctan2(-x, np.hypot(y, z))))
