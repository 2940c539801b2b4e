"""Depth frames of MCAP recordings: ROS 2 bags, Foxglove, and ours. Only the chunks of the chosen topic are read."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import IO, Any

from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory
from zstandard import ZstdDecompressor

from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.options import ImportOptions
from kit1000.capture.recorded_messages import (
    CAMERA_SCHEMAS,
    PACKED_SCHEMAS,
    RAW_SCHEMAS,
    frame_id_of,
    frame_of,
    intrinsics_of,
    is_depth,
)
from kit1000.errors import InputError, Kit1000Error, did_you_mean

MOST_RECORD = 1 << 30  # [bytes] of a record, and of a chunk when decompressed
MOST_UNPACKED = 1 << 35  # [bytes] of a recording that was compressed as a whole
ZSTD = b"\x28\xb5\x2f\xfd"  # the first bytes of data compressed by zstd
OTHER_IMAGERS = ("rgb", "color", "colour", "infra", "left", "right")
"""Words in the name of a calibration that is not that of depth, unless the depth topic has them too."""
OTHER_ENCODINGS = {
    "ros1": "convert the ROS 1 bag itself, without ROS: pip install rosbags, then rosbags-convert --src FILE.bag --dst "
    "FOLDER --dst-storage mcap",
    "json": "record depth images in protobuf (foxglove.RawImage), or save them as 16-bit PNG",
    "cdr": "record with a schema in ros2msg, as ROS 2 does by default, or save images as 16-bit PNG",
}
FIX = "record it again; of a recording that was cut off, `mcap recover` makes a whole one"
SUFFIXES = ("/compressedDepth", "/compressed")  # of topics of image_transport
MOST_LISTED = 6  # topics in a message


class _Recording:
    """An open recording, with or without chunks, whose messages may be compressed one by one."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self.path, self.file = path, file
        summary = SeekingReader(file, record_size_limit=MOST_RECORD).get_summary()
        if summary is None or not summary.channels:
            raise InputError(f"{path}: without an index; {FIX}")
        if any(chunk.uncompressed_size > MOST_RECORD for chunk in summary.chunk_indexes):
            raise InputError(f"{path}: a chunk of more than {MOST_RECORD >> 30} GiB; {FIX}")
        self.chunked = bool(summary.chunk_indexes)
        self.factories = (ProtobufFactory(), Ros2Factory())
        self.channels: dict[str, tuple[Channel, Schema | None]] = {
            channel.topic: (channel, summary.schemas.get(channel.schema_id)) for channel in summary.channels.values()
        }

    def topics(self, schemas: tuple[str, ...]) -> list[str]:
        """The topics of messages of some schemas."""
        return sorted(
            topic for topic, (_, schema) in self.channels.items() if schema is not None and schema.name in schemas
        )

    def schema(self, topic: str) -> str:
        """The name of the schema of a topic."""
        schema = self.channels[topic][1]
        return "" if schema is None else schema.name

    def messages(self, topic: str) -> Iterator[Any]:
        """The messages of a topic, decoded, in the order of time; without chunks in the order of the file."""
        self.file.seek(0)
        reader = (SeekingReader if self.chunked else NonSeekingReader)(self.file, record_size_limit=MOST_RECORD)
        for schema, channel, message in reader.iter_messages(topics=[topic], log_time_order=self.chunked):
            data = message.data
            if data.startswith(ZSTD):  # rosbag2 with --compression-mode message
                data = ZstdDecompressor().decompress(data, max_output_size=MOST_RECORD)
            yield self._decoder(channel, schema)(data)

    def first(self, topic: str) -> Any:
        """The first message of a topic; None if it has none."""
        return next(self.messages(topic), None)

    def _decoder(self, channel: Channel, schema: Schema | None) -> Callable[[bytes], Any]:
        """What decodes the messages of a channel; raises InputError for encodings that are not read."""
        for factory in self.factories:
            decoder = factory.decoder_for(channel.message_encoding, schema)
            if decoder is not None:
                return decoder
        encoding, described = channel.message_encoding, "no schema" if schema is None else f"{schema.encoding} schemas"
        raise InputError(
            f"{self.path} {channel.topic}: messages in {encoding} with {described} are not read, expected cdr with "
            f"ros2msg or protobuf; {OTHER_ENCODINGS.get(encoding, OTHER_ENCODINGS['cdr'])}"
        )


