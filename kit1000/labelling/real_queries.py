"""The queries of a labelled scene and their ground truth, by the rules of generated datasets.

A track asks about the parts that it asks about there, if they and their slots are seen well enough. Guesses are drawn
as for generated scenes: a real image does not come with the hand that moved its part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.dataset.tables import Row, pose_row
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error, draw_goal, draw_tilt_error
from kit1000.queries.motions import apply_error, goal_motion, goal_pose
from kit1000.queries.pivots import part_pivots
from kit1000.queries.tracks import TRACKS, Track, query_id
from kit1000.rng import stream
from kit1000.sim.layout import TUMBLED
from kit1000.values import Slot, View

SEED = 0  # of all draws: equal labels give equal queries
DECIMALS = 12  # of recorded poses: the last bits differ between processors


@dataclass(frozen=True, eq=False)
class AskedPart:
    """A part of a labelled scene."""

    index: int
    """The i of p{i}."""
    rest_mode: str
    world_from_part: Pose
    world_from_kit: Pose
    slot: Slot
    unseen: str | None
    """Why it or its slot is not seen well enough for a query; None when both are."""

    def goal_from_now(self, goal: int = 0, angle: float = 0.0) -> Pose:
        """The motion to a goal of its slot, turned about the free axis by an angle [rad]."""
        return goal_motion(self.world_from_part, self.world_from_kit, goal_pose(self.slot, goal, angle))


def real_queries(
    scene_id: str, tracks: Sequence[str], sensor: str, view: View, labels: np.ndarray, parts: Sequence[AskedPart]
) -> tuple[list[Row], dict[str, Row]]:
    """The query rows of a scene and, by query id, their truth; both as in `kit1000.dataset.schema`.

    Args:
        scene_id: such as test-s0007.
        tracks: the tracks of the folder.
        sensor: key of the view.
        view: the depth image.
        labels: (H, W) uint8 masks, see `kit1000.values.LabelledDepth`.
        parts: those of the scene, in their order.
    """
    pivots = part_pivots(view, labels)
    rows: list[Row] = []
    truths: dict[str, Row] = {}
    for name in tracks:
        asked = [part for part in parts if part.unseen is None and part.index in pivots and _asks(TRACKS[name], part)]
        drawn = int(stream(SEED, "labelled", scene_id, name, "drawn").integers(len(asked))) if asked else None
        for number, part in enumerate(asked):
            row, truth = _query(scene_id, TRACKS[name], part, pivots[part.index])
            rows.append(row | {"sensor": sensor, "drawn": number == drawn})
            truths[row["id"]] = truth
    return rows, truths


def _asks(track: Track, part: AskedPart) -> bool:
    return track.parts == "all" or part.rest_mode != TUMBLED


def _query(scene_id: str, track: Track, part: AskedPart, pivot: np.ndarray) -> tuple[Row, Row]:
    identity = query_id(scene_id, part.index, track.name)
    row: Row = {"id": identity, "track": track.name, "part": part.index, "pivot": pivot.tolist(), "guess": None}
    if track.guess is None:
        return row, {"part": part.index, "goal_drawn": _rounded(part.goal_from_now()), "draw": None}
    rng = stream(SEED, "labelled", scene_id, part.index, track.name)
    goal, angle = draw_goal(rng, part.slot)
    offset, rotvec = (draw_ball_error if track.guess == "ball" else draw_tilt_error)(rng)
    motion = part.goal_from_now(goal, angle)
    row["guess"] = _rounded(apply_error(motion, pivot, offset, rotvec))
    draw = {"goal": goal, "turn": angle, "offset": offset.tolist(), "rotvec": rotvec.tolist()}
    return row, {"part": part.index, "goal_drawn": _rounded(motion), "draw": draw}


def _rounded(pose: Pose) -> Row:
    return pose_row(Pose(np.round(pose.wxyz, DECIMALS), np.round(pose.xyz, DECIMALS)))
