"""Reading a shard: any message of any scene, reading and decompressing no more than necessary.

The index at the end of the file is read once. A scene is one chunk with its messages in a known order, so a chunk is
decompressed from its start as far as needed, and continued later. Every message returned has passed a checksum.
"""

from __future__ import annotations

import io
import json
import os
import struct
import threading
import weakref
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Metadata, MetadataIndex
from mcap.writer import MCAP0_MAGIC as MAGIC

from kit1000.dataset.mcap_io.messages import SECOND
from kit1000.dataset.mcap_io.writing import RECORD, START, record_checksum
from kit1000.dataset.tables import check_format
from kit1000.errors import InputError, did_you_mean
from kit1000.files import LFS_ADVICE, LFS_POINTER

FIX = "generate or download it again"
RECENT = 3  # decompressed chunks in memory, of all files together: 8 MB each with two views, 22 MB with six
AHEAD = 1 << 16  # [bytes] decompressed beyond the request: all small messages of a scene at once
_RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
_FOOTER = struct.Struct("<BQQQI8s")  # opcode, length, start of the summary, of its offsets, checksum, magic
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<BQQQQII4sQ")  # opcode, length, times, size, checksum, length and name of compression, length


class ShardFile:
    """A file of scenes, opened on first use; can be pickled, and used in other processes and threads."""

    CONTENTS: ClassVar[str]

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def __reduce__(self) -> tuple[type[ShardFile], tuple[Path]]:
        return type(self), (self.path,)

    @property
    def scene_ids(self) -> tuple[str, ...]:
        """The scenes of the file, in order."""
        return tuple(self._source.chunks)

    @property
    def record(self) -> Mapping[str, str]:
        """The metadata record `kit1000`: format, generator, units, licence, scenes and their hashes."""
        return self._source.record

    def content_hash(self, scene_id: str) -> str:
        """The content hash of a scene as written in the file; see `kit1000.dataset.mcap_io.content`."""
        self._check(scene_id)
        return self._source.content[scene_id]

    def stamp(self, scene_id: str) -> int:
        """The time of a scene [ns]: whole seconds."""
        self._check(scene_id)
        return self._source.chunks[scene_id].message_start_time

    @cached_property
    def _source(self) -> _Source:
        return _Source(self.path, self.CONTENTS)

    def _topics(self, scene_id: str) -> list[str]:
        """The topics of a scene's messages, in order."""
        self._check(scene_id)
        return [topic for topic, _ in self._source.messages[scene_id]]

    def _all(self, scene_id: str, topic: str) -> list[memoryview]:
        """All messages of a scene on a topic."""
        indices = [i for i, name in enumerate(self._topics(scene_id)) if name == topic]
        with _damage_as_input_error(self.path):
            chunk = _chunk(self._source, scene_id)
            return [chunk.message(i) for i in indices]

    def _one(self, scene_id: str, topic: str) -> memoryview:
        """The only message of a scene on a topic."""
        (message,) = self._all(scene_id, topic)
        return message

    def _check(self, scene_id: str) -> None:
        ids = self._source.chunks
        if scene_id not in ids:
            raise InputError(
                f"{self.path}: no scene {scene_id!r} among {len(ids)}; {did_you_mean(scene_id, ids)}see .scene_ids"
            )