def read_recording(path: Path, options: ImportOptions) -> list[DepthFrame]:
    """The chosen frames of a recording, with the intrinsics recorded beside them.

    Args:
        path: of an MCAP file, perhaps compressed as a whole by zstd.
        options: which say the topic and the frames.

    Raises:
        InputError: it is damaged, in an encoding that is not read, has no depth topic or several, or too few frames.
    """
    with _one_line(path), _opened(path) as file:
        recording = _Recording(path, file)
        topic = _depth_topic(recording, options.topic)
        schema, source = recording.schema(topic), f"{path} {topic}"
        chosen = islice(recording.messages(topic), options.first, options.first + options.frames)
        messages = list(chosen)
        if len(messages) < options.frames:
            found = f"{len(messages)} frames from {options.first} on"
            raise InputError(f"{source}: {found}, expected {options.frames}: lower --frames")
        frames = [frame_of(message, schema, source) for message in messages]
        intrinsics = None if options.intrinsics else _intrinsics(recording, topic, messages[0])
        return [replace(frame, intrinsics=intrinsics) for frame in frames]


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
    packed = [topic for topic in found if topic.endswith(SUFFIXES) and _base(topic) not in plain]
    found = [*plain, *packed]
    if not found:
        names = _listed(images or sorted(recording.channels))
        bare = sorted(topic for topic, (_, schema) in recording.channels.items() if schema is None)
        without = f"; {_listed(bare)}: messages without a schema are not read" if bare else ""
        raise InputError(
            f"{recording.path}: no depth topic among {names}{without}; name one with --topic, or record depth"
        )
    if len(found) > 1:
        raise InputError(f"{recording.path}: {len(found)} depth topics, {_listed(found)}; choose one with --topic")
    return found[0]


def _shows_depth(recording: _Recording, topic: str) -> bool:
    message = recording.first(topic)
    return message is not None and is_depth(message, recording.schema(topic))


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
    if not beside:
        found = f"the recording has {_listed(cameras)}, which is of another topic: " if cameras else ""
        raise InputError(
            f"{recording.path} {topic}: no intrinsics beside it; {found}record the CameraInfo of this topic too, or "
            "give --intrinsics FILE, or fx fy cx cy"
        )
    message = recording.first(beside[0])
    if message is None:
        raise InputError(f"{recording.path} {beside[0]}: holds no message; give --intrinsics")
    frames = frame_id_of(message), frame_id_of(image)
    if all(frames) and frames[0] != frames[1]:
        both = f"{beside[0]} is of frame {frames[0]}, {topic} of {frames[1]}"
        raise InputError(
            f"{recording.path}: {both}: of another stream; record the one of this stream, or give --intrinsics"
        )
    return intrinsics_of(message, f"{recording.path} {beside[0]}", topic)


def _belongs(camera: str, topic: str) -> bool:
    """Whether a calibration is beside a topic, and does not name another imager."""
    folder, base = camera.rpartition("/")[0], _base(topic)
    if folder not in (base.rpartition("/")[0], base):
        return False
    name, image = camera.rpartition("/")[2].lower(), base.lower()
    return not any(word in name and word not in image for word in OTHER_IMAGERS)


@contextmanager
def _opened(path: Path) -> Iterator[IO[bytes]]:
    """The bytes of a recording; those of a compressed file are unpacked into a temporary one."""
    with open(path, "rb") as file:
        packed = file.read(len(ZSTD)) == ZSTD
        file.seek(0)
        if not packed:
            yield file
            return
        with tempfile.TemporaryFile() as whole:
            for chunk in ZstdDecompressor().read_to_iter(file):
                whole.write(chunk)
                if whole.tell() > MOST_UNPACKED:
                    raise InputError(f"{path}: more than {MOST_UNPACKED >> 30} GiB when unpacked: unpack it, zstd -d")
            whole.seek(0)
            yield whole


def _base(topic: str) -> str:
    """A topic without what image_transport appends."""
    return next((topic.removesuffix(suffix) for suffix in SUFFIXES if topic.endswith(suffix)), topic)


def _listed(topics: list[str]) -> str:
    more = f" and {len(topics) - MOST_LISTED} more" if len(topics) > MOST_LISTED else ""
    return (", ".join(topics[:MOST_LISTED]) or "no topics") + more


@contextmanager
def _one_line(path: Path) -> Iterator[None]:
    """Any exception that damaged bytes raise in libraries becomes an InputError with one line."""
    try:
        yield
    except Kit1000Error:
        raise
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:
        text = " ".join(str(error).split())[:160]
        raise InputError(
            f"{path}: damaged or cut off ({type(error).__name__}{': ' if text else ''}{text}); {FIX}"
        ) from None
