"""Writing a shard: scenes as messages, and a metadata record with the contents of the file.

The bytes depend only on the scenes: times and library name are fixed. The small messages of a scene are one chunk, each
image is a chunk of its own: so a reader of MCAP files decompresses only what it needs, and checks its CRC.
"""

from __future__ import annotations

import hashlib
import io
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import ClassVar

from mcap.writer import CompressionType, Writer

from kit1000.dataset.json_rows import FORMAT
from kit1000.dataset.mcap_io.content_hash import compact_bytes
from kit1000.dataset.mcap_io.messages import LARGE, SECOND, Message
from kit1000.dataset.scene_data import LICENCE
from kit1000.errors import InputError
from kit1000.files import write_bytes

LIBRARY = "kit1000"  # without a version: it would change the bytes
GENERATOR = "kit1000 0.1.0"  # the release that first wrote this format: later ones write ideal views byte for byte
RECORD = "kit1000"  # name of the metadata record
START = 1_767_225_600 * SECOND  # [ns] 2026-01-01: scene k of a shard is recorded k seconds later


class ShardWriter:
    """A context manager that writes a file of scenes when its block ends without an exception and has scenes."""

    CONTENTS: ClassVar[str]

    def __init__(self, path: str | Path, licence: str = LICENCE) -> None:
        self.licence = licence
        self.path = Path(path) if isinstance(path, str) else path  # an object store has its own path type
        self.sha256: str | None = None
        """SHA-256 of the file in hex; None until it is written."""
        self._content: dict[str, str] = {}
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._buffer = io.BytesIO()
        self._mcap = Writer(self._buffer, chunk_size=sys.maxsize, compression=CompressionType.ZSTD)
        self._mcap.start(profile="", library=LIBRARY)

    def __enter__(self):
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None and self._content:
            self._mcap.add_metadata(RECORD, self._record())
            self._mcap.finish()
            self.sha256 = write_bytes(self.path, self._buffer.getvalue())

    @property
    def stamp(self) -> int:
        """The time of the next scene [ns]."""
        return START + len(self._content) * SECOND

    def record(self, scene_id: str, content_hash: str, messages: Iterable[Message]) -> None:
        """Write the messages of a scene in their order, small ones first.

        All have one time: a viewer then shows all of them, with the calibrations and frames that they need.
        """
        if scene_id in self._content:
            raise InputError(f"{self.path}: scene {scene_id} is recorded twice")
        time = self.stamp
        for message in messages:
            if message.schema.name in LARGE:
                self._mcap.flush()  # ends the chunk before it
            self._mcap.add_message(self._channel(message), time, message.data, time)
        self._mcap.flush()
        self._content[scene_id] = content_hash

    def _channel(self, message: Message) -> int:
        schema, topic = message.schema, message.topic
        if schema.name not in self._schemas:
            self._schemas[schema.name] = self._mcap.register_schema(schema.name, schema.encoding, schema.data)
        if topic not in self._channels:
            number = self._schemas[schema.name]
            self._channels[topic] = self._mcap.register_channel(topic, schema.message_encoding, number)
        return self._channels[topic]

    def _record(self) -> dict[str, str]:
        record = {
            "format": FORMAT,
            "holds": self.CONTENTS,
            "generator": GENERATOR,
            "licence": self.licence,
            "length_unit": "m",
            "depth_unit": "m",
            "scenes": compact_bytes(list(self._content)).decode(),
            "content": compact_bytes(self._content).decode(),
        }
        return record | {"checksum": record_checksum(record)}


class PictureWriter(ShardWriter):
    """Writes a recording made for looking at: the messages of one scene."""

    CONTENTS = "pictures"

    def __init__(self, path: str | Path, stamp: int) -> None:
        super().__init__(path)
        self._stamp = stamp

    @property
    def stamp(self) -> int:
        """The time of the scene [ns]."""
        return self._stamp

    def add(self, scene_id: str, messages: list[Message]) -> None:
        """Write the messages of the scene."""
        digest = hashlib.sha256(b"".join(message.data for message in messages))
        self.record(scene_id, digest.hexdigest(), messages)


def record_checksum(record: Mapping[str, str]) -> str:
    """The checksum of a metadata record, without its entry `checksum`."""
    plain = {key: value for key, value in record.items() if key != "checksum"}
    return hashlib.sha256(compact_bytes(plain)).hexdigest()
