"""Mesh files as parts: finding them, reading their triangles, their unit, and repair.

Every repair is in a reading's notes and every guess states how to override it. A file that cannot be a part is refused
with one line. A file is never trusted: the counts in its header are compared with its size before memory is allocated.
"""

from __future__ import annotations

import io
import math
import os
import re
import zipfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from kit1000.errors import InputError, MeshRefused
from kit1000.mesh import Mesh, z_up
from kit1000.parts.files.file_text import BYTE_ORDER_MARK, check_foreign
from kit1000.parts.files.gltf import glb_bodies
from kit1000.parts.files.part_mesh import Choice, part_mesh
from kit1000.parts.files.polygon_files import read_obj, read_ply
from kit1000.parts.files.repair import closed_solid
from kit1000.parts.files.stl import read_stl
from kit1000.parts.files.triangles import TriangleSoup, joined

STEP_SUFFIXES = (".step", ".stp")
MESH_SUFFIXES = (".stl", ".obj", ".ply", ".3mf", ".glb", *STEP_SUFFIXES)
MAX_FACES = 5_000_000
MAX_BYTES = 1_500_000_000  # an ASCII STL of 5 million faces; also the limit of what a 3MF may unpack to
USER_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 0.0254}  # [m] that a user can give
FILE_UNITS = USER_UNITS | {"foot": 0.3048, "micron": 1e-6}  # [m] that a file can state
UNIT_GUESS_ORDER = ("mm", "m", "inch", "cm")  # the most frequent in machine parts first
PLAUSIBLE_SIZE = (0.005, 0.5)  # [m] longest side of a machine part, by which a unit is guessed
ACCEPTED_SIZE = (1e-4, 10.0)  # [m] longest side of a part that is not refused
MAX_OFFSET_RATIO = 100.0  # distance from the origin in longest sides; farther away float32 would ruin the shape
DETAIL = re.compile(r"[:;(,].*| of \S+\.\w+$| when read in .*|^\d\S* ")  # of one file: names, counts, what to do
NUMBER = re.compile(r"\d\S*")


@dataclass(frozen=True, eq=False)
class MeshReading:
    """A part read from a file and repaired."""

    path: Path
    mesh: Mesh
    """Metres, closed, outward, one body, vertices on the float32 grid."""
    unit: str
    """The unit in which the file's coordinates were read."""
    unit_guessed: bool
    unit_reason: str
    """Why this unit, and how to override a guess."""
    notes: tuple[str, ...]
    """Every change made to the surface; empty for a clean file."""
    step: float = 0.0
    """Distance between two coordinates that the file can tell apart; 0 if it is as fine as float64. [m]"""


def read_mesh(path: str | Path, unit: str | None = None, choice: Choice | None = None) -> MeshReading:
    """Read one mesh file as a part.

    Args:
        path: STL, OBJ, PLY, 3MF or GLB; STEP if its optional reader is installed.
        unit: "mm", "cm", "m" or "inch"; None: the one stated in the file, else guessed from its size.
        choice: which of several bodies is the part. "union": all as one, which must touch or overlap; "largest"; None:
            the one with nearly all of the volume.

    Raises:
        SeveralBodies: there are several bodies, and by `choice` no single one.
        MeshRefused: the file cannot be a part; one line says why.
        InputError: the unit is unknown.
    """
    path = Path(path)
    if unit is not None and unit not in USER_UNITS:
        raise InputError(f"unit {unit!r}: expected one of {', '.join(USER_UNITS)}")
    soup = read_triangles(path)
    notes: list[str] = []
    used = np.zeros(len(soup.vertices), dtype=bool)
    used[soup.faces] = True
    _check_finite(soup.vertices[used])
    longest = float(np.ptp(soup.vertices[used], axis=0).max())
    if unit is not None and path.suffix.lower() in STEP_SUFFIXES:  # its reader has converted already
        notes.append(f"did not use the given unit {unit}: STEP states its own")
        unit = None
    chosen, guessed, reason = _unit(longest, unit, soup.unit)
    metres = FILE_UNITS[chosen]
    _check_size(longest * metres, chosen)
    vertices = _moved_to_origin(soup.vertices * metres, used, notes)
    mesh = part_mesh(closed_solid(vertices, soup.faces, notes), notes, choice)
    return MeshReading(path, mesh, chosen, guessed, reason, tuple(notes), soup.step * metres)


