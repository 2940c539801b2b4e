"""Recordings of ROS 2, of Foxglove and of ours: what was recorded is read, and damage is one line."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer
from PIL import Image

from kit1000.capture.depth_frames import DepthFrame, metric_depth
from kit1000.capture.frame_selection import Selection
from kit1000.capture.frame_sources import read_groups
from kit1000.capture.own_scene import Wanted, own_scene
from kit1000.errors import InputError
from tests.samples import recorded
from tests.samples.own_images import CAMERA, exact_depth, millimetres

HEADER = """std_msgs/Header header
{}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE = HEADER.format("uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data")
COMPRESSED = HEADER.format("string format\nuint8[] data")
INFO = HEADER.format(
    "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
    "uint32 binning_x\nuint32 binning_y"
)
SCHEMAS = {"Image": IMAGE, "CompressedImage": COMPRESSED, "CameraInfo": INFO}
DEPTH = millimetres(exact_depth())
FOLDER = "/camera/depth"
RECT = f"{FOLDER}/image_rect_raw"
FRAME = "depth_optical"


def stamped(frame: str = FRAME) -> dict[str, Any]:
    return {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": frame}


def image(values: np.ndarray = DEPTH, encoding: str = "16UC1", frame: str = FRAME, **changes: Any) -> dict[str, Any]:
    height, width = values.shape[:2]
    rows = np.ascontiguousarray(values)
    row = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": rows.strides[0]}
    return {"kind": "Image", "header": stamped(frame), **row, "data": rows.tobytes(), **changes}


def compressed(
    values: np.ndarray = DEPTH, form: str = "16UC1; compressedDepth png", head: tuple = (0, 0.0, 0.0)
) -> dict:
    file = io.BytesIO()
    Image.fromarray(values).save(file, "PNG")
    data = struct.pack("<iff", *head) + file.getvalue()
    return {"kind": "CompressedImage", "header": stamped(), "format": form, "data": data}


def info(**changes: Any) -> dict[str, Any]:
    size = {"height": CAMERA.height, "width": CAMERA.width}
    k = [CAMERA.fx, 0.0, CAMERA.cx, 0.0, CAMERA.fy, CAMERA.cy, 0.0, 0.0, 1.0]
    row = {"distortion_model": "plumb_bob", "d": [0.0] * 5, "k": k, "binning_x": 0, "binning_y": 0}
    return {"kind": "CameraInfo", "header": stamped(), **size, **row, **changes}


def bag(path: Path, *messages: tuple[str, dict[str, Any]]) -> Path:
    """A ROS 2 bag of messages by topic."""
    with path.open("wb") as file:
        writer = Writer(file)
        schemas = {name: writer.register_msgdef(f"sensor_msgs/msg/{name}", text) for name, text in SCHEMAS.items()}
        for time, (topic, row) in enumerate(messages, start=1):
            values = {key: value for key, value in row.items() if key != "kind"}
            writer.write_message(topic, schemas[row["kind"]], values, time, time)
        writer.finish()
    return path


def read(path: Path, **selection: Any) -> list[DepthFrame]:
    (group,) = read_groups([path], Selection(**selection))
    return group


COLOUR = ("/camera/color/image_raw", image(np.zeros((48, 64, 3), np.uint8), "rgb8", "colour"))
CALIBRATED = (f"{FOLDER}/camera_info", info())
METRES = exact_depth().astype(np.float32)
SAME = {
    "raw": (RECT, image()),
    "mono16": (RECT, image(encoding="mono16")),
    "floats": (RECT, image(METRES, "32FC1")),
    "big-endian": (RECT, image(DEPTH.astype(">u2"), is_bigendian=1)),
    "compressed": (f"{RECT}/compressedDepth", compressed()),
}


@pytest.mark.parametrize("name", SAME)
def test_a_bag_is_read_with_its_intrinsics(tmp_path: Path, name: str) -> None:
    (frame,) = read(bag(tmp_path / "bag.mcap", CALIBRATED, COLOUR, SAME[name]))
    np.testing.assert_allclose(metric_depth(frame), exact_depth(), atol=0.51e-3)
    known = frame.intrinsics
    assert known is not None
    assert (known.fx, known.fy, known.cx, known.cy) == (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    assert known.stream == "raw"


def test_rows_may_be_padded(tmp_path: Path) -> None:
    padded = np.concatenate([DEPTH, np.full((len(DEPTH), 7), 9, np.uint16)], axis=1)
    (frame,) = read(bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image(padded, width=DEPTH.shape[1]))))
    np.testing.assert_array_equal(frame.values, DEPTH)


