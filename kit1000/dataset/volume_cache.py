"""A cache of volumes on disk: one or two bytes a voxel, memory-mapped when read.

An entry is a file that `numpy.load` can open: an array of codes as encoded by `kit1000.voxels`, followed by a line of
JSON with the grid and the key, and a checksum. A damaged entry, or one with another key, is made again. Processes may
share a folder: writes are atomic, and the same key gives the same bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kit1000.dataset.tables import pose_of, pose_row
from kit1000.errors import InputError
from kit1000.files import is_url, json_bytes, parse_folder, write_bytes
from kit1000.version import __version__
from kit1000.voxels import Grid, Volume, from_float16, from_uint8, to_float16, to_uint8

ENCODINGS: dict[str, tuple[Callable[[Volume], np.ndarray], Callable[[Grid, np.ndarray], Volume]]] = {
    "uint8": (to_uint8, from_uint8),
    "float16": (to_float16, from_float16),
}
"""Functions that encode and decode the values of a volume, by name of the encoding."""
NAME = re.compile(r"[A-Za-z0-9][\w.-]*")  # of a dataset, scene or item: it becomes a file name
RECIPE_DIGITS = 16  # of the hash that names the folder of a recipe
_LENGTHS = struct.Struct("<QI")  # [bytes] of the array, of the line of JSON
_END = struct.Struct("<I8s")  # checksum of all before, mark
_MARK = b"kit1000v"


class Key(NamedTuple):
    """Identifies a volume: its subject and how it was made. Equal keys mean equal volumes."""

    dataset_id: str
    scene_id: str
    item: str
    """Such as the id of a query and the name of one of its volumes: `test-s0007-p2-snap.kit`."""
    recipe: Mapping[str, Any]
    """All parameters of the values, as JSON: source, shape, voxel, truncation."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A stored volume."""

    grid: Grid
    codes: np.ndarray
    """(nx, ny, nz) uint8 or float16. Writing to it does not change the file."""


class CacheSize(NamedTuple):
    """The size of a cache: number of volumes and bytes."""

    volumes: int
    bytes: int

    def __str__(self) -> str:
        return f"{self.volumes:,} volumes, {self.bytes / 1e6:,.1f} MB"


class VolumeCache:
    """A folder of cached volumes; can be pickled and shared by processes."""

    def __init__(self, root: str | Path, encoding: str = "uint8") -> None:
        """Cache volumes in a folder, which may be deleted at any time.

        Args:
            root: a folder of this machine; made with the first volume.
            encoding: uint8 (one byte a voxel, error at most 1/127 of the truncation) or float16 (two bytes, 1/4096).
        """
        self.root = parse_folder(str(root))
        if is_url(self.root):
            raise InputError(f"{root}: a cache is memory-mapped, so it needs a folder of this machine")
        if encoding not in ENCODINGS:
            raise InputError(f"encoding {encoding!r}: expected one of {', '.join(ENCODINGS)}")
        self.encoding = encoding

    def volume(self, key: Key, make: Callable[[], Volume]) -> Volume:
        """The volume of a key; made and stored when missing. The decoded values are the same both times."""
        entry = self.entry(key, make)
        return ENCODINGS[self.encoding][1](entry.grid, entry.codes)

    def entry(self, key: Key, make: Callable[[], Volume]) -> Entry:
        """The encoded volume of a key, memory-mapped; made and stored when missing."""
        path, header = self.path(key), self._header(key)
        entry = _read_entry(path, header)
        if entry is None:
            write_bytes(path, _pack(make(), header))
            entry = _read_entry(path, header)
        if entry is None:
            raise InputError(f"{path}: the entry cannot be read back after writing; is the disk damaged?")
        return entry

    def path(self, key: Key) -> Path:
        """The file of a key: one folder for each dataset, recipe and scene."""
        for name in key[:3]:
            if not NAME.fullmatch(name):
                raise InputError(f"{name!r}: not usable in a file name (letters, digits, '.', '-', '_')")
        header = self._header(key)
        recipe = hashlib.sha256(json_bytes([header["recipe"], header["encoding"], header["generator"]])).hexdigest()
        return self.root / key.dataset_id / recipe[:RECIPE_DIGITS] / key.scene_id / f"{key.item}.npy"

    def size(self) -> CacheSize:
        """The size of the cache, all keys and encodings together."""
        sizes = [path.stat().st_size for path in self._files()]
        return CacheSize(len(sizes), sum(sizes))

    def clear(self) -> None:
        """Delete all volumes; other files in the folder are kept."""
        for path in list(self._files()):
            path.unlink(missing_ok=True)
            with suppress(OSError):  # folders that still have other entries stay
                for folder in path.parents[:3]:
                    folder.rmdir()

    def _files(self) -> Iterator[Path]:
        return self.root.glob(f"*/{'[0-9a-f]' * RECIPE_DIGITS}/*/*.npy")

    def _header(self, key: Key) -> dict[str, Any]:
        """The JSON of an entry, without its grid."""
        return key._asdict() | {
            "recipe": dict(key.recipe),
            "encoding": self.encoding,
            "generator": f"kit1000 {__version__}",
        }


def _pack(volume: Volume, header: dict[str, Any]) -> bytes:
    """The bytes of an entry."""
    codes = ENCODINGS[header["encoding"]][0](volume)
    array = io.BytesIO()
    np.lib.format.write_array(array, codes, allow_pickle=False)
    grid = volume.grid
    row = {"shape": list(grid.shape), "voxel": grid.voxel_size, "world_from_grid": pose_row(grid.world_from_grid)}
    line = b"\n" + json_bytes([{**header, "grid": row}])
    body = array.getvalue() + line + _LENGTHS.pack(codes.nbytes, len(line))
    return body + _END.pack(zlib.crc32(body), _MARK)


def _read_entry(path: Path, header: dict[str, Any]) -> Entry | None:
    """The entry in a file; None when it is missing, damaged, or has another header."""
    try:
        data = np.memmap(path, np.uint8, "c")  # copy on write: a tensor on it may be changed
    except (FileNotFoundError, ValueError):  # ValueError: an empty file
        return None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    body = data[: -_END.size]
    checksum, mark = _END.unpack(data[-_END.size :].tobytes().rjust(_END.size, b"\0"))
    if mark != _MARK or zlib.crc32(body.data) != checksum:
        return None
    size, length = _LENGTHS.unpack(body[-_LENGTHS.size :].tobytes())
    body = body[: -_LENGTHS.size]
    (stored_header,) = json.loads(body[len(body) - length :].tobytes())
    grid = stored_header.pop("grid")
    if json_bytes(stored_header) != json_bytes(header):
        return None
    start = len(body) - length - size
    codes = np.asarray(body[start : start + size]).view(header["encoding"]).reshape(grid["shape"])
    return Entry(Grid(grid["shape"], grid["voxel"], pose_of(grid["world_from_grid"])), codes)
