"""Intrinsics and poses that a user states: all dialects of one camera are the same, and what cannot be is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.capture.camera_files import SINGLE, read_intrinsics
from kit1000.capture.camera_poses import check_base_pose, check_world_pose
from kit1000.capture.intrinsics import Intrinsics, distorted
from kit1000.capture.pose_files import read_pose, stated_pose
from kit1000.dataset.json_rows import pose_row
from kit1000.errors import InputError
from kit1000.pose import Pose
from tests.samples.own_images import EYE
from tests.samples.strategies import poses

FX, FY, CX, CY = 612.5, 613.25, 322.5, 248.125
K = [FX, 0, CX, 0, FY, CY, 0, 0, 1]
BY_COLUMN = [FX, 0, 0, 0, FY, 0, CX, CY, 1]
DIALECTS: dict[str, tuple[dict[str, Any] | str, float | None]] = {  # JSON, and the unit that it states [m]
    "ours": ({"fx": FX, "fy": FY, "cx": CX, "cy": CY, "depth_units": 1e-3}, 1e-3),
    "realsense": ({"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "coeffs": [0] * 5, "depth_scale": 1e-3}, 1e-3),
    "bop": ({"cam_K": K, "depth_scale": 0.1}, 1e-4),
    "open3d": ({"width": 640, "height": 480, "intrinsic_matrix": BY_COLUMN}, None),
    "open3d recorder": ({"intrinsic_matrix": BY_COLUMN, "depth_scale": 1000.0}, 1e-3),
    "nested": ({"K": [K[:3], K[3:6], K[6:]]}, None),
    "ros": ({"image_width": 640, "image_height": 480, "camera_matrix": {"rows": 3, "cols": 3, "data": K}}, None),
}


def written(folder: Path, value: Any) -> Path:
    path = folder / "camera.json"
    path.write_text(value if isinstance(value, str) else json.dumps(value), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", DIALECTS)
def test_all_dialects_say_the_same(tmp_path: Path, name: str) -> None:
    value, unit = DIALECTS[name]
    found = read_intrinsics([str(written(tmp_path, value))])
    assert (found.fx, found.fy, found.cx, found.cy) == (FX, FY, CX, CY)
    assert found.unit == (None if unit is None else pytest.approx(unit))
    assert found.size in (None, (640, 480))
    assert not found.distorted


def test_numbers_and_files_of_a_matrix_say_the_same(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "K.txt", np.reshape(K, (3, 3)))
    np.save(tmp_path / "K.npy", np.reshape(K, (3, 3)))
    files = [[str(tmp_path / "K.txt")], [str(tmp_path / "K.npy")]]
    for words in (*files, [str(value) for value in (FX, FY, CX, CY)]):
        found = read_intrinsics(words)
        assert (found.fx, found.fy, found.cx, found.cy) == (FX, FY, CX, CY)


def test_the_number_of_the_image_chooses_among_cameras(tmp_path: Path) -> None:
    other = [FX + 1, *K[1:]]
    path = str(written(tmp_path, {"3": {"cam_K": K, "depth_scale": 1.0}, "4": {"cam_K": other, "depth_scale": 1.0}}))
    assert read_intrinsics([path], Path("000004.png")).fx == FX + 1
    with pytest.raises(InputError, match="2 cameras"):
        read_intrinsics([path], Path("image.png"))


HOSTILE = {  # by what is in the file: facts of the message
    "[1, 2]": "3 x 3 numbers",
    "7": "object of named values",
    "{": "damaged or no JSON",
    '{"focal": 1}': "focal",
    '{"fx": 1, "fy": 1}': "principal point",
    '{"fx": "wide", "fy": 1, "cx": 1, "cy": 1}': "wide",
    '{"fx": -1, "fy": 1, "cx": 1, "cy": 1}': "above 0",
    '{"fx": 1e999, "fy": 1, "cx": 1, "cy": 1}': "finite",
    '{"K": [1, 2, 3]}': "3 x 3 numbers",
    '{"K": [600, 5, 320, 0, 600, 240, 0, 0, 1]}': "skew 5",
    '{"K": [0, 0, 0, 0, 0, 0, 0, 0, 0]}': "0 0 1",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "depth_scale": 1.5}': "--depth-scale",
    '{"cam_K": [600, 0, 320, 0, 600, 240, 0, 0, 1], "depth_scale": 0}': "above 0",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "stream": "colour"}': "raw",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "radial_distortion": [0.1]}': "the key radial_distortion",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "depthUnit": 0.1}': "the key depthUnit",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "DepthMapFactor": 5000}': "the key DepthMapFactor",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "stereo_baseline": 55}': "the key stereo_baseline",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "width": Infinity, "height": 480}': "width",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "coeffs": ["a"]}': "distortion",
    '{"fx": 600, "fy": 600, "cx": 320, "cy": 240, "baseline": 55}': "baseline is 55, expected metres",
    "[" * 100_000 + "]" * 100_000: "object of named values",
}


@pytest.mark.parametrize("content", HOSTILE, ids=lambda content: content[:60])
def test_what_is_no_camera_is_refused_in_one_line(tmp_path: Path, content: str) -> None:
    with pytest.raises(InputError) as refusal:
        read_intrinsics([str(written(tmp_path, content))])
    assert HOSTILE[content] in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_intrinsics_of_another_size_are_refused() -> None:
    known = Intrinsics(FX, FY, CX, CY, size=(640, 480))
    assert known.camera((480, 640), "x.png").width == 640
    with pytest.raises(InputError, match=r"640 x 480.*1280 x 720"):
        known.camera((720, 1280), "x.png")
    with pytest.raises(InputError, match="36 % of its width"):
        Intrinsics(FX, FY, 0.86 * 640, CY).camera((480, 640), "x.png")


@pytest.mark.parametrize("focal", [(1.93, 1.93), (FX, 0.2 * FX), (1e9, 1e9)])
def test_focal_lengths_of_no_depth_camera_are_refused(focal: tuple[float, float]) -> None:
    """As of lengths in mm, or of numbers in another order."""
    with pytest.raises(InputError, match=r"focal lengths \S+, \S+ px, x\.png is 640 px wide"):
        Intrinsics(*focal, CX, CY).camera((480, 640), "x.png")


def test_an_empty_or_missing_distortion_is_none(tmp_path: Path) -> None:
    for coefficients in (None, [], {"data": None}):
        value = {"fx": FX, "fy": FY, "cx": CX, "cy": CY, "coeffs": coefficients, "baseline": None}
        assert not read_intrinsics([str(written(tmp_path, value))]).distorted


@pytest.mark.parametrize("text", ["", "a b c", "600 0 320\n0 600 240\n0 0\n", "600 0 320 -33\n0 600 240 0\n0 0 1 0"])
def test_a_text_file_without_a_matrix_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "k.txt").write_text(text)
    with pytest.raises(InputError, match="3 x 3 numbers"):
        read_intrinsics([str(tmp_path / "k.txt")])


COEFFICIENTS = [-0.22, 0.08, 0.001, -0.0008, 0.0]
FIELDS = {"fx": FX, "fy": FY, "cx": CX, "cy": CY}
SAME_DISTORTION: dict[str, dict[str, Any]] = {
    "ros": {"camera_matrix": {"data": K}, "distortion_coefficients": {"rows": 1, "data": COEFFICIENTS}},
    "nested": FIELDS | {"coeffs": [COEFFICIENTS]},
    "single": FIELDS | dict(zip(("k1", "k2", "p1", "p2", "k3"), COEFFICIENTS, strict=True)),
    "of eight": FIELDS | dict(zip(SINGLE, [*COEFFICIENTS, 0, 0, 0], strict=True)),
}


@pytest.mark.parametrize("name", SAME_DISTORTION)
@pytest.mark.parametrize("suffix", [".json", ".yaml"])
def test_distortion_is_read_under_any_usual_name(tmp_path: Path, name: str, suffix: str) -> None:
    path = tmp_path / f"camera{suffix}"
    path.write_text(json.dumps(SAME_DISTORTION[name]), encoding="utf-8")  # JSON is YAML
    found = read_intrinsics([str(path)])
    assert (found.fx, found.cy) == (FX, CY)
    assert found.coefficients == pytest.approx(COEFFICIENTS)
    assert found.forward_model == "plumb_bob"


@given(
    st.floats(-0.6, 0.6), st.floats(-0.5, 0.5), st.lists(st.floats(-0.05, 0.05), min_size=5, max_size=5)
)  # fmt: skip
def test_distortion_is_that_of_the_formula(x: float, y: float, coefficients: list[float]) -> None:
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    down = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    found = distorted(np.array(x), np.array(y), tuple(coefficients))
    np.testing.assert_allclose([float(value) for value in found], [across, down], atol=1e-12)


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
