"""Depth frames and intrinsics of MCAP recordings: ROS 2 bags, Foxglove, and ours.

Only the chunks of the chosen topic are read. Messages of ROS 2 and Foxglove have fields of the same names, but K and D
of calibrations are capitals in Foxglove's schemas and small letters in those of ROS 2.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.reader import SeekingReader
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory
from PIL import Image

from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.known_sensors import known_baseline
from kit1000.capture.options import ImportOptions
from kit1000.errors import InputError, Kit1000Error, did_you_mean
from kit1000.sim.sensors import Stream

MOST_RECORD = 1 << 30  # [bytes] of a record, and of a chunk when decompressed
RAW = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
"""Encodings of raw depth images, with their types."""
UNITS = {"u": 1e-3, "f": 1.0}  # [m], by REP 118 of ROS
ROS, FOXGLOVE = ("sensor_msgs/msg/", "sensor_msgs/"), ("foxglove.", "foxglove_msgs/msg/")
RAW_SCHEMAS = (*(f"{package}Image" for package in ROS), *(f"{package}RawImage" for package in FOXGLOVE))
PACKED_SCHEMAS = tuple(f"{package}CompressedImage" for package in (*ROS, *FOXGLOVE))
CAMERA_SCHEMAS = (
    *(f"{package}CameraInfo" for package in ROS),
    *(f"{package}CameraCalibration" for package in FOXGLOVE),
)
PACKED_HEADER = 12  # [bytes] of compressedDepth
PNG = b"\x89PNG\r\n\x1a\n"
ZSTD = b"\x28\xb5\x2f\xfd"
LEAST_SHIFT = 0.5  # [px] between K and P, of which they are two matrices
OTHER_IMAGERS = ("rgb", "color", "colour", "infra", "left", "right")
"""Words in the name of a calibration that is not that of depth, unless the depth topic has them too."""
FIX = "record it again; of a recording that was cut off, `mcap recover` makes a whole one"
SUFFIXES = ("/compressedDepth", "/compressed")  # of topics of image_transport
MOST_LISTED = 6  # topics in a message


class _Recording:
    """An open recording."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self.path, self.file = path, file
        summary = SeekingReader(file, record_size_limit=MOST_RECORD).get_summary()
        if summary is None or not summary.chunk_indexes:
            raise InputError(f"{path}: without an index of chunks; {FIX}")
        if any(chunk.uncompressed_size > MOST_RECORD for chunk in summary.chunk_indexes):
            raise InputError(f"{path}: a chunk of more than {MOST_RECORD >> 30} GiB; {FIX}")
        schemas = {number: schema.name for number, schema in summary.schemas.items()}
        self.schemas = {each.topic: schemas.get(each.schema_id, "") for each in summary.channels.values()}
        """Names of schemas by topic; empty for messages without one."""

    def topics(self, schemas: tuple[str, ...]) -> list[str]:
        """The topics of messages of some schemas."""
        return sorted(topic for topic, schema in self.schemas.items() if schema in schemas)

    def messages(self, topic: str) -> Iterator[Any]:
        """The messages of a topic, decoded, in the order of time."""
        self.file.seek(0)
        factories = ProtobufFactory(), Ros2Factory()
        reader = SeekingReader(self.file, record_size_limit=MOST_RECORD)
        for schema, channel, message in reader.iter_messages(topics=[topic]):
            if message.data.startswith(ZSTD):
                raise InputError(
                    f"{self.path} {topic}: each message is compressed, which is not read: record without "
                    "--compression-mode message, or convert it by `ros2 bag convert`"
                )
            decoders = (factory.decoder_for(channel.message_encoding, schema) for factory in factories)
            decoder = next(filter(None, decoders), None)
            if decoder is None:
                raise InputError(
                    f"{self.path} {topic}: messages in an encoding that is not read, expected cdr with ros2msg, or "
                    "protobuf; save images as 16-bit PNG, or convert a ROS 1 bag by rosbags-convert"
                )
            yield decoder(message.data)

    def first(self, topic: str) -> Any:
        """The first message of a topic; None if it has none."""
        return next(self.messages(topic), None)


