"""Depth frames of MCAP recordings: ROS 2 bags, Foxglove, and ours. Only the chunks of the chosen topic are read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import IO, Any

from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory as ProtobufFactory
from mcap_ros2.decoder import DecoderFactory as Ros2Factory

from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.frame_selection import Selection
from kit1000.capture.intrinsics import Intrinsics
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
FIX = "record it again; of a recording that was cut off, `mcap recover` makes a whole one"
SUFFIXES = ("/compressedDepth", "/compressed")  # of topics of image_transport
MOST_LISTED = 6  # topics in a message


class _Recording:
    """An open recording."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        self.path = path
        self.reader = SeekingReader(
            file, decoder_factories=[ProtobufFactory(), Ros2Factory()], record_size_limit=MOST_RECORD
        )
        summary = self.reader.get_summary()
        if summary is None or not summary.chunk_indexes:
            raise InputError(f"{path}: without an index; {FIX}")
        if any(chunk.uncompressed_size > MOST_RECORD for chunk in summary.chunk_indexes):
            raise InputError(f"{path}: a chunk of more than {MOST_RECORD >> 30} GiB; {FIX}")
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
        """The messages of a topic, decoded, in the order of time."""
        return (item.decoded_message for item in self.reader.iter_decoded_messages(topics=[topic]))

    def first(self, topic: str) -> Any:
        """The first message of a topic; None where it has none."""
        return next(self.messages(topic), None)


def read_recording(path: Path, selection: Selection) -> list[DepthFrame]:
    """The chosen frames of a recording, with the intrinsics recorded beside them.

    Raises InputError where it is damaged, holds no depth images or several topics of them, or too few frames.
    """
    with _one_line(path), open(path, "rb") as file:
        recording = _Recording(path, file)
        topic = _depth_topic(recording, selection.topic)
        schema, source = recording.schema(topic), f"{path} {topic}"
        chosen = islice(recording.messages(topic), selection.first, selection.first + selection.frames)
        messages = list(chosen)
        if len(messages) < selection.frames:
            found = f"{len(messages)} frames from {selection.first} on"
            raise InputError(f"{source}: {found}, expected {selection.frames}: lower --frames")
        intrinsics = _intrinsics(recording, topic, messages[0])
        return [frame_of(message, schema, source, intrinsics) for message in messages]


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
        raise InputError(f"{recording.path}: no depth topic among {names}; name one with --topic, or record depth")
    if len(found) > 1:
        raise InputError(f"{recording.path}: {len(found)} depth topics, {_listed(found)}; choose one with --topic")
    return found[0]


def _shows_depth(recording: _Recording, topic: str) -> bool:
    message = recording.first(topic)
    return message is not None and is_depth(message, recording.schema(topic))


def _intrinsics(recording: _Recording, topic: str, image: Any) -> Intrinsics | None:
    """The intrinsics of the calibration beside a topic, else of one of the same frame; None without any."""
    cameras = recording.topics(CAMERA_SCHEMAS)
    folder = _base(topic).rpartition("/")[0]
    beside = [camera for camera in cameras if camera.rpartition("/")[0] in (folder, _base(topic))]
    for camera in (*beside, *cameras):
        message = recording.first(camera)
        if message is None:
            continue
        frames = frame_id_of(message), frame_id_of(image)
        if frames[0] == frames[1]:
            return intrinsics_of(message, f"{recording.path} {camera}", topic)
        if camera in beside:
            both = f"{camera} is of frame {frames[0]}, {topic} of {frames[1]}"
            raise InputError(
                f"{recording.path}: {both}: of another stream; record the one of this stream, or give --intrinsics"
            )
    return None


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
