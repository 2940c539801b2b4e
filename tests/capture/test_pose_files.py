"""Stated poses: both forms give the same pose, and everything else is one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from kit1000.capture.pose_files import read_pose, stated_pose
from kit1000.dataset.json_rows import pose_row
from kit1000.errors import InputError
from kit1000.pose import Pose
from tests.samples.strategies import poses


@given(pose=poses())
def test_a_matrix_and_a_row_are_the_same_pose(pose: Pose) -> None:
    row = stated_pose(json.loads(json.dumps(pose_row(pose))), "here")
    matrix = stated_pose(json.loads(json.dumps(pose.matrix().tolist())), "here")
    assert np.array_equal(row.matrix(), pose.matrix())
    assert np.abs(matrix.matrix() - pose.matrix()).max() < 1e-9 * max(1, float(np.abs(pose.xyz).max()))


@pytest.mark.parametrize(
    "value",
    [
        None,
        7,
        [],
        "identity",
        {"wxyz": [1, 0, 0, 0]},
        {"wxyz": [0, 0, 0, 0], "xyz": [0, 0, 0]},
        {"wxyz": ["1", 0, 0, 0], "xyz": [0, 0, 0]},
        {"wxyz": [True, 0, 0, 0], "xyz": [0, 0, 0]},
        {"wxyz": [1, 0, 0, 0], "xyz": [0, 0, float("nan")]},
        {"wxyz": [[1, 0, 0, 0]] * 2, "xyz": [0, 0, 0]},
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
