"""Reading mesh files as raw triangles: STL here, other formats by trimesh, every fault as one line.

Nothing is repaired and no unit is converted. A file is never trusted: the counts in its header are compared with its
size before memory is allocated, so that a damaged or malicious file causes an error message and nothing worse.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.mesh import z_up
from kit1000.parts.files.threemf import read_threemf

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".3mf", ".glb", ".gltf", ".step", ".stp")
TEXT_SUFFIXES = (".obj", ".off")
STEP_SUFFIXES = (".step", ".stp")
GLTF_SUFFIXES = (".glb", ".gltf")  # y up by the standard; all others are taken as they are
METRE_SUFFIXES = (*GLTF_SUFFIXES, *STEP_SUFFIXES)  # by the standard for glTF; the STEP reader converts to metres
MAX_FACES = 5_000_000
MAX_BYTES = 1_500_000_000  # an ASCII STL of 5 million faces; also the limit of what a 3MF may unpack to
STL_HEADER = 84  # [bytes] 80 of comment, 4 of count
STL_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
STL_VERTEX = re.compile(rb"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE)
UNIT_NAMES = {"millimeter": "mm", "millimeters": "mm", "centimeter": "cm", "meter": "m", "meters": "m"}
UNIT_NAMES |= {"inch": "inch", "foot": "foot", "micron": "micron"}


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """Triangles as they are stored in a file: no connectivity or orientation is guaranteed."""

    vertices: np.ndarray
    """(n, 3) float64, in the unit of the file."""
    faces: np.ndarray
    """(m, 3) int64"""
    unit: str | None = None
    """The unit stated in the file."""
    notes: tuple[str, ...] = ()
    """Irregularities of the file that were ignored."""


def read_triangles(path: Path) -> TriangleSoup:
    """The triangles of a mesh file. Raises MeshRefused with one line when it has none."""
    data = _bytes(path)
    suffix = path.suffix.lower()
    if suffix == ".stl":
        soup = _read_stl(data)
    elif suffix in MESH_SUFFIXES:
        _check_declared(suffix, data)
        soup = _read_other(path, suffix, data)
    else:
        raise MeshRefused(f"not a mesh format: {suffix or 'no suffix'}; known are {' '.join(MESH_SUFFIXES)}")
    if not len(soup.faces):
        raise MeshRefused("holds no triangles")
    _check_count(len(soup.faces))
    return soup


def _bytes(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise MeshRefused("is a folder, expected a mesh file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise MeshRefused(f"{size / 1e9:.1f} GB, more than {MAX_BYTES / 1e9:.1f} GB")
        data = path.read_bytes()
    except OSError as error:
        raise MeshRefused(f"cannot be read: {(error.strerror or str(error)).lower()}") from None
    except ValueError as error:  # a NUL in the name
        raise MeshRefused(f"cannot be read: {error}") from None
    if not data:
        raise MeshRefused("empty file")
    return data


def _check_count(faces: int) -> None:
    if faces > MAX_FACES:
        raise MeshRefused(f"{faces:,} triangles, more than {MAX_FACES:,}")


def _read_stl(data: bytes) -> TriangleSoup:
    declared = int.from_bytes(data[80:STL_HEADER], "little") if len(data) >= STL_HEADER else 0
    expected = STL_HEADER + STL_FACET.itemsize * declared
    if len(data) >= STL_HEADER and len(data) == expected:
        return _binary_stl(data, declared)
    if data[:1024].lstrip()[:5].lower() == b"solid" and b"facet" in data[:8192]:
        return _ascii_stl(data)
    if b"\0" not in data[:4096] and _is_printable(data[:4096]):
        if data[:1024].lstrip()[:5].lower() == b"solid":
            raise MeshRefused("holds no triangles")
        raise MeshRefused("not a mesh: text file")
    if len(data) < STL_HEADER:
        raise MeshRefused(f"not a mesh: {len(data)} bytes, a binary STL has at least {STL_HEADER}")
    if len(data) < expected:
        held = (len(data) - STL_HEADER) // STL_FACET.itemsize
        raise MeshRefused(f"cut short or not an STL: {declared:,} triangles declared, room for {held:,}")
    return _binary_stl(data, declared, (f"ignored {len(data) - expected:,} bytes after the last triangle",))


def _binary_stl(data: bytes, count: int, notes: tuple[str, ...] = ()) -> TriangleSoup:
    _check_count(count)
    facets = np.frombuffer(data, STL_FACET, count, STL_HEADER)
    with np.errstate(invalid="ignore"):  # a signalling NaN; corners that are no numbers are refused later
        corners = facets["corners"].reshape(-1, 3).astype(np.float64)
    return _from_corners(corners, notes)


def _ascii_stl(data: bytes) -> TriangleSoup:
    found = STL_VERTEX.findall(data)
    if len(found) % 3:
        raise MeshRefused(f"cut short: {len(found)} corners are no whole number of triangles")
    try:
        corners = np.array(found, dtype="S").astype(np.float64).reshape(-1, 3)
    except ValueError:
        raise MeshRefused("not readable as STL: a coordinate is not a number") from None
    return _from_corners(corners)


def _from_corners(corners: np.ndarray, notes: tuple[str, ...] = ()) -> TriangleSoup:
    return TriangleSoup(corners, np.arange(len(corners)).reshape(-1, 3), notes=notes)


def _is_printable(data: bytes) -> bool:
    return all(byte >= 32 or byte in b"\t\n\r\f" for byte in data)


def _check_declared(suffix: str, data: bytes) -> None:
    """Refuse a file whose header declares more elements than it has bytes."""
    declared = COUNTERS[suffix](data) if suffix in COUNTERS else 0
    if declared > len(data) and suffix != ".gltf":
        raise MeshRefused(f"cut short or damaged: {declared:,} elements declared in {len(data):,} bytes")
    if declared > 16 * MAX_FACES:  # a glTF keeps its numbers in other files
        raise MeshRefused(f"{declared:,} elements declared, more than {16 * MAX_FACES:,}")
    if suffix == ".3mf":
        _check_archive(data)


def _ply_count(data: bytes) -> int:
    header = data[: data.find(b"end_header")] if b"end_header" in data[:65536] else b""
    return max((int(n) for n in re.findall(rb"^element\s+\S+\s+(\d+)", header, re.MULTILINE)), default=0)


def _glb_count(data: bytes) -> int:
    return _gltf_count(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def _gltf_count(data: bytes) -> int:
    try:
        accessors = json.loads(data).get("accessors", [])
        return max((int(accessor.get("count", 0)) for accessor in accessors), default=0)
    except (ValueError, AttributeError, TypeError, RecursionError):
        raise MeshRefused("not readable as glTF: its JSON part is damaged") from None


COUNTERS = {".ply": _ply_count, ".glb": _glb_count, ".gltf": _gltf_count}


def _check_archive(data: bytes) -> None:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError):
        raise MeshRefused("not readable as 3MF: not a zip archive") from None
    if size > MAX_BYTES:
        raise MeshRefused(f"unpacks to {size / 1e9:.1f} GB, more than {MAX_BYTES / 1e9:.1f} GB")


def _read_other(path: Path, suffix: str, data: bytes) -> TriangleSoup:
    """Read by trimesh. Its readers raise exceptions of any type for a damaged file, so every one is caught."""
    if suffix in STEP_SUFFIXES and find_spec("cascadio") is None:
        raise MeshRefused("STEP files need an optional reader: pip install cascadio")
    if suffix == ".3mf":
        return _read_3mf(data)
    if suffix in TEXT_SUFFIXES:
        data = _as_utf8(data)
    import trimesh  # only here: importing it takes longer than reading an STL and making many a kit

    source = str(path) if suffix == ".gltf" else io.BytesIO(data)
    options: dict[str, Any] = {"skip_materials": True} if suffix in (".obj", *GLTF_SUFFIXES) else {}
    try:
        scene = trimesh.load_scene(source, file_type=suffix[1:], process=False, **options)
        pieces = [piece for piece in scene.dump() if isinstance(piece, trimesh.Trimesh) and len(piece.faces)]
        unit = scene.units
    except Exception as error:
        message = "" if isinstance(error, OSError) else " ".join(str(error).split())[:100]
        raise MeshRefused(f"not readable as {suffix[1:].upper()}: {message or 'damaged'}") from None
    if not pieces:
        raise MeshRefused("holds no triangles")
    soup = _joined(pieces, "m" if suffix in METRE_SUFFIXES else UNIT_NAMES.get(unit or ""))
    return replace(soup, vertices=z_up(soup.vertices)) if suffix in GLTF_SUFFIXES else soup


def _read_3mf(data: bytes) -> TriangleSoup:
    try:
        built = read_threemf(data, MAX_FACES)
    except MeshRefused:
        raise
    except Exception as error:  # as above: the archive or the XML may be damaged in any way
        raise MeshRefused(f"not readable as 3MF: {' '.join(str(error).split())[:100] or 'damaged'}") from None
    lattice = "a beam lattice, which has no triangles"
    if not len(built.faces) and built.has_lattice:
        raise MeshRefused(f"holds {lattice}, and is not supported: export it as a mesh of triangles")
    notes = (f"ignored {lattice}",) if built.has_lattice else ()
    return TriangleSoup(built.vertices, built.faces, UNIT_NAMES.get(built.unit), notes)


def _as_utf8(data: bytes) -> bytes:
    """The text of a mesh file; bytes that are not UTF-8, as in a comment, are replaced."""
    if b"\0" in data[:4096]:
        raise MeshRefused("not a mesh: binary data, expected text")
    return data.decode("utf-8", "replace").encode()


def _joined(pieces: list, unit: str | None) -> TriangleSoup:
    """All trimesh meshes of a file as one soup."""
    if any(np.shape(array)[1:] != (3,) for piece in pieces for array in (piece.vertices, piece.faces)):
        raise MeshRefused("damaged: vertices without three coordinates, or faces without three corners")
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])
    vertices = np.concatenate([np.asarray(piece.vertices, dtype=np.float64) for piece in pieces])
    shifted = zip(pieces, starts[:-1], strict=True)
    faces = np.concatenate([np.asarray(piece.faces, dtype=np.int64) + start for piece, start in shifted])
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshRefused(f"damaged: faces name vertex {faces.max():,} of {len(vertices):,}")
    return TriangleSoup(vertices, faces, unit)
