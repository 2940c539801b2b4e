"""Intrinsics from files: JSON of BOP, Open3D, RealSense, ROS, gqcnn or ours, a text file of a 3 x 3 matrix, or numbers.

Two formats say `depth_scale` and mean the inverse: BOP's is mm a unit, Open3D's is units a metre. Which one a file is
of, its other keys tell.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.capture.intrinsics import Intrinsics
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.sim.sensors import Stream

LARGEST_UNIT = 0.02  # [m] above it a `depth_scale` beside fx is no length of a unit in m
LONGEST_BASELINE = 1.0  # [m]
MOST_BYTES = 10_000_000
FORMATS = "JSON with fx, fy, cx, cy, or cam_K, K or intrinsic_matrix; a text file of 3 x 3 numbers; or fx fy cx cy"
MATRICES = ("cam_K", "intrinsic_matrix", "camera_matrix", "K", "k")
CENTRES = (("cx", "cy"), ("ppx", "ppy"), ("_cx", "_cy"))


def read_intrinsics(words: Sequence[str], image: Path | None = None) -> Intrinsics:
    """The intrinsics that --intrinsics gives: four numbers fx fy cx cy, or one file.

    image: the depth image, whose number chooses among those of BOP's scene_camera.json.
    """
    if len(words) == 4:
        fx, fy, cx, cy = _numbers(words)
        return Intrinsics(fx, fy, cx, cy)
    if len(words) != 1:
        raise InputError(f"--intrinsics: expected a file or the four numbers fx fy cx cy, got {len(words)} words")
    path = Path(words[0])
    if not path.is_file():
        raise InputError(f"--intrinsics {path}: no such file; expected {FORMATS}")
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e6:.0f} MB, expected intrinsics: {FORMATS}")
    if path.suffix.lower() == ".txt":
        return _from_matrix(_text_matrix(path), {}, path)
    try:
        value = read_json(path)
    except RecursionError:
        value = None
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected a JSON object; known are {FORMATS}")
    return _from_json(_chosen(value, path, image), path)


def _numbers(words: Sequence[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise InputError(f"--intrinsics {' '.join(words)}: expected a file or four numbers fx fy cx cy") from None


def _text_matrix(path: Path) -> np.ndarray:
    text = path.read_text("utf-8", "replace")
    try:
        matrix = np.array([row.replace(",", " ").split() for row in text.splitlines() if row.strip()], float)
    except ValueError:
        matrix = np.zeros((0, 0))
    if matrix.shape != (3, 3):
        raise InputError(f"{path}: expected a matrix of 3 x 3 numbers")
    return matrix


def _chosen(value: Mapping[str, Any], path: Path, image: Path | None) -> Mapping[str, Any]:
    """The entry of BOP's scene_camera.json for an image; any other object as it is."""
    rows = {key: row for key, row in value.items() if isinstance(row, dict) and "cam_K" in row}
    if not rows:
        return value
    number = str(int(image.stem)) if image is not None and image.stem.isdigit() else None
    if number in rows:
        return rows[number]
    if len({json.dumps([row["cam_K"], row.get("depth_scale")]) for row in rows.values()}) == 1:
        return next(iter(rows.values()))
    raise InputError(
        f"{path}: holds {len(rows)} cameras, none of image {number or 'without a number'}: save one of them"
    )


def _from_json(row: Mapping[str, Any], path: Path) -> Intrinsics:
    for key in MATRICES:
        if key in row:
            unit = _matrix_unit(key, row, path)
            return _from_matrix(_json_matrix(row[key], f"{path}: {key}"), row, path, unit)
    for prefix in ("", "_"):
        if f"{prefix}fx" in row and f"{prefix}fy" in row:
            return _from_fields(row, prefix, path)
    keys = ", ".join(sorted(map(str, row))[:8]) or "none"
    raise InputError(f"{path}: no intrinsics among its keys ({keys}); expected {FORMATS}")