def read_triangles(path: Path) -> TriangleSoup:
    """The triangles of a mesh file without any repair. Raises MeshRefused with one line if it has none."""
    data, suffix = _bytes(path), path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise MeshRefused(f"not a mesh format: {suffix or 'no suffix'}; known are {' '.join(MESH_SUFFIXES)}")
    try:
        soup = _triangles(suffix, data)
    except (MeshRefused, MemoryError):
        raise
    except Exception as error:  # a damaged file may break a reader in any way
        words = "" if isinstance(error, OSError) else " ".join(str(error).split())[:100]
        raise MeshRefused(f"not readable as {suffix[1:].upper()}: {words or 'damaged'}") from None
    if not len(soup.faces):
        raise MeshRefused("holds no triangles")
    if len(soup.faces) > MAX_FACES:
        raise MeshRefused(f"{len(soup.faces):,} triangles, more than {MAX_FACES:,}")
    return soup


def mesh_files(path: str | Path) -> list[Path]:
    """The mesh files of a path: the file itself, all below a folder (sorted), or those of a .txt list of paths.

    Paths in a list are relative to it; blank lines and lines beginning with # are skipped; listed folders are searched.

    Raises:
        InputError: the path does not exist, or the folder or list has no mesh.
    """
    path = Path(path)
    if path.is_dir():
        found = _meshes_below(path)
    elif path.suffix.lower() == ".txt" and path.is_file():
        found = _meshes_listed(path)
    elif path.exists():
        return [path]
    else:
        raise InputError(f"{path}: does not exist; expected a mesh file, a folder or a .txt list of them")
    if not found:
        raise InputError(f"{path}: no mesh files inside; looked for {' '.join(MESH_SUFFIXES)}")
    return found


def refusal_counts(reasons: Iterable[str]) -> str:
    """The kinds of refusals with their numbers, most frequent first: "3x not closed, 1x empty file"."""
    kinds = Counter(NUMBER.sub("N", DETAIL.sub("", reason)).strip() or reason for reason in reasons)
    ranked = sorted(kinds.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{count}x {kind}" for kind, count in ranked)


def _triangles(suffix: str, data: bytes) -> TriangleSoup:
    if suffix == ".stl":
        return read_stl(data, MAX_FACES)
    if suffix == ".glb":
        bodies = glb_bodies(data, MAX_FACES)
        vertices, faces = joined([(body.vertices, body.faces) for body in bodies])
        return TriangleSoup(z_up(vertices), faces, "m", max((body.step for body in bodies), default=0.0))
    if suffix == ".3mf":
        check_foreign(data, is_archive=True)
        _check_archive(data)
        from kit1000.parts.files.threemf import read_threemf  # only here: other formats need no reader of XML

        return read_threemf(data, MAX_FACES)
    check_foreign(data)
    if suffix in STEP_SUFFIXES:
        return _read_step(data, suffix)
    return read_obj(data) if suffix == ".obj" else read_ply(data)


def _read_step(data: bytes, suffix: str) -> TriangleSoup:
    """The triangles of a STEP file in metres, by trimesh."""
    if find_spec("cascadio") is None:
        raise MeshRefused("STEP files need an optional reader: pip install cascadio")
    import trimesh  # only here: its import takes longer than reading most files

    scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], process=False)
    pieces = [piece for piece in scene.dump() if isinstance(piece, trimesh.Trimesh) and len(piece.faces)]
    meshes = [(np.asarray(p.vertices, dtype=np.float64), np.asarray(p.faces, dtype=np.int64)) for p in pieces]
    return TriangleSoup(*joined(meshes), "m")


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