def read_recording(path: Path, options: ImportOptions) -> list[DepthFrame]:
    """The chosen frames of a recording, an MCAP file, with the intrinsics recorded beside them.

    Raises InputError if it is damaged, is in another encoding, has no depth topic or several, or has too few frames.
    """
    try:
        with open(path, "rb") as file:
            return _frames(_Recording(path, file), options)
    except Kit1000Error:
        raise
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # damaged bytes raise anything in libraries
        text = " ".join(f"{type(error).__name__} {error}".split())[:160]
        raise InputError(f"{path}: damaged or cut off ({text}); {FIX}") from None


def _frames(recording: _Recording, options: ImportOptions) -> list[DepthFrame]:
    topic = _depth_topic(recording, options.topic)
    source = f"{recording.path} {topic}"
    messages = list(islice(recording.messages(topic), options.first, options.first + options.frames))
    if len(messages) < options.frames:
        found = f"{len(messages)} frames from {options.first} on"
        raise InputError(f"{source}: {found}, expected {options.frames}: lower --frames")
    values_of = _raw_values if recording.schemas[topic] in RAW_SCHEMAS else _packed_values
    images = [values_of(message, source) for message in messages]
    intrinsics = None if options.intrinsics else _intrinsics(recording, topic, messages[0])
    return [DepthFrame(values, source, UNITS[values.dtype.kind], intrinsics) for values in images]


def _depth_topic(recording: _Recording, wanted: str | None) -> str:
    """The topic of depth images: the wanted one, or the only one."""
    images = recording.topics((*RAW_SCHEMAS, *PACKED_SCHEMAS))
    if wanted is not None:
        if wanted not in images:
            hint = did_you_mean(wanted, images)
            raise InputError(f"{recording.path}: no image topic {wanted}; {hint}there are {_listed(images)}")
        return wanted
    found = [topic for topic in images if _shows_depth(recording, topic)]
    plain = [topic for topic in found if not topic.endswith(SUFFIXES)]
    found = plain + [topic for topic in found if topic.endswith(SUFFIXES) and _base(topic) not in plain]
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(f"{recording.path}: {len(found)} depth topics, {_listed(found)}; choose one with --topic")
    bare = recording.topics(("",))
    without = f"; {_listed(bare)}: messages without a schema are not read" if bare else ""
    names = _listed(images or sorted(recording.schemas))
    raise InputError(f"{recording.path}: no depth topic among {names}{without}; name one with --topic, or record depth")


def _shows_depth(recording: _Recording, topic: str) -> bool:
    """Whether the first image of a topic is a depth image, by its encoding or its first bytes."""
    message = recording.first(topic)
    if message is None or recording.schemas[topic] in RAW_SCHEMAS:
        return message is not None and message.encoding in RAW
    data = bytes(message.data[:32])
    return "compressedDepth" in message.format or (data.startswith(PNG) and data[24:26] == b"\x10\x00")  # 16 bit grey


def _raw_values(message: Any, source: str) -> np.ndarray:
    height, width, step, data = int(message.height), int(message.width), int(message.step), bytes(message.data)
    if message.encoding not in RAW:
        raise InputError(f"{source}: encoding {message.encoding}, expected {', '.join(RAW)}: not depths")
    dtype = np.dtype((">" if getattr(message, "is_bigendian", 0) else "<") + RAW[message.encoding])
    if step < width * dtype.itemsize or len(data) < step * height or width == 0 or height == 0:
        raise InputError(
            f"{source}: {len(data)} bytes for {width} x {height} px in steps of {step}: damaged; record again"
        )
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, : width * dtype.itemsize]
    return np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="))


def _packed_values(message: Any, source: str) -> np.ndarray:
    """The pixels of a PNG, for compressedDepth behind its header."""
    data = bytes(message.data)
    if "compressedDepth" not in message.format:
        return _png(data, source)
    if "rvl" in message.format or message.format.startswith("32FC1"):
        raise InputError(f"{source}: {message.format}; record 16UC1 with compressedDepth format png, or raw")
    return _png(data[PACKED_HEADER:], source)


def _png(data: bytes, source: str) -> np.ndarray:
    with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
        if not picture.mode.startswith("I"):
            raise InputError(f"{source}: a picture in {picture.mode}, expected 16 bits of grey: not depths")
        return np.asarray(picture).astype(np.uint16)


