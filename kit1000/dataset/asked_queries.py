"""Queries about the parts of a scene: which parts a track asks about, the draws of a guess, and the recorded rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.dataset.tables import Row, pose_row
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error, draw_goal, draw_tilt_error
from kit1000.queries.motions import apply_error, goal_motion, goal_pose
from kit1000.queries.tracks import Track
from kit1000.sim.layout import UPRIGHT
from kit1000.values import Slot

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
    """Why the part or its slot is not visible enough for a query; None when both are."""

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


def _rounded_row(pose: Pose) -> Row:
    """The row of a pose rounded to POSE_DECIMALS."""
    return pose_row(Pose(np.round(pose.wxyz, POSE_DECIMALS), np.round(pose.xyz, POSE_DECIMALS)))


def _all(_: PartInScene) -> bool:
    return True


def _upright(part: PartInScene) -> bool:
    return part.rest_mode == UPRIGHT


def _nearly_level(part: PartInScene) -> bool:
    """Whether the part is upright and some goal needs no more roll and pitch than the paper's candidates have."""
    angles = np.arange(0, 2 * np.pi, ANGLE_STEP) if part.slot.free_axis is not None else 0.0
    goals = range(len(part.slot.goals))
    return _upright(part) and any(
        bool(np.any(largest_roll_or_pitch(part.motion(i, angles)) <= PAPER_TILT)) for i in goals
    )


_ELIGIBLE = {"all": _all, "upright": _upright, "upright with a nearly level goal": _nearly_level}


def eligible(track: Track, part: PartInScene) -> bool:
    """Whether a track has queries about such a part, if it is visible."""
    return _ELIGIBLE[track.parts](part)


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
