"""Volumes kept on disk, so that each is worked out once: one or two bytes a voxel, memory-mapped when read.

An entry is a file that `numpy.load` opens too: an array of codes as `kit1000.voxels` encodes them, behind it a line of
JSON with the grid and the key, and a checksum of it all. An entry that is damaged, or is not what its name says, is
worked out again. Processes may share a folder: files appear whole, and the same key gives the same bytes.
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

from kit1000 import __version__
from kit1000.dataset.tables import pose_of, pose_row
from kit1000.errors import InputError
from kit1000.files import folder, is_url, json_bytes, write_bytes
from kit1000.voxels import Grid, Volume, from_float16, from_uint8, to_float16, to_uint8

ENCODINGS: dict[str, tuple[Callable[[Volume], np.ndarray], Callable[[Grid, np.ndarray], Volume]]] = {
    "uint8": (to_uint8, from_uint8),
    "float16": (to_float16, from_float16),
}
"""How to store the values of a volume, and how to read them back."""
NAME = re.compile(r"[A-Za-z0-9][\w.-]*")  # of a dataset, scene or item: it becomes the name of a file
RECIPE_DIGITS = 16  # of the hash that names the folder of a recipe
_LENGTHS = struct.Struct("<QI")  # [bytes] of the array, of the line of JSON
_END = struct.Struct("<I8s")  # checksum of all before, mark
_MARK = b"kit1000v"


class Key(NamedTuple):
    """What a volume is of, and how it was made; equal keys mean equal volumes."""

    dataset_id: str
    scene_id: str
    item: str
    """Such as the id of a query and which of its volumes: `test-s0007-p2-snap.kit`."""
    recipe: Mapping[str, Any]
    """All that decides the values, as JSON values: source, shape, voxel, truncation."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A stored volume."""

    grid: Grid
    codes: np.ndarray
    """(nx, ny, nz) uint8 or float16. Writing to it changes this array alone, never the file."""


class CacheSize(NamedTuple):
    """How much a cache holds."""

    volumes: int
    bytes: int

    def __str__(self) -> str:
        return f"{self.volumes:,} volumes, {self.bytes / 1e6:,.1f} MB"


class VolumeCache:
    """A folder of volumes; may be pickled and shared by processes."""

    def __init__(self, root: str | Path, encoding: str = "uint8") -> None:
        """Keep volumes below a folder, which is made with the first. Deleting it costs nothing but time.

        Args:
            root: of this machine.
            encoding: uint8 (a byte a voxel, off by 1/127 of the truncation at most) or float16 (two bytes, by 1/4096).
        """
        self.root = folder(str(root))
        if is_url(self.root):
            raise InputError(f"{root}: a cache is memory-mapped, so it wants a folder of this machine")
        if encoding not in ENCODINGS:
            raise InputError(f"encoding {encoding!r}: expected one of {', '.join(ENCODINGS)}")
        self.encoding = encoding

    def volume(self, key: Key, make: Callable[[], Volume]) -> Volume:
        """The volume of a key, made when it is not there yet: the same values then as ever after."""
        entry = self.entry(key, make)
        return ENCODINGS[self.encoding][1](entry.grid, entry.codes)

    def entry(self, key: Key, make: Callable[[], Volume]) -> Entry:
        """As `volume`, not decoded: the codes lie in the file and are read as they are touched."""
        path, told = self.path(key), self._told(key)
        found = _read(path, told)
        if found is None:
            write_bytes(path, _packed(make(), told))
            found = _read(path, told)
        if found is None:
            raise InputError(f"{path}: what was written there cannot be read back; is the disk sound?")
        return found

    def path(self, key: Key) -> Path:
        """Where the volume of a key is kept: one folder a dataset, recipe and scene."""
        for name in key[:3]:
            if not NAME.fullmatch(name):
                raise InputError(f"{name!r}: no name to keep a volume under (letters, digits, '.', '-', '_')")
        told = self._told(key)
        recipe = hashlib.sha256(json_bytes([told["recipe"], told["encoding"], told["generator"]])).hexdigest()
        return self.root / key.dataset_id / recipe[:RECIPE_DIGITS] / key.scene_id / f"{key.item}.npy"

    def size(self) -> CacheSize:
        """How much is stored, of all keys and encodings."""
        sizes = [path.stat().st_size for path in self._files()]
        return CacheSize(len(sizes), sum(sizes))

    def clear(self) -> None:
        """Delete all volumes; whatever else lies in the folder stays."""
        for path in list(self._files()):
            path.unlink(missing_ok=True)
            with suppress(OSError):  # the last one of a scene, recipe or dataset leaves an empty folder
                for place in path.parents[:3]:
                    place.rmdir()

    def _files(self) -> Iterator[Path]:
        return self.root.glob(f"*/{'[0-9a-f]' * RECIPE_DIGITS}/*/*.npy")

    def _told(self, key: Key) -> dict[str, Any]:
        """What an entry says of itself, its grid apart."""
        made = {"recipe": dict(key.recipe), "encoding": self.encoding, "generator": f"kit1000 {__version__}"}
        return key._asdict() | made


def _packed(volume: Volume, told: dict[str, Any]) -> bytes:
    """The bytes of an entry."""
    codes = ENCODINGS[told["encoding"]][0](volume)
    array = io.BytesIO()
    np.lib.format.write_array(array, codes, allow_pickle=False)
    grid = volume.grid
    row = {"shape": list(grid.shape), "voxel": grid.voxel, "world_from_grid": pose_row(grid.world_from_grid)}
    line = b"\n" + json_bytes([{**told, "grid": row}])
    body = array.getvalue() + line + _LENGTHS.pack(codes.nbytes, len(line))
    return body + _END.pack(zlib.crc32(body), _MARK)


def _read(path: Path, told: dict[str, Any]) -> Entry | None:
    """The entry of a file; None where there is none, or none that is sound and says this of itself."""
    try:
        data = np.memmap(path, np.uint8, "c")  # copy on write: a tensor may be written to, and the file stays
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
    (said,) = json.loads(body[len(body) - length :].tobytes())
    grid = said.pop("grid")
    if json_bytes(said) != json_bytes(told):
        return None
    start = len(body) - length - size
    codes = np.asarray(body[start : start + size]).view(told["encoding"]).reshape(grid["shape"])
    return Entry(Grid(grid["shape"], grid["voxel"], pose_of(grid["world_from_grid"])), codes)
