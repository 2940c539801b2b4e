"""Intrinsics from files: JSON, YAML, .npy or text of BOP, Open3D, RealSense, ROS, OpenCV, gqcnn or ours, or numbers.

Two formats say `depth_scale` and mean the inverse: BOP's is mm a unit, Open3D's is units a metre. The other keys of a
file say which of them it is. A key that looks like distortion, a unit or a baseline and is not known is refused:
dropped without a word it would bend or scale the scene.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.pose_files import TEXTS, YAMLS, read_yaml
from kit1000.errors import InputError
from kit1000.files import read_json
from kit1000.sim.sensors import Stream

LARGEST_UNIT = 0.02  # [m] up to which a scale is a length of a unit
LEAST_COUNT = 20.0  # from which a scale is a number of units a metre
LONGEST_BASELINE = 1.0  # [m]
MOST_BYTES = 10_000_000
FORMATS = (
    "JSON or YAML with fx, fy, cx, cy, or cam_K, K, camera_matrix or intrinsic_matrix; .npy or text of 3 x 3 or 3 x 4 "
    "numbers; or fx fy cx cy"
)
MATRICES = ("cam_K", "intrinsic_matrix", "camera_matrix", "cameraMatrix", "Camera_Matrix", "mtx", "M1", "K", "k")
CENTRES = (("cx", "cy"), ("ppx", "ppy"), ("_cx", "_cy"))
COEFFICIENTS = (
    "coeffs",
    "distortion",
    "distortion_coefficients",
    "distortion_coeffs",
    "distortionCoefficients",
    "Distortion_Coefficients",
    "dist_coeffs",
    "dist_coeff",
    "distCoeffs",
    "dist",
    "D1",
    "D",
    "d",
)
"""Keys of an array of coefficients in OpenCV's order, or of a mapping with `data`."""
SINGLE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Keys of single coefficients, in OpenCV's order."""
UNIT_KEYS = ("depth_units", "unit_m", "metres_a_unit")
"""[m] that 1 stands for."""
SCALE_KEYS = ("depth_scale", "png_depth_scale", "depthscale", "DepthMapFactor", "factor_depth", "depth_factor")
"""Either [m] that 1 stands for, or units a metre: the size of the number says which."""
READ = {
    *(*MATRICES, *COEFFICIENTS, *SINGLE, *UNIT_KEYS, *SCALE_KEYS),
    *("model", "distortion_model", "baseline", "depth_scale", "skew", "_skew"),
}
SUSPICIOUS = re.compile(r"dist(?!ance)|coeff|radial|tangential|scale|factor|unit|baseline|^_?[kp][1-9]$", re.IGNORECASE)


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
    suffix = path.suffix.lower()
    if suffix in TEXTS or suffix == ".npy":
        return _from_matrix(_stored_matrix(path), {}, path)
    if suffix == ".xml":
        raise InputError(f"{path}: XML is not read; save it with cv.FileStorage as .yaml, or give {FORMATS}")
    try:
        value = read_yaml(path) if suffix in YAMLS else read_json(path)
    except RecursionError:
        value = None
    if not isinstance(value, dict):
        raise InputError(f"{path}: expected an object of named values; known are {FORMATS}")
    return _from_row(_chosen(value, path, image), path)


def _numbers(words: Sequence[str]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise InputError(f"--intrinsics {' '.join(words)}: expected a file or four numbers fx fy cx cy") from None


def _stored_matrix(path: Path) -> np.ndarray:
    """(3, 3) or (3, 4) the numbers of a .npy file or of a text, also all in one line."""
    try:
        if path.suffix.lower() == ".npy":
            numbers = np.asarray(np.load(path, allow_pickle=False), float)
        else:
            text = path.read_text("utf-8", "replace").replace(",", " ").replace("[", " ").replace("]", " ")
            numbers = np.array(text.split(), float)
    except (OSError, ValueError):
        numbers = np.zeros(0)
    if numbers.size not in (9, 12):
        raise InputError(f"{path}: expected a matrix of 3 x 3 or 3 x 4 numbers; known are {FORMATS}")
    return numbers.reshape(3, -1)


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


def _from_row(row: Mapping[str, Any], path: Path) -> Intrinsics:
    _check_keys(row, path)
    for key in MATRICES:
        if key in row:
            unit = _matrix_unit(key, row, path)
            return _from_matrix(_row_matrix(row[key], f"{path}: {key}"), row, path, unit)
    for prefix in ("", "_"):
        if f"{prefix}fx" in row and f"{prefix}fy" in row:
            return _from_fields(row, prefix, path)
    keys = ", ".join(sorted(map(str, row))[:8]) or "none"
    raise InputError(f"{path}: no intrinsics among its keys ({keys}); expected {FORMATS}")


def _check_keys(row: Mapping[str, Any], path: Path) -> None:
    """Raise InputError for a key that looks like distortion, a unit or a baseline, and that nothing here reads."""
    for name, value in row.items():
        if str(name) not in READ and SUSPICIOUS.search(str(name)) and not _says_nothing(value):
            raise InputError(
                f"{path}: the key {name} is not known, and looks like distortion, a unit or a baseline: rename it "
                f"(distortion_coefficients, depth_units in m, baseline in m), or delete it"
            )


def _says_nothing(value: Any) -> bool:
    """Whether a value leaves an image as it is: none, 0, or a factor of 1."""
    flat = [value] if not isinstance(value, list) else value
    return value in (None, "", {}) or all(number in (0, 0.0) for number in flat) or value in (1, 1.0)


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
    """Intrinsics of a matrix K (3, 3), row by row or column by column, or of P (3, 4), which may have a baseline."""
    k = matrix[:, :3]
    if k[0, 2] == 0 and k[2, 0] != 0:
        k = k.T
    if not np.isfinite(matrix).all() or abs(k[2] - (0, 0, 1)).max() > 1e-6 or abs(k[1, 0]) > 1e-9:
        raise InputError(f"{path}: expected a matrix fx 0 cx, 0 fy cy, 0 0 1 [px]")
    if abs(k[0, 1]) > 1e-6 * abs(k[0, 0]):
        raise InputError(f"{path}: skew {k[0, 1]:g}, expected 0: no depth camera has any")
    beside = _beside(row, path, unit)
    if matrix.shape[1] == 4 and matrix[0, 3] != 0 and beside["baseline"] is None:
        beside["baseline"] = _checked_baseline(abs(float(matrix[0, 3] / k[0, 0])), path)  # P[0, 3] = -fx x baseline
    return Intrinsics(float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), **beside)


