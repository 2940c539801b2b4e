"""Poses that a user states, such as that of the camera in the base of a robot: in a file or in dataset.json.

Quaternions are read if their order is said: by the names of their numbers, or as `wxyz`. Positions are in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.pose import Pose

WRAPPERS = ("world_from_camera", "base_from_camera", "transformation", "transform", "pose", "matrix")
"""Keys whose value is the pose: ours, those of easy_handeye, and of ROS messages."""
POSITIONS = ("xyz", "translation", "position", "t")
ROTATIONS = ("rotation", "orientation", "quaternion", "R")
TEXTS, YAMLS = (".txt", ".csv"), (".yaml", ".yml")
MOST_BYTES = 1_000_000
EXPECTED = (
    '{"wxyz": [w, x, y, z], "xyz": [x, y, z]} in metres, qw qx qy qz x y z by name, a translation and a rotation, '
    "or the four rows of a 4 x 4 matrix"
)


def read_pose(path: Path) -> Pose:
    """The pose `a_from_b` of a file: JSON, YAML, or a matrix as .npy or text.

    Raises:
        InputError: the file is missing, too large, or holds no rigid pose.
    """
    if not path.is_file():
        raise InputError(f"no file {path}")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e6:.0f} MB, expected one pose: {EXPECTED}")
    suffix = path.suffix.lower()
    if suffix == ".npy":
        value = _array(path)
    elif suffix in TEXTS:
        value = _text(path)
    else:
        value = read_yaml(path) if suffix in YAMLS else read_json(path)
    return stated_pose(value, str(path))


def read_yaml(path: Path) -> Any:
    """The value of a YAML file, also of OpenCV's FileStorage, whose matrices become mappings with `data`."""
    import yaml

    class Loader(yaml.SafeLoader):
        """A loader that makes plain values alone."""

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix",
        lambda loader, node: loader.construct_mapping(node, deep=True),  # pyright: ignore[reportArgumentType]
    )
    text = path.read_text("utf-8", "replace")
    if text.startswith("%YAML:"):  # OpenCV writes a directive that is none of YAML's
        text = text.partition("\n")[2]
    try:
        return yaml.load(text, Loader)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{path}: no YAML ({' '.join(str(error).split())[:160]})") from None


def stated_pose(value: Any, place: str) -> Pose:
    """The pose of a JSON value; raises InputError, which begins with its place, if it is none."""
    try:
        pose = _pose(value)
        if pose.xyz.shape != (3,):
            raise InputError("several poses")
    except (KeyError, TypeError, ValueError, InputError) as error:
        why = f"no {error}" if isinstance(error, KeyError) else error
        raise InputError(f"{place}: no pose ({why}); expected {EXPECTED}") from None
    return pose


def _pose(value: Any) -> Pose:
    if not isinstance(value, Mapping):
        return Pose.from_matrix(np.array(_numbers(value), float))
    for name in WRAPPERS:
        if isinstance(value.get(name), Mapping | list):
            return _pose(value[name])
    if "qw" in value:
        return _from_quaternion(value, ("qw", "qx", "qy", "qz"), [value[name] for name in "xyz"])
    position = _position(value)
    if "wxyz" in value:
        return _from_quaternion(dict(zip("wxyz", _numbers(value["wxyz"]), strict=True)), tuple("wxyz"), position)
    name = next((name for name in ROTATIONS if name in value), None)
    if name is None:
        raise KeyError("wxyz")
    rotation = value[name]
    if isinstance(rotation, Mapping):
        return _from_quaternion(rotation, tuple("wxyz"), position)
    matrix = np.array(_numbers(rotation), float)
    if matrix.size == 4:
        raise InputError(f"{name} has four numbers in an order that is not said: name them qw qx qy qz")
    if matrix.size != 9:
        raise InputError(f"{name}: expected a quaternion of named numbers, or a matrix of 3 x 3")
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = matrix.reshape(3, 3), position
    return Pose.from_matrix(whole)


def _position(value: Mapping[str, Any]) -> list[float]:
    """Three numbers, of a list or of x, y and z."""
    name = next((name for name in POSITIONS if name in value), None)
    if name is None:
        raise KeyError("xyz")
    found = value[name]
    numbers = [found[axis] for axis in "xyz"] if isinstance(found, Mapping) else found
    flat = np.array(_numbers(numbers), float).ravel()
    if flat.shape != (3,):
        raise InputError(f"{name}: expected three numbers")
    return flat.tolist()


def _from_quaternion(value: Mapping[str, Any], names: tuple[str, ...], position: list[Any]) -> Pose:
    wxyz = _numbers([value[name] for name in names])
    norm = float(np.sqrt(np.square(wxyz).sum()))
    if not abs(norm - 1) <= 1e-3:
        raise InputError(f"a quaternion of length {norm:.4g}, expected 1")
    return Pose(np.array(wxyz, float), np.array(_numbers(position), float))


def _array(path: Path) -> Any:
    try:
        return np.load(path, allow_pickle=False).tolist()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {' '.join(str(error).split())[:160]}") from None


def _text(path: Path) -> Any:
    """The rows of numbers of a text file; 16 numbers in one line are the rows of a matrix."""
    rows = [row.replace(",", " ").split() for row in path.read_text("utf-8", "replace").splitlines() if row.strip()]
    try:
        matrix = np.array(rows, float)
    except ValueError:
        raise InputError(f"{path}: no matrix of numbers; expected {EXPECTED}") from None
    return (matrix.reshape(4, 4) if matrix.size == 16 else matrix).tolist()


def _numbers(value: Any) -> Any:
    """Nested lists of numbers as they are; raises TypeError for texts, truth values and anything else."""
    if isinstance(value, list):
        return [_numbers(each) for each in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{value!r} is no number")
    return value
