"""Poses that a user states, such as that of the camera in the base of a robot: in a file or in dataset.json.

Quaternions are read if their order is said: by the names of their numbers, or as `wxyz`. Positions are in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.errors import InputError
from kit1000.files import converted, read_json
from kit1000.pose import Pose

WRAPPERS = ("world_from_camera", "base_from_camera", "transformation", "transform", "pose")
"""Keys whose value is the pose: ours, that of easy_handeye, and those of ROS messages."""
POSITIONS, ROTATIONS = ("xyz", "translation", "position"), ("rotation", "orientation")
TEXTS, YAMLS = (".txt", ".csv"), (".yaml", ".yml")
MOST_BYTES = 10_000_000
EXPECTED = (
    '{"wxyz": [w, x, y, z], "xyz": [x, y, z]} in metres, qw qx qy qz x y z by name, a translation and a rotation by '
    "the names of ROS, or the four rows of a 4 x 4 matrix"
)


def read_pose(path: Path) -> Pose:
    """The pose `a_from_b` of a file: JSON, YAML, or a matrix as .npy or text.

    Raises:
        InputError: the file is missing, too large, or holds no rigid pose.
    """
    return stated_pose(read_value(path, EXPECTED), str(path))


def read_value(path: Path, expected: str) -> Any:
    """The value of a file: of JSON or YAML as it is, of .npy or text nested lists, rows of numbers.

    Raises InputError if the file is missing, large or damaged. expected: what it should hold, for messages.
    """
    if not path.is_file():
        raise InputError(f"no file {path}")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e6:.0f} MB, expected {expected}")
    suffix = path.suffix.lower()
    if suffix not in (".npy", *TEXTS, *YAMLS):
        try:
            return read_json(path)
        except RecursionError:
            return None
    import yaml

    try:
        if suffix == ".npy":
            return np.load(path, allow_pickle=False).tolist()
        text = path.read_text("utf-8", "replace")
        if suffix in YAMLS:
            return yaml.safe_load(text)
        numbers = np.array(text.replace(",", " ").split(), float)
        return numbers.reshape(4, 4).tolist() if numbers.size == 16 else numbers.tolist()
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise InputError(
            f"{path}: cannot be read ({' '.join(str(error).split())[:160]}); expected {expected}"
        ) from None


def stated_pose(value: Any, place: str) -> Pose:
    """The pose of a JSON value; raises InputError, which begins with its place, if it is none."""
    try:
        return _pose(value)
    except (KeyError, TypeError, ValueError, InputError) as error:
        why = f"no {error}" if isinstance(error, KeyError) else error
        raise InputError(f"{place}: no pose ({why}); expected {EXPECTED}") from None


def _pose(value: Any) -> Pose:
    if not isinstance(value, Mapping):
        return Pose.from_matrix(np.array(converted(value, list[list[float]], "matrix")))
    for name in WRAPPERS:
        if isinstance(value.get(name), Mapping | list):
            return _pose(value[name])
    if "qw" in value:
        return _of([value[name] for name in ("qw", "qx", "qy", "qz")], [value[name] for name in "xyz"])
    name = next((name for name in POSITIONS if name in value), "xyz")
    position = [value[name][axis] for axis in "xyz"] if isinstance(value[name], Mapping) else value[name]
    if "wxyz" in value:
        return _of(value["wxyz"], position)
    name = next((name for name in ROTATIONS if name in value), "wxyz")
    if isinstance(value[name], Mapping):
        return _of([value[name][axis] for axis in "wxyz"], position)
    raise InputError(f"{name}: the order of its numbers is not said: name them w x y z, or give a 4 x 4 matrix")


def _of(wxyz: Any, xyz: Any) -> Pose:
    quaternion = np.array(converted(wxyz, list[float], "rotation"))
    norm = float(np.sqrt(np.square(quaternion).sum()))
    if not abs(norm - 1) <= 1e-3:
        raise InputError(f"a quaternion of length {norm:.4g}, expected 1")
    return Pose(quaternion, np.array(converted(xyz, list[float], "position")))