def _intrinsics(recording: _Recording, topic: str, image: Any) -> Intrinsics:
    """The intrinsics of the calibration that belongs to a topic by its name.

    Frame ids may be empty or shared by several cameras, so they can contradict a name but never replace it.
    """
    cameras = recording.topics(CAMERA_SCHEMAS)
    beside = [camera for camera in cameras if _belongs(camera, topic)]
    if len(beside) > 1:
        beside = [camera for camera in beside if "depth" in camera.rpartition("/")[2]] or beside
    if len(beside) > 1:
        raise InputError(
            f"{recording.path}: {_listed(beside)} may all be the calibration of {topic}; give --intrinsics"
        )
    message = recording.first(beside[0]) if beside else None
    if message is None:
        found = f"the recording has {_listed(cameras)}, which is of another topic: " if cameras else ""
        raise InputError(
            f"{recording.path} {topic}: no intrinsics beside it; {found}record the CameraInfo of this topic too, or "
            "give --intrinsics FILE, or fx fy cx cy"
        )
    frames = _frame_id(message), _frame_id(image)
    if all(frames) and frames[0] != frames[1]:
        both = f"{beside[0]} is of frame {frames[0]}, {topic} of {frames[1]}"
        raise InputError(
            f"{recording.path}: {both}: of another stream; record the one of this stream, or give --intrinsics"
        )
    return _intrinsics_of(message, f"{recording.path} {beside[0]}", topic)


def _belongs(camera: str, topic: str) -> bool:
    """Whether a calibration is beside a topic, and does not name another imager."""
    folder, base = camera.rpartition("/")[0], _base(topic)
    if folder not in (base.rpartition("/")[0], base):
        return False
    name, image = camera.rpartition("/")[2].lower(), base.lower()
    return not any(word in name and word not in image for word in OTHER_IMAGERS)


def _intrinsics_of(message: Any, source: str, topic: str) -> Intrinsics:
    """The intrinsics of a calibration: P without distortion for images that were rectified, K and D for others."""
    k, coefficients = np.array(_field(message, "k"), float), tuple(map(float, _field(message, "d")))
    if k.size != 9 or k[0] <= 0:
        raise InputError(f"{source}: is not calibrated (K is {k.tolist()}); give --intrinsics")
    p = np.array(_field(message, "p"), float).reshape(-1)
    matrix = raw = k[[0, 4, 2, 5]]
    rectified = p[[0, 5, 2, 6]] if p.size == 12 and p[0] > 0 else None
    if rectified is not None and (any(coefficients) or not np.allclose(rectified, raw, atol=LEAST_SHIFT)):
        if _is_rectified(topic) is None:
            raise InputError(
                f"{source}: K with distortion is of the raw image (fx {raw[0]:.1f}), P of the rectified one (fx "
                f"{rectified[0]:.1f}), and the name of {topic} says neither; give --intrinsics of the image"
            )
        if _is_rectified(topic):
            matrix, coefficients = rectified, ()
    return Intrinsics(
        *matrix.tolist(),
        size=(int(message.width), int(message.height)),
        model=str(message.distortion_model) or "plumb_bob",
        coefficients=coefficients,
        device=topic if known_baseline(topic) else "",
        stream=_stream_of(topic),
        source=source,
    )


def _field(message: Any, name: str) -> list[float]:
    """The numbers of a calibration's field, whose name is a capital in Foxglove's schemas."""
    value = getattr(message, name, None)
    return list(getattr(message, name.upper(), ()) if value is None else value)


def _frame_id(message: Any) -> str:
    """The coordinate frame of a message."""
    return str(getattr(message, "header", message).frame_id)


def _is_rectified(topic: str) -> bool | None:
    """Whether an image was rectified, by the name of its topic; None if the name does not say."""
    names = topic.lower().split("/")
    if any("rect" in name and "unrect" not in name for name in names):
        return True
    return False if any(name.startswith(("image_raw", "depth_raw", "unrect")) for name in names) else None


def _stream_of(topic: str) -> Stream | None:
    """The stream, by the names that realsense2_camera gives, and by those of our own recordings."""
    if "aligned" in topic:
        return "aligned"
    return "raw" if topic.endswith(("/image_rect_raw", "/d415/depth")) or "/image_rect_raw/" in topic else None


def _base(topic: str) -> str:
    """A topic without what image_transport appends."""
    return next((topic.removesuffix(suffix) for suffix in SUFFIXES if topic.endswith(suffix)), topic)


def _listed(topics: list[str]) -> str:
    more = f" and {len(topics) - MOST_LISTED} more" if len(topics) > MOST_LISTED else ""
    return (", ".join(topics[:MOST_LISTED]) or "no topics") + more