def _from_fields(row: Mapping[str, Any], prefix: str, path: Path) -> Intrinsics:
    """Intrinsics of fx, fy and the principal point by the names of RealSense, ours, or gqcnn."""
    centre = next((names for names in CENTRES if all(name in row for name in names)), None)
    if centre is None:
        raise InputError(f"{path}: no principal point: expected cx and cy, or ppx and ppy")
    if row.get(f"{prefix}skew") is not None and abs(_number(row, f"{prefix}skew", path)) > 1e-9:
        raise InputError(f"{path}: skew {row[f'{prefix}skew']}, expected 0: no depth camera has any")
    fx, fy, cx, cy = (_number(row, name, path) for name in (f"{prefix}fx", f"{prefix}fy", *centre))
    return Intrinsics(fx, fy, cx, cy, **_beside(row, path, _field_unit(row, path)))


def _from_matrix(matrix: np.ndarray, row: Mapping[str, Any], path: Path, unit: float | None = None) -> Intrinsics:
    """Intrinsics of a matrix K, row by row or column by column: one of its corners is 0."""
    if matrix[0, 2] == 0 and matrix[2, 0] != 0:
        matrix = matrix.T
    if not np.isfinite(matrix).all() or abs(matrix[2] - (0, 0, 1)).max() > 1e-6 or abs(matrix[1, 0]) > 1e-9:
        raise InputError(f"{path}: expected a matrix fx 0 cx, 0 fy cy, 0 0 1 [px]")
    if abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]):
        raise InputError(f"{path}: skew {matrix[0, 1]:g}, expected 0: no depth camera has any")
    values = (float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]))
    return Intrinsics(*values, **_beside(row, path, unit))


def _json_matrix(value: Any, what: str) -> np.ndarray:
    """A matrix from nested lists, a flat list, or an object with `data`, as YAML of ROS has it."""
    value = value.get("data") if isinstance(value, dict) else value
    try:
        return np.array(value, float).reshape(3, 3)
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected nine numbers") from None


def _matrix_unit(key: str, row: Mapping[str, Any], path: Path) -> float | None:
    """[m] a unit: BOP's depth_scale is mm a unit, Open3D's and GraspNet's are units a metre."""
    if key == "cam_K" and "depth_scale" in row:
        return 1e-3 * _positive(row, "depth_scale", path)
    for name in ("depth_scale", "factor_depth"):
        if key in ("intrinsic_matrix", "camera_matrix") and name in row:
            return 1 / _positive(row, name, path)
    return _field_unit(row, path)


def _field_unit(row: Mapping[str, Any], path: Path) -> float | None:
    """[m] a unit, by names that say so."""
    for name in ("depth_units", "unit_m", "metres_a_unit"):
        if name in row:
            return _positive(row, name, path)
    if "depth_scale" not in row:
        return None
    scale = _positive(row, "depth_scale", path)
    if scale > LARGEST_UNIT:
        raise InputError(f"{path}: depth_scale {scale:g}: mm a unit, or units a metre? Give --depth-scale in m a unit")
    return scale


def _beside(row: Mapping[str, Any], path: Path, unit: float | None) -> dict[str, Any]:
    """What else a file says about its image."""
    sides = ((row.get(f"{prefix}width"), row.get(f"{prefix}height")) for prefix in ("", "_", "image_"))
    size = next((pair for pair in sides if None not in pair), None)
    coefficients = next((row[name] for name in ("coeffs", "distortion", "D", "d") if name in row), ())
    coefficients = (coefficients.get("data") if isinstance(coefficients, dict) else coefficients) or ()
    model = str(row.get("model") or row.get("distortion_model") or "plumb_bob").lower().removeprefix("distortion.")
    baseline = _positive(row, "baseline", path) if row.get("baseline") is not None else None
    if baseline is not None and baseline > LONGEST_BASELINE:
        raise InputError(f"{path}: baseline is {baseline:g}, expected metres, up to {LONGEST_BASELINE:g}")
    try:
        whole = None if size is None else (int(size[0] or 0), int(size[1] or 0))
        floats = tuple(float(value) for value in coefficients)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{path}: width, height or distortion are no numbers") from None
    device = str(row.get("device") or row.get("name") or "")
    known = {"unit": unit, "model": model, "coefficients": floats, "device": device, "baseline": baseline}
    return {"size": whole, "stream": _stream(row, path), "source": str(path), **known}


def _stream(row: Mapping[str, Any], path: Path) -> Stream | None:
    stream = row.get("stream")
    if stream not in (None, "raw", "aligned"):
        raise InputError(f"{path}: stream {stream!r}, expected raw (the depth camera's own) or aligned")
    return stream


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
