"""Stated poses: all forms give the same pose, anything else is one line, and a wrong one is named by what it means."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.capture.camera_poses import check_base_pose, check_world_pose
from kit1000.capture.pose_files import read_pose, stated_pose
from kit1000.dataset.json_rows import pose_row
from kit1000.errors import InputError
from kit1000.pose import Pose
from tests.samples.own_images import EYE
from tests.samples.strategies import poses

W, X, Y, Z = EYE.wxyz.tolist()
POSITION = dict(zip("xyz", EYE.xyz.tolist(), strict=True))
POSES: dict[str, str] = {
    "named.json": json.dumps({"world_from_camera": pose_row(EYE)}),
    "rows.txt": "\n".join(" ".join(map(str, row)) for row in EYE.matrix().tolist()),
    "line.txt": " ".join(map(str, EYE.matrix().ravel().tolist())),
    "handeye.yaml": "parameters:\n  eye_on_hand: false\ntransformation:\n"
    + "".join(f"  {k}: {v!r}\n" for k, v in {"qw": W, "qx": X, "qy": Y, "qz": Z, **POSITION}.items()),
    "message.json": json.dumps({"transform": {"translation": POSITION, "rotation": {"x": X, "y": Y, "z": Z, "w": W}}}),
    "pose.json": json.dumps({"pose": {"position": POSITION, "orientation": {"w": W, "x": X, "y": Y, "z": Z}}}),
}


@given(pose=poses())
def test_a_matrix_and_a_row_are_the_same_pose(pose: Pose) -> None:
    row = stated_pose(json.loads(json.dumps(pose_row(pose))), "here")
    matrix = stated_pose(json.loads(json.dumps(pose.matrix().tolist())), "here")
    assert np.array_equal(row.matrix(), pose.matrix())
    assert np.abs(matrix.matrix() - pose.matrix()).max() < 1e-9 * max(1, float(np.abs(pose.xyz).max()))


@pytest.mark.parametrize("name", [*POSES, "pose.npy"])
def test_hand_eye_files_of_many_programs_say_the_same(tmp_path: Path, name: str) -> None:
    if name in POSES:
        (tmp_path / name).write_text(POSES[name], encoding="utf-8")
    else:
        np.save(tmp_path / name, EYE.matrix())
    np.testing.assert_allclose(read_pose(tmp_path / name).matrix(), EYE.matrix(), atol=1e-9)


@pytest.mark.parametrize(
    "value",
    [
        None,
        [],
        "identity",
        {"wxyz": [1, 0, 0, 0]},
        {"wxyz": [0, 0, 0, 0], "xyz": [0, 0, 0]},
        {"wxyz": ["1", 0, 0, 0], "xyz": [0, 0, 0]},
        {"wxyz": [True, 0, 0, 0], "xyz": [0, 0, 0]},
        {"wxyz": [1, 0, 0, 0], "xyz": [0, 0, float("nan")]},
        {"wxyz": [[1, 0, 0, 0]] * 2, "xyz": [0, 0, 0]},
        {"translation": [0, 0, 1], "rotation": [0, 0, 0, 1]},
        {"qw": 2, "qx": 0, "qy": 0, "qz": 0, "x": 0, "y": 0, "z": 1},
        {"qw": 1, "qx": 0, "qy": 0, "qz": 0, "x": 0, "y": 0},
        np.diag([2.0, 2.0, 2.0, 1.0]).tolist(),
        np.eye(3).tolist(),
        [[1, 0, 0, 0], [0, 1, 0]],
        np.eye(4)[None].repeat(2, 0).tolist(),
    ],
)
def test_what_is_no_pose_is_one_line_with_its_place(value: Any, tmp_path: Path) -> None:
    file = tmp_path / "pose.json"
    file.write_text(json.dumps(value))
    with pytest.raises(InputError) as refused:
        read_pose(file)
    text = str(refused.value)
    assert text.startswith(f"{file}: ")
    assert "4 x 4 matrix" in text
    assert "\n" not in text


UP, DISTANCE = EYE.inverse().rotate((0.0, 0.0, 1.0)), float(EYE.xyz[2])
UPRIGHT = Pose.from_rotvec((0.0, 0.0, 0.7), (0.3, -0.2, 0.0))  # base_from_world of a robot on the table
WRONG: dict[str, tuple[Callable[[Pose], Pose], str]] = {
    "inverse": (Pose.inverse, "inverse"),
    "OpenGL": (lambda pose: pose @ Pose.from_rotvec((np.pi, 0.0, 0.0)), "OpenGL"),
    "scalar last": (lambda pose: Pose(np.roll(pose.wxyz, -1), pose.xyz), "scalar last"),
    "mm": (lambda pose: Pose(pose.wxyz, 1e3 * pose.xyz), "in mm"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_pose_is_refused_with_the_reading_that_fits(name: str) -> None:
    change, fact = WRONG[name]
    with pytest.raises(InputError, match=fact):
        check_world_pose(change(EYE), UP, DISTANCE, "pose.json")
    with pytest.raises(InputError, match=fact):
        check_base_pose(change(UPRIGHT @ EYE), UP, DISTANCE, "pose.json")


@given(
    st.floats(-np.pi, np.pi), st.lists(st.floats(-1.5, 1.5), min_size=2, max_size=2), st.floats(-0.03, 0.03)
)  # fmt: skip
@settings(max_examples=40)
def test_a_true_pose_passes_wherever_the_base_stands(yaw: float, at: list[float], tilt: float) -> None:
    base_from_world = Pose.from_rotvec((0.0, 0.0, yaw), (*at, -0.2)) @ Pose.from_rotvec((tilt, 0.0, 0.0))
    (line,) = check_base_pose(base_from_world @ EYE, UP, DISTANCE, "pose.json")
    assert f"{abs(np.degrees(tilt)):.1f}°" in line


def test_a_base_on_a_wall_is_a_warning() -> None:
    lines = check_base_pose(Pose.from_rotvec((0.0, 1.2, 0.3)) @ EYE, UP, DISTANCE, "pose.json")
    assert len(lines) == 2
    assert lines[1].startswith("warning")