def _row_matrix(value: Any, what: str) -> np.ndarray:
    """A matrix (3, 3) or (3, 4) from nested lists, a flat list, or a mapping with `data`, as YAML has it."""
    value = value.get("data") if isinstance(value, dict) else value
    try:
        numbers = np.array(value, float)
        return numbers.reshape(3, 4 if numbers.size == 12 else 3)
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected nine numbers, or twelve") from None


def _matrix_unit(key: str, row: Mapping[str, Any], path: Path) -> float | None:
    """[m] a unit: BOP's depth_scale is mm a unit, Open3D's and GraspNet's are units a metre."""
    if key == "cam_K" and "depth_scale" in row:
        return 1e-3 * _positive(row, "depth_scale", path)
    if key in ("intrinsic_matrix", "camera_matrix"):
        for name in ("depth_scale", "factor_depth"):
            if name in row and _positive(row, name, path) >= 1:
                return 1 / _positive(row, name, path)
    return _field_unit(row, path)


def _field_unit(row: Mapping[str, Any], path: Path) -> float | None:
    """[m] a unit, by names that say so, or by a scale whose size says what it is."""
    for name in UNIT_KEYS:
        if name in row:
            return _positive(row, name, path)
    name = next((name for name in SCALE_KEYS if row.get(name) is not None), None)
    if name is None:
        return None
    scale = _positive(row, name, path)
    if LARGEST_UNIT < scale < LEAST_COUNT:
        raise InputError(f"{path}: {name} {scale:g}: mm a unit, or units a metre? Give --depth-scale in m a unit")
    return scale if scale <= LARGEST_UNIT else 1 / scale


def _beside(row: Mapping[str, Any], path: Path, unit: float | None) -> dict[str, Any]:
    """What else a file says about its image."""
    sides = ((row.get(f"{prefix}width"), row.get(f"{prefix}height")) for prefix in ("", "_", "image_"))
    size = next((pair for pair in sides if None not in pair), None)
    model = str(row.get("model") or row.get("distortion_model") or "plumb_bob").lower().removeprefix("distortion.")
    baseline = row.get("baseline")
    try:
        whole = None if size is None else (int(size[0] or 0), int(size[1] or 0))
        floats = tuple(np.array(_coefficients(row), float).ravel().tolist())
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{path}: width, height or distortion are no numbers") from None
    return {
        "size": whole,
        "unit": unit,
        "model": model,
        "coefficients": floats,
        "device": str(row.get("device") or row.get("name") or ""),
        "baseline": None if baseline is None else _checked_baseline(_positive(row, "baseline", path), path),
        "stream": _stream(row, path),
        "source": str(path),
    }


def _coefficients(row: Mapping[str, Any]) -> Any:
    """The distortion of a file: an array by one of many names, a mapping with `data`, or single numbers."""
    value = next((row[name] for name in COEFFICIENTS if row.get(name) is not None), None)
    if isinstance(value, Mapping):
        value = value["data"] if "data" in value else [value.get(name, 0) for name in SINGLE]
    if value is None and any(name in row for name in SINGLE) and not isinstance(row.get("k1"), list):
        value = [row.get(name) or 0 for name in SINGLE]
    value = [] if value is None else value
    return value[:5] if len(value) == 8 and not any(np.array(value[5:], float)) else value


def _checked_baseline(baseline: float, path: Path) -> float:
    if baseline > LONGEST_BASELINE:
        raise InputError(f"{path}: baseline is {baseline:g}, expected metres, up to {LONGEST_BASELINE:g}")
    return baseline


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
