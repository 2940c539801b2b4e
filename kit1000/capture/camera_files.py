"""Intrinsics from files: JSON or YAML of BOP, Open3D, RealSense, ROS or ours, a matrix as .npy or text, or numbers.

BOP's `depth_scale` is mm a unit, that of others metres a unit or units a metre, by its size. A key that looks like
distortion, a unit or a baseline and is not known is refused: dropped without a word it would bend or scale the scene.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np

from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.pose_files import read_value
from kit1000.errors import InputError
from kit1000.sim.sensors import Stream

LARGEST_UNIT = 0.02  # [m] up to which a scale is a length of a unit
LEAST_COUNT = 20.0  # from which a scale is a number of units a metre
LONGEST_BASELINE = 1.0  # [m]
FORMATS = (
    "JSON or YAML with fx, fy, cx, cy, or cam_K, K, camera_matrix or intrinsic_matrix; .npy or text of 3 x 3 numbers; "
    "or fx fy cx cy"
)
MATRICES = ("cam_K", "intrinsic_matrix", "camera_matrix", "K", "k")
CENTRES = (("cx", "cy"), ("ppx", "ppy"))
COEFFICIENTS = ("coeffs", "distortion_coefficients", "D", "d")
"""Keys of an array of coefficients in OpenCV's order, or of a mapping with `data`."""
SINGLE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Keys of single coefficients, in OpenCV's order."""
READ = {*MATRICES, *COEFFICIENTS, *SINGLE, "distortion_model", "depth_units", "depth_scale", "baseline"}
SUSPICIOUS = re.compile(r"dist(?!ance)|coeff|radial|tangential|scale|factor|unit|baseline|^_?[kp][1-9]$", re.IGNORECASE)


def read_intrinsics(words: Sequence[str], image: Path | None = None) -> Intrinsics:
    """The intrinsics that --intrinsics gives: four numbers fx fy cx cy, or one file.

    image: the depth image, whose number chooses among those of BOP's scene_camera.json.
    """
    if len(words) == 4:
        try:
            fx, fy, cx, cy = map(float, words)
            return Intrinsics(fx, fy, cx, cy)
        except ValueError:
            raise InputError(f"--intrinsics {' '.join(words)}: expected a file or four numbers fx fy cx cy") from None
    if len(words) != 1:
        raise InputError(f"--intrinsics: expected a file or the four numbers fx fy cx cy, got {len(words)} words")
    path = Path(words[0])
    if not path.is_file():
        raise InputError(f"--intrinsics {path}: no such file; expected {FORMATS}")
    value = read_value(path, FORMATS)
    if isinstance(value, list):
        return _from_matrix(_matrix(value, str(path)), {}, path)
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected an object of named values; known are {FORMATS}")
    return _from_row(_chosen(value, path, image), path)


def _chosen(value: Mapping[str, Any], path: Path, image: Path | None) -> Mapping[str, Any]:
    """The entry of BOP's scene_camera.json for an image, or its only one; any other object as it is."""
    rows = {key: row for key, row in value.items() if isinstance(row, dict) and "cam_K" in row}
    if len(rows) < 2:
        return next(iter(rows.values()), value)
    number = str(int(image.stem)) if image is not None and image.stem.isdigit() else "without a number"
    if number not in rows:
        raise InputError(f"{path}: holds {len(rows)} cameras, none of image {number}: save one of them")
    return rows[number]


def _from_row(row: Mapping[str, Any], path: Path) -> Intrinsics:
    for name, value in row.items():
        known = str(name) in READ or value in (None, "", 0, 1, [], {})
        if not known and SUSPICIOUS.search(str(name)):
            raise InputError(
                f"{path}: the key {name} is not known, and looks like distortion, a unit or a baseline: rename it "
                "(distortion_coefficients, depth_units in m, baseline in m), or delete it"
            )
    key = next((key for key in MATRICES if key in row), None)
    if key is not None:
        return _from_matrix(_matrix(row[key], f"{path}: {key}"), row, path)
    if "fx" not in row or "fy" not in row:
        keys = ", ".join(sorted(map(str, row))[:8]) or "none"
        raise InputError(f"{path}: no intrinsics among its keys ({keys}); expected {FORMATS}")
    centre = next((names for names in CENTRES if all(name in row for name in names)), None)
    if centre is None:
        raise InputError(f"{path}: no principal point: expected cx and cy, or ppx and ppy")
    fx, fy, cx, cy = (_number(row, name, path) for name in ("fx", "fy", *centre))
    return Intrinsics(fx, fy, cx, cy, **_beside(row, path))