def test_compressed_floats_are_unpacked(tmp_path: Path) -> None:
    """As compressed_depth_image_transport packs them: A / depth + B in steps."""
    scale, offset = 1000.0, -3.5
    steps = np.where(METRES > 0, np.rint(scale / np.where(METRES > 0, METRES, 1) + offset), 0).astype(np.uint16)
    message = compressed(steps, "32FC1; compressedDepth png", (0, scale, offset))
    (frame,) = read(bag(tmp_path / "bag.mcap", CALIBRATED, (f"{RECT}/compressedDepth", message)))
    np.testing.assert_allclose(metric_depth(frame), METRES, atol=1e-3)


def test_frames_are_taken_in_order(tmp_path: Path) -> None:
    messages = [(RECT, image(DEPTH + np.uint16(n))) for n in range(5)]
    path = bag(tmp_path / "bag.mcap", CALIBRATED, *messages)
    for n, frame in enumerate(read(path, first=1, frames=3), start=1):
        np.testing.assert_array_equal(frame.values, DEPTH + n)
    with pytest.raises(InputError, match=r"2 frames from 3 on, expected 3"):
        read(path, first=3, frames=3)


def test_a_folder_of_ros_is_read(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    bag(tmp_path / "bag" / "bag_0.mcap", CALIBRATED, (RECT, image()))
    np.testing.assert_array_equal(read(tmp_path / "bag")[0].values, DEPTH)
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "old_0.db3").touch()
    with pytest.raises(InputError, match="ros2 bag convert"):
        read(tmp_path / "old")


def test_our_own_recordings_are_read(tmp_path: Path) -> None:
    observation = recorded.observation(0, recorded.BIG)
    path = recorded.write(tmp_path / "own.mcap", [observation])
    with pytest.raises(InputError, match=r"/d415/depth, /ideal/depth; choose one with --topic"):
        read(path)
    (frame,) = read(path, topic="/ideal/depth")
    np.testing.assert_array_equal(frame.values, observation.views["ideal"].depth)
    assert frame.intrinsics is not None
    assert frame.intrinsics.camera(frame.values.shape, "x") == recorded.BIG


REFUSED: dict[str, tuple[list[tuple[str, dict[str, Any]]], str]] = {
    "no depth": ([COLOUR, CALIBRATED], "no depth topic among /camera/color/image_raw"),
    "two topics": ([(RECT, image()), ("/other/depth", image()), CALIBRATED], "2 depth topics"),
    "another frame": ([(f"{FOLDER}/camera_info", info(header=stamped("colour"))), (RECT, image())], "another stream"),
    "not calibrated": ([(f"{FOLDER}/camera_info", info(k=[0.0] * 9)), (RECT, image())], "not calibrated"),
    "binned": ([(f"{FOLDER}/camera_info", info(binning_x=2)), (RECT, image())], "binned 2 times"),
    "short": ([CALIBRATED, (RECT, image(data=b"1234"))], "4 bytes for 640 x 480"),
    "narrow steps": ([CALIBRATED, (RECT, image(step=8))], "steps of 8"),
    "rvl": ([CALIBRATED, (f"{RECT}/compressedDepth", compressed(form="16UC1; compressedDepth rvl"))], "RVL"),
    "8 bits": ([CALIBRATED, (f"{RECT}/compressedDepth", compressed(DEPTH.astype(np.uint8)))], "16 bits of grey"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    messages, fact = REFUSED[name]
    with pytest.raises(InputError) as refusal:
        read(bag(tmp_path / "bag.mcap", *messages))
    assert fact in str(refusal.value)
    assert "bag.mcap" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_without_calibration_intrinsics_are_asked_for(tmp_path: Path) -> None:
    frames = read(bag(tmp_path / "bag.mcap", COLOUR, (RECT, image())))
    assert frames[0].intrinsics is None
    with pytest.raises(InputError, match=r"bag\.mcap .*record CameraInfo too, or give --intrinsics"):
        own_scene(frames, None, Wanted())


def test_an_unknown_topic_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    with pytest.raises(InputError, match=f"did you mean {RECT}"):
        read(path, topic=f"{RECT}s")
    with pytest.raises(InputError, match="rgb8"):
        read(bag(tmp_path / "colour.mcap", COLOUR), topic=COLOUR[0])


def without_index(path: Path) -> None:
    """A file as a crash leaves it."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        file.flush()


DAMAGED: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("hello " * 99),
    "cut": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "last byte": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "without an index": without_index,
    "overwritten": lambda path: path.write_bytes(path.read_bytes()[:200] + b"\xff" * 999 + path.read_bytes()[1199:]),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_recording_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    DAMAGED[name](path)
    with pytest.raises(InputError) as refusal:
        read(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_huge_file_is_not_loaded(tmp_path: Path) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    with path.open("rb+") as file:
        file.truncate(1 << 36)  # sparse: it takes no disk
    with pytest.raises(InputError, match="damaged or cut off"):
        read(path)
