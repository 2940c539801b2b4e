"""What a user gives against what the camera sees: each wrong value is named with the reading that fits, or is read."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from zstandard import ZstdCompressor

from kit1000.camera import look_at
from kit1000.capture.camera_files import read_intrinsics
from kit1000.capture.camera_poses import check_base_pose, check_world_pose
from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.importing import import_scenes, imported_scenes
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.options import ImportOptions
from kit1000.capture.own_scene import OwnScene, own_scene
from kit1000.capture.pose_files import read_pose
from kit1000.errors import InputError
from kit1000.pose import Pose
from tests.samples.own_images import CAMERA, EYE, exact_depth, millimetres, noisy_depth
from tests.samples.ros_bags import CALIBRATED, DEPTH, FOLDER, RECT, bag, image, info, read

NUMBERS = tuple(str(value) for value in (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy))
UP, DISTANCE = EYE.inverse().rotate((0.0, 0.0, 1.0)), float(EYE.xyz[2])
ABOUT_X = Pose(np.array([0.0, 1.0, 0.0, 0.0]), np.zeros(3))
UPRIGHT = Pose.from_rotvec((0.0, 0.0, 0.7), (0.3, -0.2, 0.0))  # base_from_world of a robot on the table


def scalar_last(pose: Pose) -> Pose:
    w, x, y, z = pose.wxyz
    return Pose(np.array([x, y, z, w]), pose.xyz)


def in_mm(pose: Pose) -> Pose:
    return Pose(pose.wxyz, 1e3 * pose.xyz)


WRONG: dict[str, tuple[Callable[[Pose], Pose], str]] = {
    "inverse": (Pose.inverse, "inverse"),
    "OpenGL": (lambda pose: pose @ ABOUT_X, "OpenGL"),
    "scalar last": (scalar_last, "scalar last"),
    "mm": (in_mm, "in mm"),
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


W, X, Y, Z = EYE.wxyz.tolist()
POSITION = dict(zip("xyz", EYE.xyz.tolist(), strict=True))
POSES: dict[str, str] = {
    "ours.json": json.dumps({"wxyz": [W, X, Y, Z], "xyz": EYE.xyz.tolist()}),
    "named.json": json.dumps({"world_from_camera": {"wxyz": [W, X, Y, Z], "xyz": EYE.xyz.tolist()}}),
    "rows.json": json.dumps(EYE.matrix().tolist()),
    "rows.txt": "\n".join(" ".join(map(str, row)) for row in EYE.matrix().tolist()),
    "line.txt": " ".join(map(str, EYE.matrix().ravel().tolist())),
    "handeye.yaml": "parameters:\n  eye_on_hand: false\ntransformation:\n"
    + "".join(f"  {k}: {v!r}\n" for k, v in {"qw": W, "qx": X, "qy": Y, "qz": Z, **POSITION}.items()),
    "message.json": json.dumps({"transform": {"translation": POSITION, "rotation": {"x": X, "y": Y, "z": Z, "w": W}}}),
    "pose.json": json.dumps({"pose": {"position": POSITION, "orientation": {"w": W, "x": X, "y": Y, "z": Z}}}),
    "matrices.json": json.dumps({"rotation": EYE.matrix()[:3, :3].tolist(), "translation": EYE.xyz.tolist()}),
}


@pytest.mark.parametrize("name", POSES)
def test_hand_eye_files_of_many_programs_say_the_same(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(POSES[name], encoding="utf-8")
    np.testing.assert_allclose(read_pose(tmp_path / name).matrix(), EYE.matrix(), atol=1e-9)


def test_a_matrix_of_numpy_is_a_pose(tmp_path: Path) -> None:
    np.save(tmp_path / "pose.npy", EYE.matrix())
    np.testing.assert_allclose(read_pose(tmp_path / "pose.npy").matrix(), EYE.matrix(), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "fact"),
    [
        ('{"translation": [0, 0, 1], "rotation": [0, 0, 0, 1]}', "order"),
        ('{"qw": 2, "qx": 0, "qy": 0, "qz": 0, "x": 0, "y": 0, "z": 1}', "length 2"),
        ('{"qw": 1, "qx": 0, "qy": 0, "qz": 0, "x": 0, "y": 0}', "no 'z'"),
    ],
)
def test_a_pose_that_leaves_something_open_is_refused(tmp_path: Path, text: str, fact: str) -> None:
    (tmp_path / "pose.json").write_text(text)
    with pytest.raises(InputError, match=fact):
        read_pose(tmp_path / "pose.json")


COEFFICIENTS = [-0.22, 0.08, 0.001, -0.0008, 0.0]
MATRIX = [CAMERA.fx, 0, CAMERA.cx, 0, CAMERA.fy, CAMERA.cy, 0, 0, 1]
FIELDS = {"fx": CAMERA.fx, "fy": CAMERA.fy, "cx": CAMERA.cx, "cy": CAMERA.cy}
SAME_DISTORTION: dict[str, dict[str, Any]] = {
    "ros yaml": {"camera_matrix": {"data": MATRIX}, "distortion_coefficients": {"rows": 1, "data": COEFFICIENTS}},
    "array": FIELDS | {"distortion_coefficients": COEFFICIENTS},
    "nested array": FIELDS | {"dist_coeffs": [COEFFICIENTS]},
    "camel": {"cameraMatrix": MATRIX, "distCoeffs": COEFFICIENTS},
    "single": FIELDS | dict(zip(("k1", "k2", "p1", "p2", "k3"), COEFFICIENTS, strict=True)),
}


@pytest.mark.parametrize("name", SAME_DISTORTION)
@pytest.mark.parametrize("suffix", [".json", ".yaml"])
def test_distortion_is_read_under_any_usual_name(tmp_path: Path, name: str, suffix: str) -> None:
    path = tmp_path / f"camera{suffix}"
    path.write_text(json.dumps(SAME_DISTORTION[name]), encoding="utf-8")  # JSON is YAML
    found = read_intrinsics([str(path)])
    assert (found.fx, found.cy) == (CAMERA.fx, CAMERA.cy)
    assert found.coefficients == pytest.approx(COEFFICIENTS)


def test_yaml_of_opencv_is_read(tmp_path: Path) -> None:
    matrix = "!!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: {}\n"
    text = "%YAML:1.0\n---\ncamera_matrix: " + matrix.format(3, 3, MATRIX)
    (tmp_path / "cv.yaml").write_text(text + "distortion_coefficients: " + matrix.format(1, 5, COEFFICIENTS))
    found = read_intrinsics([str(tmp_path / "cv.yaml")])
    assert (found.fx, found.cx) == (CAMERA.fx, CAMERA.cx)
    assert found.coefficients == pytest.approx(COEFFICIENTS)


def test_matrices_of_numpy_and_of_one_line_are_read_with_a_baseline(tmp_path: Path) -> None:
    projection = np.hstack([np.reshape(MATRIX, (3, 3)), [[-0.055 * CAMERA.fx], [0], [0]]])
    np.save(tmp_path / "p.npy", projection)
    (tmp_path / "k.txt").write_text(" ".join(map(str, MATRIX)))
    assert read_intrinsics([str(tmp_path / "p.npy")]).baseline == pytest.approx(0.055)
    assert read_intrinsics([str(tmp_path / "k.txt")]).cy == CAMERA.cy


@pytest.mark.parametrize(("name", "value"), [("radial_distortion", [0.1]), ("depthUnit", 0.1), ("stereo_baseline", 55)])
def test_a_key_that_looks_like_distortion_unit_or_baseline_is_not_dropped(
    tmp_path: Path, name: str, value: object
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(FIELDS | {name: value}))
    with pytest.raises(InputError, match=f"the key {name} is not known"):
        read_intrinsics([str(path)])


@pytest.mark.parametrize(
    ("name", "value", "unit"),
    [
        ("png_depth_scale", 1000.0, 1e-3),
        ("DepthMapFactor", 5000, 2e-4),
        ("depth_units", 1e-4, 1e-4),
        ("factor_depth", 1000, 1e-3),
    ],
)
def test_units_are_read_under_their_usual_names(tmp_path: Path, name: str, value: float, unit: float) -> None:
    (tmp_path / "camera.json").write_text(json.dumps(FIELDS | {name: value}))
    assert read_intrinsics([str(tmp_path / "camera.json")]).unit == pytest.approx(unit)


def test_a_principal_point_far_from_the_middle_is_refused() -> None:
    with pytest.raises(InputError, match="36 % of its width"):
        Intrinsics(CAMERA.fx, CAMERA.fy, 0.86 * 640, 240.0).camera((480, 640), "x.png")


KNOWN = Intrinsics(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)


def scene_of(values: np.ndarray, **options: Any) -> OwnScene:
    given = ImportOptions(sources=(), out=Path("out"), **options)
    return own_scene([DepthFrame(values, "depth.png")], KNOWN, given)


METRES = noisy_depth(exact_depth(), 0.05)
TENTHS = np.rint(METRES * 0.4 / 1e-4).astype(np.uint16)  # a scene of 0.4 times the size, in units of 0.1 mm


def rays(depth: np.ndarray) -> np.ndarray:
    v, u = np.indices(depth.shape)
    return depth * np.sqrt(((u - CAMERA.cx) / CAMERA.fx) ** 2 + ((v - CAMERA.cy) / CAMERA.fy) ** 2 + 1)


def disparities(depth: np.ndarray) -> np.ndarray:
    return np.where(depth > 0, 50.0 / np.where(depth > 0, depth, 1), 0)


def test_a_known_device_brings_its_unit() -> None:
    scene = scene_of(TENTHS, device="D405")
    assert scene.facts.unit == 1e-4
    assert scene.table.distance == pytest.approx(0.4 * scene_of(millimetres(METRES)).table.distance, rel=0.01)


NO_DEPTH: dict[str, tuple[np.ndarray, str]] = {
    "unit": (np.rint(METRES / 1e-4).astype(np.uint16), "--depth-scale 0.0001"),
    "assumed unit": (TENTHS, "give --depth-scale 0.001 if that is so, or --depth-scale 0.0001"),
    "swapped bytes": (millimetres(METRES).byteswap(), "both bytes of each value swapped"),
    "ray lengths": (millimetres(rays(METRES)), "lengths of rays"),
    "disparities": (disparities(METRES).astype(np.float32), "disparities"),
    "codes of a range": (np.rint(np.clip((METRES - 0.4) / 0.8, 0, 1) * 60000).astype(np.uint16), "codes of a range"),
}


@pytest.mark.parametrize("name", NO_DEPTH)
def test_values_that_are_no_depths_are_named(name: str) -> None:
    values, fact = NO_DEPTH[name]
    with pytest.raises(InputError, match=fact):
        scene_of(values)


def test_noise_is_given_no_unit() -> None:
    noise = np.random.default_rng(0).integers(1, 60000, (480, 640)).astype(np.uint16)
    with pytest.raises(InputError) as refusal:
        scene_of(noise)
    assert "--depth-scale" not in str(refusal.value)


def several(folder: Path, *poses: Pose) -> ImportOptions:
    """Images from two places, with the poses that are stated."""
    eyes = [EYE, look_at((0.35, -0.3, 0.7), (0.0, 0.0, 0.0))]
    files = []
    for number, (eye, pose) in enumerate(zip(eyes, poses or eyes, strict=True)):
        np.save(folder / f"{number}.npy", exact_depth(eye=eye).astype(np.float32))
        (folder / f"{number}.json").write_text(json.dumps({"wxyz": pose.wxyz.tolist(), "xyz": pose.xyz.tolist()}))
        files.append(folder / f"{number}.npy")
    given = tuple(path.with_suffix(".json") for path in files)
    return ImportOptions(
        sources=tuple(files), out=folder / "out", intrinsics=NUMBERS, world_from_camera=given, one_scene=True
    )


def test_bodies_that_lie_apart_are_no_scene(tmp_path: Path) -> None:
    second = look_at((0.35, -0.3, 0.7), (0.0, 0.0, 0.0))
    moved = Pose(second.wxyz, second.xyz + (0.03, 0.0, 0.0))
    with pytest.raises(InputError, match=r"lie (29|30|31) mm apart"):
        import_scenes(several(tmp_path, EYE, moved))
    assert not (tmp_path / "out").exists()
    assert len(imported_scenes(several(tmp_path))) == 2
    assert any("2 images of one scene" in line for line in import_scenes(several(tmp_path)))


DISTORTED = info(d=[-0.22, 0.08, 0.001, -0.0008, 0.0], p=[500.0, 0, 320, 0, 0, 501, 240, 0, 0, 0, 1, 0])


@pytest.mark.parametrize(("topic", "focal"), [("/depth/image_rect", 500.0), ("/depth/image_raw", CAMERA.fx)])
def test_rectified_images_have_the_matrix_p_and_no_distortion(tmp_path: Path, topic: str, focal: float) -> None:
    (frame,) = read(bag(tmp_path / "bag.mcap", ("/depth/camera_info", DISTORTED), (topic, image())))
    assert frame.intrinsics is not None
    assert frame.intrinsics.fx == focal
    assert frame.intrinsics.distorted == (focal == CAMERA.fx)


def test_a_name_that_leaves_rectification_open_is_refused_with_both_readings(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"fx 500\.0"):
        read(bag(tmp_path / "bag.mcap", ("/depth/camera_info", DISTORTED), ("/depth/image", image())))


def test_a_calibration_belongs_to_a_topic_by_its_name(tmp_path: Path) -> None:
    for name in ("/rgb/camera_info", "/rgb_camera_info"):
        with pytest.raises(InputError, match=f"the recording has {name}"):
            read(bag(tmp_path / "bag.mcap", (name, info()), ("/depth", image())))


def test_messages_may_be_compressed_one_by_one_and_a_recording_as_a_whole(tmp_path: Path) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    (tmp_path / "bag.mcap.zstd").write_bytes(ZstdCompressor().compress(path.read_bytes()))
    recompressed(path, tmp_path / "each.mcap", compress=True)
    for name in ("bag.mcap.zstd", "each.mcap"):
        np.testing.assert_array_equal(read(tmp_path / name)[0].values, DEPTH)


def test_a_recording_without_chunks_is_whole(tmp_path: Path) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    recompressed(path, tmp_path / "plain.mcap", use_chunking=False)
    np.testing.assert_array_equal(read(tmp_path / "plain.mcap")[0].values, DEPTH)


def test_messages_without_a_schema_are_named(tmp_path: Path) -> None:
    with open(tmp_path / "bare.mcap", "wb") as out:
        writer = McapWriter(out)
        writer.start()
        channel = writer.register_channel("/depth", "cdr", 0)
        writer.add_message(channel, 1, b"1234", 1)
        writer.finish()
    with pytest.raises(InputError, match="/depth: messages without a schema"):
        read(tmp_path / "bare.mcap")


@pytest.mark.parametrize(("encoding", "fact"), [("ros1", "rosbags-convert"), ("json", "protobuf"), ("cdr", "ros2idl")])
def test_other_encodings_are_named_and_not_called_damaged(tmp_path: Path, encoding: str, fact: str) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    recompressed(path, tmp_path / "other.mcap", message_encoding=encoding, schema_encoding="ros2idl")
    with pytest.raises(InputError, match=fact) as refusal:
        read(tmp_path / "other.mcap")
    assert "damaged" not in str(refusal.value)


def recompressed(
    source: Path,
    target: Path,
    compress: bool = False,
    use_chunking: bool = True,
    message_encoding: str | None = None,
    schema_encoding: str | None = None,
) -> None:
    """Write the messages of a recording in another way."""
    from mcap.reader import make_reader

    with open(source, "rb") as file, open(target, "wb") as out:
        writer = McapWriter(out, use_chunking=use_chunking, compression=CompressionType.NONE)
        writer.start("ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema_encoding or schema.encoding, schema.data)
                encoding = message_encoding or channel.message_encoding
                channels[channel.id] = writer.register_channel(channel.topic, encoding, number)
            data = ZstdCompressor().compress(message.data) if compress else message.data
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time)
        writer.finish()


def test_the_report_says_where_intrinsics_come_from(tmp_path: Path) -> None:
    bag(tmp_path / "bag.mcap", (f"{FOLDER}/camera_info", info()), (RECT, image()))
    lines = import_scenes(ImportOptions(sources=(tmp_path / "bag.mcap",), out=tmp_path / "out"))
    assert any(f"{FOLDER}/camera_info" in line for line in lines)