def _matrix(value: Any, what: str) -> np.ndarray:
    """A matrix (3, 3) from nested lists, a flat list, or a mapping with `data`, as YAML has it."""
    value = value.get("data") if isinstance(value, dict) else value
    try:
        return np.array(value, float).reshape(3, 3)
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected 3 x 3 numbers; known are {FORMATS}") from None


def _from_matrix(k: np.ndarray, row: Mapping[str, Any], path: Path) -> Intrinsics:
    """Intrinsics of a matrix K (3, 3), row by row or column by column."""
    if k[0, 2] == 0 and k[2, 0] != 0:
        k = k.T
    if not np.isfinite(k).all() or abs(k[2] - (0, 0, 1)).max() > 1e-6 or abs(k[1, 0]) > 1e-9:
        raise InputError(f"{path}: expected a matrix fx 0 cx, 0 fy cy, 0 0 1 [px]")
    if abs(k[0, 1]) > 1e-6 * abs(k[0, 0]):
        raise InputError(f"{path}: skew {k[0, 1]:g}, expected 0: no depth camera has any")
    return Intrinsics(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), **_beside(row, path))


def _beside(row: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """What else a file says about its image."""
    sides = ((row.get(f"{prefix}width"), row.get(f"{prefix}height")) for prefix in ("", "image_"))
    size = next((pair for pair in sides if None not in pair), None)
    baseline, stream = row.get("baseline"), row.get("stream")
    try:
        whole = None if size is None else (int(size[0] or 0), int(size[1] or 0))
        coefficients = tuple(np.array(_coefficients(row), float).ravel().tolist())
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{path}: width, height or distortion are no numbers") from None
    if baseline is not None and (baseline := _positive(row, "baseline", path)) > LONGEST_BASELINE:
        raise InputError(f"{path}: baseline is {baseline:g}, expected metres, up to {LONGEST_BASELINE:g}")
    if stream not in (None, *get_args(Stream)):
        raise InputError(f"{path}: stream {stream!r}, expected raw (the depth camera's own) or aligned")
    return {
        "size": whole,
        "unit": _unit(row, path),
        "model": str(row.get("model") or row.get("distortion_model") or "plumb_bob").removeprefix("distortion."),
        "coefficients": coefficients,
        "device": str(row.get("device") or row.get("name") or ""),
        "baseline": baseline,
        "stream": stream,
        "source": str(path),
    }


def _unit(row: Mapping[str, Any], path: Path) -> float | None:
    """[m] that 1 in the image stands for; None if it is not stated."""
    if "depth_units" in row:
        return _positive(row, "depth_units", path)
    if row.get("depth_scale") is None:
        return None
    scale = _positive(row, "depth_scale", path)
    if "cam_K" in row:
        return 1e-3 * scale
    if LARGEST_UNIT < scale < LEAST_COUNT:
        raise InputError(f"{path}: depth_scale {scale:g}: mm a unit, or units a metre? Give --depth-scale in m a unit")
    return scale if scale <= LARGEST_UNIT else 1 / scale


def _coefficients(row: Mapping[str, Any]) -> Any:
    """The distortion of a file: an array, a mapping with `data`, or single numbers."""
    value = next((row[name] for name in COEFFICIENTS if row.get(name) is not None), None)
    value = value.get("data") if isinstance(value, Mapping) else value
    if value is None and any(name in row for name in SINGLE):
        single = [row.get(name) or 0 for name in SINGLE]
        return single if any(single[5:]) else single[:5]
    return value or []


def _number(row: Mapping[str, Any], name: str, path: Path) -> float:
    try:
        return float(row[name])
    except (TypeError, ValueError):
        raise InputError(f"{path}: {name} is {row[name]!r}, expected a number") from None


def _positive(row: Mapping[str, Any], name: str, path: Path) -> float:
    value = _number(row, name, path)
    if not 0 < value < math.inf:
        raise InputError(f"{path}: {name} is {value:g}, expected a number above 0")
    return value
