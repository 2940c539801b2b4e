"""Recordings of ROS 2, of Foxglove and of ours: what was recorded is read, and damage is one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from kit1000.capture.depth_frames import metric_depth
from kit1000.errors import InputError
from tests.samples import recorded
from tests.samples.own_images import CAMERA, exact_depth
from tests.samples.ros_bags import CALIBRATED, DEPTH, FOLDER, RECT, bag, compressed, image, info, read, stamped

COLOUR = ("/camera/color/image_raw", image(np.zeros((48, 64, 3), np.uint8), "rgb8", "colour"))
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
    np.testing.assert_allclose(metric_depth(frame, frame.unit or 1.0), exact_depth(), atol=0.51e-3)
    known = frame.intrinsics
    assert known is not None
    assert (known.fx, known.fy, known.cx, known.cy) == (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    assert (known.stream, known.source) == ("raw", f"{tmp_path / 'bag.mcap'} {FOLDER}/camera_info")


def test_rows_may_be_padded(tmp_path: Path) -> None:
    padded = np.concatenate([DEPTH, np.full((len(DEPTH), 7), 9, np.uint16)], axis=1)
    (frame,) = read(bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image(padded, width=DEPTH.shape[1]))))
    np.testing.assert_array_equal(frame.values, DEPTH)


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
    with pytest.raises(InputError, match="rosbags-convert"):
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
    "short": ([CALIBRATED, (RECT, image(data=b"1234"))], "4 bytes for 640 x 480"),
    "narrow steps": ([CALIBRATED, (RECT, image(step=8))], "steps of 8"),
    "rvl": ([CALIBRATED, (f"{RECT}/compressedDepth", compressed(form="16UC1; compressedDepth rvl"))], "rvl"),
    "packed floats": (
        [CALIBRATED, (f"{RECT}/compressedDepth", compressed(form="32FC1; compressedDepth png"))],
        "16UC1",
    ),
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
    path = bag(tmp_path / "bag.mcap", COLOUR, (RECT, image()))
    with pytest.raises(InputError, match=r"bag\.mcap .*no intrinsics beside it.*--intrinsics"):
        read(path)
    assert read(path, intrinsics=("1", "1", "1", "1"))[0].intrinsics is None


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


def test_messages_without_a_schema_are_named(tmp_path: Path) -> None:
    with open(tmp_path / "bare.mcap", "wb") as out:
        writer = McapWriter(out)
        writer.start()
        channel = writer.register_channel("/depth", "cdr", 0)
        writer.add_message(channel, 1, b"1234", 1)
        writer.finish()
    with pytest.raises(InputError, match="/depth: messages without a schema"):
        read(tmp_path / "bare.mcap")


@pytest.mark.parametrize("encoding", ["ros1", "json", "cdr"])
def test_other_encodings_are_named_and_not_called_damaged(tmp_path: Path, encoding: str) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    rewritten(path, tmp_path / "other.mcap", message_encoding=encoding, schema_encoding="ros2idl")
    with pytest.raises(InputError, match="expected cdr with ros2msg, or protobuf"):
        read(tmp_path / "other.mcap")


def test_messages_that_are_compressed_one_by_one_are_named(tmp_path: Path) -> None:
    path = bag(tmp_path / "bag.mcap", CALIBRATED, (RECT, image()))
    rewritten(path, tmp_path / "other.mcap", packed=zstandard.compress)
    with pytest.raises(InputError, match="each message is compressed"):
        read(tmp_path / "other.mcap")


def rewritten(
    source: Path,
    target: Path,
    message_encoding: str | None = None,
    schema_encoding: str | None = None,
    packed: Callable[[bytes], bytes] = bytes,
) -> None:
    """Write the messages of a recording in another way."""
    with open(source, "rb") as file, open(target, "wb") as out:
        writer = McapWriter(out, compression=CompressionType.NONE)
        writer.start("ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema_encoding or schema.encoding, schema.data)
                encoding = message_encoding or channel.message_encoding
                channels[channel.id] = writer.register_channel(channel.topic, encoding, number)
            writer.add_message(channels[channel.id], message.log_time, packed(message.data), message.publish_time)
        writer.finish()
