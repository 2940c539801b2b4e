"""Reading a shard: any message of any scene, by the index at the end of the file, which is read once.

The `mcap` library parses the file and checks the CRC of each chunk. Only chunks with the requested topics are read.
Files of data version 2.0.0 have one chunk for each scene: they are read in the same way, only slower.
"""

from __future__ import annotations

import io
import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, lru_cache
from pathlib import Path
from typing import IO, ClassVar

from mcap.data_stream import ReadDataStream
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Chunk, ChunkIndex, Footer, Message
from mcap.stream_reader import MAGIC_SIZE, breakup_chunk
from mcap.writer import MCAP0_MAGIC as MAGIC

from kit1000.dataset.json_rows import check_format
from kit1000.dataset.mcap_io.messages import SECOND
from kit1000.dataset.mcap_io.writing import RECORD, START, record_checksum
from kit1000.errors import InputError, did_you_mean
from kit1000.files import LFS_ADVICE, LFS_POINTER

FIX = "generate or download it again"
RECENT = 3  # decompressed chunks in memory, of all files together: 4 MB for an image, up to 22 MB in data 2.0.0
RECORD_HEAD = 9  # [bytes] opcode and length, before the body of a record
CRC_SIZE = 4  # [bytes]


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
        return tuple(self._index.chunks)

    @property
    def record(self) -> Mapping[str, str]:
        """The metadata record `kit1000`: format, generator, units, licence, scenes and their hashes."""
        return self._index.record

    def content_hash(self, scene_id: str) -> str:
        """The content hash of a scene as written in the file; see `kit1000.dataset.mcap_io.content_hash`."""
        self._chunks(scene_id)
        return self._index.content[scene_id]

    def stamp(self, scene_id: str) -> int:
        """The time of a scene [ns]: whole seconds."""
        return self._chunks(scene_id)[0].message_start_time

    @cached_property
    def _index(self) -> _Index:
        with _damage_as_input_error(self.path):
            return _Index(self.path, self.CONTENTS)

    def _chunks(self, scene_id: str) -> list[ChunkIndex]:
        """The entries of the index for a scene's chunks. Raises InputError for an unknown scene."""
        chunks = self._index.chunks
        if scene_id not in chunks:
            hint = did_you_mean(scene_id, chunks)
            raise InputError(f"{self.path}: no scene {scene_id!r} among {len(chunks)}; {hint}see .scene_ids")
        return chunks[scene_id]

    def _topics(self, scene_id: str) -> set[str]:
        """The topics of a scene's messages."""
        topics = self._index.topics
        return {topics[channel] for chunk in self._chunks(scene_id) for channel in chunk.message_index_offsets}

    def _all(self, scene_id: str, topic: str) -> list[bytes]:
        """All messages of a scene on a topic, in the order in which they were written."""
        chunks = self._chunks(scene_id)
        with _damage_as_input_error(self.path):
            channels = {channel for channel, name in self._index.topics.items() if name == topic}
            matching = [chunk for chunk in chunks if not channels.isdisjoint(chunk.message_index_offsets)]
            places = [(chunk.chunk_start_offset, chunk.chunk_length) for chunk in matching]
            messages = (message for place in places for message in _messages(self._index, *place))
            return [message.data for message in messages if message.channel_id in channels]

    def _one(self, scene_id: str, topic: str) -> bytes:
        """The only message of a scene on a topic."""
        messages = self._all(scene_id, topic)
        if len(messages) != 1:
            raise _damaged(self.path, f"scene {scene_id} has {len(messages)} messages on {topic}, expected one")
        return messages[0]


class _Index:
    """What is known about a file from the index at its end."""

    def __init__(self, path: Path, contents: str) -> None:
        self.path = path
        with open(path, "rb") as file:
            reader = _verified_reader(path, file)
            summary = reader.get_summary()
            records = [record.metadata for record in reader.iter_metadata() if record.name == RECORD]
        if summary is None or not records:
            raise InputError(f"{path}: no recording of kit1000 (an MCAP file without its record)")
        self.record = records[0]
        if self.record.get("checksum") != record_checksum(self.record):
            raise _damaged(path, "its record fails the checksum")
        check_format(self.record.get("format"), str(path))
        if self.record["holds"] != contents:
            raise InputError(f"{path}: holds {self.record['holds']!r}, expected a file of {contents!r}")
        self.content: dict[str, str] = json.loads(self.record["content"])
        self.topics = {number: channel.topic for number, channel in summary.channels.items()}
        ids: list[str] = json.loads(self.record["scenes"])
        self.chunks: dict[str, list[ChunkIndex]] = {scene_id: [] for scene_id in ids}
        for chunk in summary.chunk_indexes:
            number, rest = divmod(chunk.message_start_time - START, SECOND)
            if rest or chunk.message_end_time != chunk.message_start_time or number >= len(ids):
                raise InputError(f"{path}: chunks of several scenes: rewritten by another tool; {FIX}")
            self.chunks[ids[number]].append(chunk)


def _verified_reader(path: Path, file: IO[bytes]) -> SeekingReader:
    """The library's reader of a file whose index passes its CRC, which the library does not check."""
    start = file.read(len(LFS_POINTER))
    if not start:
        raise InputError(f"{path}: empty file; {FIX}")
    if start == LFS_POINTER:
        raise InputError(f"{path}: {LFS_ADVICE}")
    if not start.startswith(MAGIC):
        raise InputError(f"{path}: no MCAP file")
    end = file.seek(0, os.SEEK_END) - MAGIC_SIZE
    file.seek(max(end, MAGIC_SIZE))
    if file.read() != MAGIC:
        raise InputError(f"{path}: truncated; {FIX}")
    file.seek(end - FOOTER_SIZE + RECORD_HEAD)
    footer = Footer.read(ReadDataStream(file))
    file.seek(footer.summary_start)
    if zlib.crc32(file.read(end - CRC_SIZE - footer.summary_start)) != footer.summary_crc:
        raise _damaged(path, "its index fails the checksum")
    file.seek(0)
    return SeekingReader(file, validate_crcs=True)


@lru_cache(maxsize=RECENT)
def _messages(index: _Index, offset: int, length: int) -> list[Message]:
    """The messages of the chunk at an offset of a file, which passed its CRC."""
    with open(index.path, "rb") as file:  # anew: processes and threads would share its position
        file.seek(offset + RECORD_HEAD)
        chunk = Chunk.read(ReadDataStream(io.BytesIO(file.read(length - RECORD_HEAD))))
    records = breakup_chunk(chunk, validate_crc=True)
    return [record for record in records if isinstance(record, Message)]


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
