"""Reading a shard: any message of any scene, with no more of the file read and decompressed than that takes.

The index at the end of the file is read once. A scene is one chunk, and its messages stand in a known order, so a
chunk is decompressed from its beginning as far as is needed and goes on from there. Every byte that is handed out
has passed a checksum.
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
from kit1000.dataset.tables import FORMAT
from kit1000.errors import InputError, did_you_mean

MEND = "make or fetch it again"
RECENT = 3  # chunks kept decompressed, of all files together: 8 MB each with two views, 22 MB with six
AHEAD = 1 << 16  # [bytes] decompressed beyond what is asked: all small messages of a scene at once
_RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
_FOOTER = struct.Struct("<BQQQI8s")  # opcode, length, start of the summary, of its offsets, checksum, magic
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<BQQQQII4sQ")  # opcode, length, times, size, checksum, length and name of compression, length


class ShardFile:
    """A file of scenes, opened when first asked; may be pickled, and copied to other processes and threads."""

    HOLDS: ClassVar[str]

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
        """SHA-256 of what the scene says, as it was written; see `kit1000.dataset.mcap_io.content`."""
        self._check(scene_id)
        return self._source.content[scene_id]

    @cached_property
    def _source(self) -> _Source:
        return _Source(self.path, self.HOLDS)

    def _topics(self, scene_id: str) -> list[str]:
        """The topics of a scene's messages, in order."""
        self._check(scene_id)
        return [topic for topic, _ in self._source.messages[scene_id]]

    def _all(self, scene_id: str, topic: str) -> list[memoryview]:
        """All messages of a scene on a topic."""
        places = [i for i, found in enumerate(self._topics(scene_id)) if found == topic]
        with _damage_told(self.path):
            chunk = _chunk(self._source, scene_id)
            return [chunk.message(i) for i in places]

    def _one(self, scene_id: str, topic: str) -> memoryview:
        """The message of a scene on a topic that has one."""
        (found,) = self._all(scene_id, topic)
        return found

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

    def __init__(self, path: Path, holds: str) -> None:
        self.path = path
        with _damage_told(path):
            self._descriptor = os.open(path, os.O_RDONLY)
            weakref.finalize(self, os.close, self._descriptor)
            self._read_index(holds)

    def read(self, offset: int, size: int) -> bytes:
        """Bytes of the file, fewer at its end; safe in threads and after a fork."""
        return os.pread(self._descriptor, size, offset)

    def _read_index(self, holds: str) -> None:
        summary = self._summary()
        self.topics = {item.id: item.topic for item in map(Channel.read, summary[Opcode.CHANNEL])}
        indices = [MetadataIndex.read(stream) for stream in summary[Opcode.METADATA_INDEX]]
        ours = [index for index in indices if index.name == RECORD]
        if not ours:
            raise InputError(f"{self.path}: no recording of kit1000 (an MCAP file without its record)")
        records = _records(self.read(ours[0].offset, ours[0].length))
        self.record = Metadata.read(records[Opcode.METADATA][0]).metadata
        if self.record.get("checksum") != record_checksum(self.record):
            raise _damaged(self.path, "its record fails the checksum")
        for key, wanted in (("format", FORMAT), ("holds", holds)):
            if self.record[key] != wanted:
                raise InputError(f"{self.path}: {key} {self.record[key]!r}, expected a file of {wanted!r}")
        self.content, self.messages = json.loads(self.record["content"]), json.loads(self.record["messages"])
        chunks = sorted(map(ChunkIndex.read, summary[Opcode.CHUNK_INDEX]), key=lambda index: index.message_start_time)
        scenes = [(index.message_start_time - START) // SECOND for index in chunks]
        ids = json.loads(self.record["scenes"])
        if scenes != list(range(len(ids))):
            raise InputError(f"{self.path}: no longer one scene a chunk: packed anew by another tool; {MEND}")
        self.chunks = dict(zip(ids, chunks, strict=True))

    def _summary(self) -> dict[int, list[ReadDataStream]]:
        """The records at the end of the file, by kind, after they have passed their checksum."""
        size = os.fstat(self._descriptor).st_size
        if size == 0:
            raise InputError(f"{self.path}: empty file; {MEND}")
        if self.read(0, len(MAGIC)) != MAGIC:
            raise InputError(f"{self.path}: no MCAP file")
        tail = self.read(max(size - _FOOTER.size, 0), _FOOTER.size)
        if not tail.endswith(MAGIC) or len(tail) < _FOOTER.size:
            raise InputError(f"{self.path}: cut short: the end of the file is missing; {MEND}")
        start, checksum = _FOOTER.unpack(tail)[2], _FOOTER.unpack(tail)[4]
        end = size - len(MAGIC) - 4
        if not 0 < start < end:
            raise _damaged(self.path, "without an index")
        summary = self.read(start, end - start)
        if zlib.crc32(summary) != checksum:
            raise _damaged(self.path, "its index fails the checksum")
        return _records(summary[: size - start - _FOOTER.size])


class _Chunk:
    """The chunk of a scene, decompressed from its beginning as far as was asked for."""

    def __init__(self, source: _Source, index: ChunkIndex, messages: list[tuple[str, int]]) -> None:
        self._source, self._index, self._wanted = source, index, messages
        self._check_head()
        self._bytes = np.empty(index.uncompressed_size, np.uint8).data
        packed = _Part(source, index.chunk_start_offset + _CHUNK.size, index.compressed_size)
        self._stream = zstandard.ZstdDecompressor().stream_reader(packed)  # type: ignore[arg-type]
        self._filled = 0  # bytes decompressed
        self._walked = 0  # bytes whose records are known
        self._found: list[tuple[int, memoryview]] = []  # channel and data of the messages so far
        self._sound: set[int] = set()  # which of them have passed their checksum
        self._lock = threading.Lock()

    def message(self, i: int) -> memoryview:
        """The data of the i-th message, once it has passed its checksum."""
        with self._lock:
            while len(self._found) <= i:
                self._walk()
            channel, data = self._found[i]
            if i not in self._sound:
                if (self._source.topics.get(channel), zlib.crc32(data)) != tuple(self._wanted[i]):
                    raise _damaged(self._source.path, "a message fails its checksum")
                self._sound.add(i)
            return data

    def _walk(self) -> None:
        """Read the next record."""
        start = self._walked + _RECORD_HEAD.size
        self._fill(start)
        opcode, length = _RECORD_HEAD.unpack_from(self._bytes, self._walked)
        self._fill(start + length)
        if opcode == Opcode.MESSAGE:
            body = self._bytes[start : start + length]
            self._found.append((_MESSAGE.unpack_from(body)[0], body[_MESSAGE.size :].toreadonly()))
        self._walked = start + length

    def _fill(self, end: int) -> None:
        """Decompress at least up to a byte."""
        if end > len(self._bytes):
            raise _damaged(self._source.path, "a record reaches beyond its chunk")
        while self._filled < end:
            ahead = min(max(end, self._filled + AHEAD), len(self._bytes))
            count = self._stream.readinto(self._bytes[self._filled : ahead])
            if count == 0:
                raise _damaged(self._source.path, "a chunk ends early")
            self._filled += count

    def _check_head(self) -> None:
        """Refuse a chunk that is not as the index says."""
        index = self._index
        head = self._source.read(index.chunk_start_offset, _CHUNK.size)
        opcode, length, first, last, size, _, _, compression, packed = _CHUNK.unpack(head)
        found = (opcode, length + _RECORD_HEAD.size, first, last, size, compression.decode(), packed)
        if found != (
            Opcode.CHUNK,
            index.chunk_length,
            index.message_start_time,
            index.message_end_time,
            index.uncompressed_size,
            index.compression,
            index.compressed_size,
        ):
            raise _damaged(self._source.path, "a chunk is not where the index says")


class _Part:
    """A stretch of a file that is read from its beginning to its end."""

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
    """The bodies of records by opcode, each ready to be read; kinds that are missing are empty."""
    found: dict[int, list[ReadDataStream]] = {int(opcode): [] for opcode in Opcode}
    at = 0
    while at < len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        start = at + _RECORD_HEAD.size
        found.setdefault(opcode, []).append(ReadDataStream(io.BytesIO(data[start : start + length])))
        at = start + length
    return found


def _damaged(path: Path, what: str) -> InputError:
    return InputError(f"{path}: damaged: {what}; {MEND}")


@contextmanager
def _damage_told(path: Path) -> Iterator[None]:
    """Turn whatever damaged bytes raise in the readers of others into an InputError of one line."""
    try:
        yield
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:
        said = " ".join(str(error).split())
        raise _damaged(path, f"{type(error).__name__}: {said}" if said else type(error).__name__) from error
