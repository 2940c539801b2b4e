"""Poses that a user states, such as that of the camera in the base of a robot: in a JSON file or in dataset.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kit1000.dataset.tables import pose_of
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.pose import Pose

EXPECTED = '{"wxyz": [w, x, y, z], "xyz": [x, y, z]} in metres, or the four rows of a 4 x 4 matrix'


def read_pose(path: Path) -> Pose:
    """The pose `a_from_b` in a JSON file: quaternion and position, or a homogeneous matrix; positions in m.

    Raises InputError where the file is missing or holds no rigid pose.
    """
    return stated_pose(read_json(path), str(path))


def stated_pose(value: Any, place: str) -> Pose:
    """The pose of a JSON value; raises InputError, which begins with its place, where it is none."""
    try:
        if isinstance(value, dict):
            pose = pose_of({"wxyz": _numbers(value["wxyz"]), "xyz": _numbers(value["xyz"])})
        else:
            pose = Pose.from_matrix(np.array(_numbers(value)))
        if pose.xyz.shape != (3,):
            raise InputError("several poses")
    except (KeyError, TypeError, ValueError, InputError) as error:
        why = f"no {error}" if isinstance(error, KeyError) else error
        raise InputError(f"{place}: no pose ({why}); expected {EXPECTED}") from None
    return pose


def _numbers(value: Any) -> Any:
    """Nested lists of numbers as they are; raises TypeError for texts, truth values and anything else."""
    if isinstance(value, list):
        return [_numbers(each) for each in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is no number")
    return value
