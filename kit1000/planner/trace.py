"""Traces: what the robot did in a scene as JSON lines, for viewers to replay.

The first line says which robot stands where. Then each line has the time `t` [s] at which it begins and the `part` that
it is about: a `leg` of the arm, with `seconds` since t and `joints` [rad]; a `grasp`, after which the part moves with
the tool (`tool_from_part`); or a `rest`, the pose at which the part was left (`world_from_part`).
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from kit1000.dataset.json_rows import Row, pose_of, pose_row
from kit1000.errors import InputError
from kit1000.planner.execute import Event, SceneRun
from kit1000.planner.robot import HOME, tool_pose
from kit1000.pose import Pose

FORMAT = "kit1000-trace/1"
DECIMALS = 6  # of seconds, radians, metres and quaternions: the last bits depend on the processor


def trace_bytes(run: SceneRun) -> bytes:
    """The trace of a scene; the same run gives the same bytes."""
    head = {
        "format": FORMAT,
        "scene": run.scene_id,
        "robot": "ur5e",
        "world_from_base": _pose(run.world_from_base),
        "home": _rounded(HOME),
    }
    rows = [head, *map(_row, run.events)]
    return "".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows).encode("ascii")


def read_trace(data: bytes) -> tuple[Row, list[Row]]:
    """The head and the rows of a trace. Raises InputError for anything else."""
    try:
        head, *rows = (json.loads(line) for line in data.decode("ascii").splitlines())
    except ValueError as error:
        raise InputError(f"trace: expected JSON lines ({error}); run the scene again") from None
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise InputError(f"trace: expected the format {FORMAT}; run the scene again with this version")
    return head, rows


def state_at(trace: tuple[Row, list[Row]], poses: list[Pose], seconds: float) -> tuple[np.ndarray, list[Pose]]:
    """Joints (6,) [rad] of the arm and world_from_part of all parts at a time, given the parts' first poses."""
    head, rows = trace
    world_from_base, joints = pose_of(head["world_from_base"]), np.array(head["home"])
    poses, held = list(poses), None
    for row in rows:
        if row["t"] > seconds:
            break
        if "leg" in row:
            since = np.array(row["seconds"])
            table = np.array(row["joints"])
            joints = np.array([np.interp(seconds - row["t"], since, column) for column in table.T])
        elif "grasp" in row:
            held = row["part"], pose_of(row["grasp"])
        else:
            held, poses[row["part"]] = None, pose_of(row["rest"])
    if held is not None:
        poses[held[0]] = world_from_base @ tool_pose(joints) @ held[1]
    return joints, poses


def _row(event: Event) -> dict[str, Any]:
    row = {"t": round(event.start, DECIMALS), "part": event.part}
    if event.leg is not None:
        leg = event.leg
        return row | {"leg": leg.name, "seconds": _rounded(leg.seconds), "joints": [_rounded(q) for q in leg.joints]}
    assert event.pose is not None
    return row | {event.kind: _pose(event.pose)}


def _pose(pose: Pose) -> Row:
    return {key: _rounded(np.array(values)) for key, values in pose_row(pose).items()}


def _rounded(values: np.ndarray) -> list[float]:
    return (np.round(values, DECIMALS) + 0.0).tolist()  # never minus zero
