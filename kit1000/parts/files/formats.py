"""Reading mesh files as raw triangles, each format by its reader, every fault as one line.

Nothing is repaired and no unit is converted. A file is never trusted: the counts in its header are compared with its
size before memory is allocated, so that a damaged or malicious file causes an error message and nothing worse.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.mesh import z_up
from kit1000.parts.files.foreign_content import check_foreign
from kit1000.parts.files.gltf.node_tree import read_gltf
from kit1000.parts.files.obj_and_off import read_obj, read_off
from kit1000.parts.files.ply_elements import read_ply
from kit1000.parts.files.soup import Cut, TriangleSoup, joined
from kit1000.parts.files.stl_dialects import read_stl

if TYPE_CHECKING:
    from kit1000.parts.files.threemf.placing import Built

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".3mf", ".glb", ".gltf", ".step", ".stp")
STEP_SUFFIXES = (".step", ".stp")
GLTF_SUFFIXES = (".glb", ".gltf")  # y up by the standard; all others are taken as they are
MAX_FACES = 5_000_000
MAX_BYTES = 1_500_000_000  # an ASCII STL of 5 million faces; also the limit of what a 3MF may unpack to
UNIT_NAMES = {"millimeter": "mm", "centimeter": "cm", "meter": "m"}
UNIT_NAMES |= {"inch": "inch", "foot": "foot", "micron": "micron"}


def read_triangles(path: Path) -> TriangleSoup:
    """The triangles of a mesh file. Raises MeshRefused with one line when it has none."""
    data = _bytes(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise MeshRefused(f"not a mesh format: {suffix or 'no suffix'}; known are {' '.join(MESH_SUFFIXES)}")
    try:
        soup = _read(path, suffix, data)
    except (MeshRefused, MemoryError):
        raise
    except Exception as error:  # a damaged file may break a reader in any way
        raise MeshRefused(f"not readable as {suffix[1:].upper()}: {_message(error)}") from None
    if not len(soup.part_faces):
        raise MeshRefused("holds no triangles")
    _check_count(len(soup.part_faces))
    return soup


def _read(path: Path, suffix: str, data: bytes) -> TriangleSoup:
    if suffix == ".stl":
        return read_stl(data, MAX_FACES)
    if suffix == ".3mf":
        return _read_3mf(data)
    if suffix in GLTF_SUFFIXES:
        soup = read_gltf(data, path.parent, MAX_FACES)
        return replace(soup, vertices=z_up(soup.vertices))
    check_foreign(data)
    return _read_step(data, suffix) if suffix in STEP_SUFFIXES else TEXT_READERS[suffix](data)


TEXT_READERS: dict[str, Callable[[bytes], TriangleSoup]] = {".obj": read_obj, ".off": read_off, ".ply": read_ply}


def _message(error: Exception) -> str:
    """An exception of a reader, in a few words."""
    words = "" if isinstance(error, OSError) else " ".join(str(error).split())[:100]
    return words or "damaged"


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


def _check_archive(data: bytes) -> None:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
    except NotImplementedError:  # of the version that an entry asks for
        raise MeshRefused("not readable as 3MF: its zip archive needs a newer reader; save it again") from None
    except (zipfile.BadZipFile, ValueError, OSError):
        raise MeshRefused("not readable as 3MF: not a zip archive") from None
    if size > MAX_BYTES:
        raise MeshRefused(f"unpacks to {size / 1e9:.1f} GB, more than {MAX_BYTES / 1e9:.1f} GB")


def _read_3mf(data: bytes) -> TriangleSoup:
    check_foreign(data, archive=True)
    _check_archive(data)
    from kit1000.parts.files.threemf.placing import read_threemf  # only here: other formats need no reader of XML

    built = read_threemf(data, MAX_FACES)
    lattice = "a beam lattice, which has no triangles"
    if not any(len(volume.faces) for volume in built.volumes) and built.has_lattice:
        raise MeshRefused(f"holds {lattice}, and is not supported: export it as a mesh of triangles")
    notes = (*built.notes, *((f"ignored {lattice}",) if built.has_lattice else ()))
    return _soup_of_volumes(built, notes)


def _soup_of_volumes(built: Built, notes: tuple[str, ...]) -> TriangleSoup:
    """The volumes as one soup; negative ones are subtracted from the parts before them in their item alone."""
    from kit1000.parts.files.threemf.roles import NEGATIVE

    vertices, _ = joined([(volume.vertices, volume.faces) for volume in built.volumes])
    starts = np.cumsum([0, *(len(volume.vertices) for volume in built.volumes)]).tolist()
    runs: dict[int, list[tuple[str, list[np.ndarray]]]] = {}
    for volume, start in zip(built.volumes, starts[:-1], strict=True):
        own = runs.setdefault(volume.item, [])
        if not own and volume.role == NEGATIVE:
            continue  # nothing is before it
        if not own or own[-1][0] != volume.role:
            own.append((volume.role, []))
        own[-1][1].append(volume.faces + start)
    merged = [tuple(np.concatenate(faces) for _, faces in runs[item]) for item in sorted(runs) if runs[item]]
    cuts = tuple(Cut(faces) for faces in merged if len(faces) > 1)
    plain = [faces[0] for faces in merged if len(faces) == 1]
    rest = np.concatenate([np.zeros((0, 3), dtype=np.int64), *plain])
    return TriangleSoup(vertices, rest, UNIT_NAMES.get(built.unit), notes, cuts)


def _read_step(data: bytes, suffix: str) -> TriangleSoup:
    """Read by trimesh, whose reader converts to metres."""
    if find_spec("cascadio") is None:
        raise MeshRefused("STEP files need an optional reader: pip install cascadio")
    import trimesh  # only here: importing it takes longer than reading an STL and making many a kit

    scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], process=False)
    pieces = [piece for piece in scene.dump() if isinstance(piece, trimesh.Trimesh) and len(piece.faces)]
    meshes = [(np.asarray(p.vertices, dtype=np.float64), np.asarray(p.faces, dtype=np.int64)) for p in pieces]
    return TriangleSoup(*joined(meshes), "m")