class _Source:
    """An open file and its index."""

    record: dict[str, str]
    content: dict[str, str]
    messages: dict[str, list[tuple[str, int]]]
    chunks: dict[str, ChunkIndex]
    topics: dict[int, str]

    def __init__(self, path: Path, contents: str) -> None:
        self.path = path
        with _damage_as_input_error(path):
            self._descriptor = os.open(path, os.O_RDONLY)
            weakref.finalize(self, os.close, self._descriptor)
            self._read_index(contents)

    def read(self, offset: int, size: int) -> bytes:
        """Bytes of the file, fewer at its end; safe in threads and after a fork."""
        return os.pread(self._descriptor, size, offset)

    def _read_index(self, contents: str) -> None:
        summary = self._summary()
        self.topics = {item.id: item.topic for item in map(Channel.read, summary[Opcode.CHANNEL])}
        indices = [MetadataIndex.read(stream) for stream in summary[Opcode.METADATA_INDEX]]
        matching = [index for index in indices if index.name == RECORD]
        if not matching:
            raise InputError(f"{self.path}: no recording of kit1000 (an MCAP file without its record)")
        records = _records(self.read(matching[0].offset, matching[0].length))
        self.record = Metadata.read(records[Opcode.METADATA][0]).metadata
        if self.record.get("checksum") != record_checksum(self.record):
            raise _damaged(self.path, "its record fails the checksum")
        check_format(self.record.get("format"), str(self.path))
        if self.record["holds"] != contents:
            raise InputError(f"{self.path}: holds {self.record['holds']!r}, expected a file of {contents!r}")
        self.content, self.messages = json.loads(self.record["content"]), json.loads(self.record["messages"])
        chunks = sorted(map(ChunkIndex.read, summary[Opcode.CHUNK_INDEX]), key=lambda index: index.message_start_time)
        scenes = [(index.message_start_time - START) // SECOND for index in chunks]
        ids = json.loads(self.record["scenes"])
        if scenes != list(range(len(ids))):
            raise InputError(f"{self.path}: not one scene a chunk: rewritten by another tool; {FIX}")
        self.chunks = dict(zip(ids, chunks, strict=True))

    def _summary(self) -> dict[int, list[ReadDataStream]]:
        """The records at the end of the file by opcode, verified by their checksum."""
        size = os.fstat(self._descriptor).st_size
        if size == 0:
            raise InputError(f"{self.path}: empty file; {FIX}")
        if self.read(0, len(MAGIC)) != MAGIC:
            pointer = self.read(0, len(LFS_POINTER)) == LFS_POINTER
            raise InputError(f"{self.path}: {LFS_ADVICE if pointer else 'no MCAP file'}")
        tail = self.read(max(size - _FOOTER.size, 0), _FOOTER.size)
        if not tail.endswith(MAGIC) or len(tail) < _FOOTER.size:
            raise InputError(f"{self.path}: truncated: the end of the file is missing; {FIX}")
        start, checksum = _FOOTER.unpack(tail)[2], _FOOTER.unpack(tail)[4]
        end = size - len(MAGIC) - 4
        if not 0 < start < end:
            raise _damaged(self.path, "without an index")
        summary = self.read(start, end - start)
        if zlib.crc32(summary) != checksum:
            raise _damaged(self.path, "its index fails the checksum")
        return _records(summary[: size - start - _FOOTER.size])


class _Chunk:
    """The chunk of a scene, decompressed from its start as far as requested."""

    def __init__(self, source: _Source, index: ChunkIndex, messages: list[tuple[str, int]]) -> None:
        self._source, self._index, self._expected = source, index, messages
        self._check_header()
        self._bytes = np.empty(index.uncompressed_size, np.uint8).data
        packed = _ByteRange(source, index.chunk_start_offset + _CHUNK.size, index.compressed_size)
        self._stream = zstandard.ZstdDecompressor().stream_reader(packed)  # type: ignore[arg-type]
        self._decompressed = 0  # number of bytes
        self._parsed = 0  # number of bytes
        self._messages: list[tuple[int, memoryview]] = []  # channel and data of the messages parsed so far
        self._verified: set[int] = set()  # indices of messages that have passed their checksum
        self._lock = threading.Lock()

    def message(self, i: int) -> memoryview:
        """The data of the i-th message, verified by its checksum."""
        with self._lock:
            while len(self._messages) <= i:
                self._parse_record()
            channel, data = self._messages[i]
            if i not in self._verified:
                if (self._source.topics.get(channel), zlib.crc32(data)) != tuple(self._expected[i]):
                    raise _damaged(self._source.path, "a message fails its checksum")
                self._verified.add(i)
            return data

    def _parse_record(self) -> None:
        """Read the next record."""
        start = self._parsed + _RECORD_HEAD.size
        self._decompress(start)
        opcode, length = _RECORD_HEAD.unpack_from(self._bytes, self._parsed)
        self._decompress(start + length)
        if opcode == Opcode.MESSAGE:
            body = self._bytes[start : start + length]
            self._messages.append((_MESSAGE.unpack_from(body)[0], body[_MESSAGE.size :].toreadonly()))
        self._parsed = start + length

    def _decompress(self, end: int) -> None:
        """Decompress at least up to a byte."""
        if end > len(self._bytes):
            raise _damaged(self._source.path, "a record reaches beyond its chunk")
        while self._decompressed < end:
            ahead = min(max(end, self._decompressed + AHEAD), len(self._bytes))
            count = self._stream.readinto(self._bytes[self._decompressed : ahead])
            if count == 0:
                raise _damaged(self._source.path, "a chunk ends early")
            self._decompressed += count

    def _check_header(self) -> None:
        """Raise InputError when the chunk's header differs from the index."""
        index = self._index
        head = self._source.read(index.chunk_start_offset, _CHUNK.size)
        opcode, length, first, last, size, _, _, compression, packed = _CHUNK.unpack(head)
        header = (opcode, length + _RECORD_HEAD.size, first, last, size, compression.decode(), packed)
        if header != (
            Opcode.CHUNK,
            index.chunk_length,
            index.message_start_time,
            index.message_end_time,
            index.uncompressed_size,
            index.compression,
            index.compressed_size,
        ):
            raise _damaged(self._source.path, "a chunk differs from the index")


class _ByteRange:
    """A range of bytes of a file, read sequentially."""

    def __init__(self, source: _Source, offset: int, size: int) -> None:
        self._source, self._at, self._end = source, offset, offset + size

    def read(self, size: int = -1) -> bytes:
        """The next bytes; none at the end."""
        left = self._end - self._at
        data = self._source.read(self._at, left if size < 0 else min(size, left))
        self._at += len(data)
        return data


@lru_cache(maxsize=RECENT)
def _chunk(source: _Source, scene_id: str) -> _Chunk:
    return _Chunk(source, source.chunks[scene_id], source.messages[scene_id])


def _records(data: bytes) -> dict[int, list[ReadDataStream]]:
    """Streams on the bodies of records, by opcode; every known opcode has an entry."""
    records: dict[int, list[ReadDataStream]] = {int(opcode): [] for opcode in Opcode}
    at = 0
    while at < len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        start = at + _RECORD_HEAD.size
        records.setdefault(opcode, []).append(ReadDataStream(io.BytesIO(data[start : start + length])))
        at = start + length
    return records


def _damaged(path: Path, what: str) -> InputError:
    return InputError(f"{path}: damaged: {what}; {FIX}")


@contextmanager
def _damage_as_input_error(path: Path) -> Iterator[None]:
    """Convert any exception that damaged bytes raise in libraries to an InputError with one line."""
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:
        text = " ".join(str(error).split())
        raise _damaged(path, f"{type(error).__name__}: {text}" if text else type(error).__name__) from error