def _check_archive(data: bytes) -> None:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except NotImplementedError:  # the entry asks for a newer version
        raise MeshRefused("not readable as 3MF: its zip archive needs a newer reader; save it again") from None
    except (zipfile.BadZipFile, ValueError, OSError):
        raise MeshRefused("not readable as 3MF: not a zip archive") from None
    if size > MAX_BYTES:
        raise MeshRefused(f"unpacks to {size / 1e9:.1f} GB, more than {MAX_BYTES / 1e9:.1f} GB")


def _check_finite(vertices: np.ndarray) -> None:
    bad = int((~np.isfinite(vertices)).any(1).sum())
    if bad:
        raise MeshRefused(f"NaN or infinite vertices: {bad:,} of {len(vertices):,}")


def _check_size(longest: float, unit: str) -> None:
    low, high = ACCEPTED_SIZE
    if longest == 0:
        raise MeshRefused("zero thickness: all vertices in one place")
    if not low <= longest <= high:
        size = f"longest side {longest:.4g} m when read in {unit}"
        raise MeshRefused(f"{size}; expected {low:g} to {high:g} m, {_better_unit(longest / FILE_UNITS[unit])}")


def _better_unit(longest: float) -> str:
    """What to do about a longest side, in the unit of the file, that is too large or too small for a part."""
    low, high = PLAUSIBLE_SIZE
    for unit in UNIT_GUESS_ORDER:
        if low <= longest * USER_UNITS[unit] <= high:
            return f"as --unit {unit} it would be {longest * USER_UNITS[unit] * 1e3:.4g} mm"
    return "and no --unit makes it plausible: scale the file"


def _unit(longest: float, given: str | None, stated: str | None) -> tuple[str, bool, str]:
    """(unit, whether it is guessed, reason) for a longest side in the unit of the file."""
    if given is not None:
        return given, False, "as given"
    if stated is not None:
        return stated, False, "stated in the file"
    low, high = PLAUSIBLE_SIZE

    def implausibility(unit: str) -> float:
        size = max(longest * USER_UNITS[unit], 1e-300)
        return max(math.log(low * (1 - 1e-9) / size), math.log(size / (high * (1 + 1e-9))), 0.0)

    unit = min(UNIT_GUESS_ORDER, key=implausibility)
    others = [other for other in UNIT_GUESS_ORDER if other != unit and implausibility(other) == 0]
    also = f"; could also be {' or '.join(others)}" if others else ""
    size = f"longest side {longest:.4g} read as {unit} is {longest * USER_UNITS[unit] * 1e3:.4g} mm"
    return unit, True, f"guessed: {size}{also}; override with the unit option (mm, cm, m, inch)"


def _moved_to_origin(vertices: np.ndarray, used: np.ndarray, notes: list[str]) -> np.ndarray:
    low, high = vertices[used].min(0), vertices[used].max(0)
    if np.abs(low + high).max() / 2 <= MAX_OFFSET_RATIO * (high - low).max():
        return vertices
    notes.append(f"moved to the origin from {np.sqrt(np.square(low + high).sum()) / 2:.4g} m away")
    return vertices - (low + high) / 2


def _meshes_below(folder: Path) -> list[Path]:
    """Mesh files below a folder, sorted, without hidden files and folders."""
    files = (file for file in folder.rglob("*") if file.suffix.lower() in MESH_SUFFIXES and file.is_file())
    inner = ((file, file.relative_to(folder).parts) for file in files)
    return sorted(file for file, parts in inner if not any(part.startswith(".") for part in parts))


def _meshes_listed(listing: Path) -> list[Path]:
    """The mesh files of a list in UTF-8, by their names or the folders that hold them."""
    try:
        text = os.fsdecode(listing.read_bytes().removeprefix(BYTE_ORDER_MARK))  # names that are no UTF-8 stay
    except OSError as error:
        raise InputError(f"{listing}: cannot be read as a list of paths: {error}") from None
    if "\0" in text:
        raise InputError(f"{listing}: cannot be read as a list of paths: binary data or UTF-16; save it in UTF-8")
    names = (line.strip() for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))
    entries = [listing.parent / name for name in names if name and not name.startswith("#")]
    return [file for entry in entries for file in (_meshes_below(entry) if entry.is_dir() else [entry])]
