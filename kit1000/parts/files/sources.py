"""Mesh files as parts: their units, reading and repair.

Every change is in a reading's notes and every guess states how to override it; a file that cannot be a part is
refused with one line, and one bad file never stops a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from manifold3d import Manifold

from kit1000.errors import InputError, MeshRefused
from kit1000.mesh import Mesh
from kit1000.parts.files.formats import STEP_SUFFIXES, read_triangles
from kit1000.parts.files.listings import mesh_files
from kit1000.parts.files.negative_volumes import solid_of_soup
from kit1000.parts.files.united_bodies import Choice, body_meshes, part_mesh

__all__ = [
    "FILE_UNITS",
    "USER_UNITS",
    "MeshReading",
    "Outcome",
    "Refusal",
    "mesh_files",
    "read_all",
    "read_bodies",
    "read_mesh",
]

USER_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "inch": 0.0254}  # [m] that a user can give
FILE_UNITS = USER_UNITS | {"foot": 0.3048, "micron": 1e-6}  # [m] that a file can state
UNIT_GUESS_ORDER = ("mm", "m", "inch", "cm")  # the most frequent in machine parts first
PLAUSIBLE_SIZE = (0.005, 0.5)  # [m] longest side of a machine part, by which a unit is guessed
ACCEPTED_SIZE = (1e-4, 10.0)  # [m] longest side of a part that is not refused
MAX_OFFSET_RATIO = 100.0  # distance from the origin in longest sides; farther away float32 would ruin the shape


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


@dataclass(frozen=True)
class Refusal:
    """A file that cannot be a part."""

    path: Path
    reason: str


Outcome = MeshReading | Refusal


def read_mesh(path: str | Path, unit: str | None = None, choice: Choice | None = None) -> MeshReading:
    """Read one mesh file as a part.

    Args:
        path: STL, OBJ, PLY, OFF, 3MF, GLB or GLTF; STEP where its optional reader is installed.
        unit: "mm", "cm", "m" or "inch"; None: the one stated in the file, else guessed from its size.
        choice: of several bodies "union": all as one, which must touch or overlap; "largest"; None: that with nearly
            all of the volume.

    Raises:
        SeveralBodies: there are several bodies, and by `choice` no single one.
        MeshRefused: the file cannot be a part; one line says why.
        InputError: the unit is unknown.
    """
    solid = _read_solid(Path(path), unit)
    mesh = part_mesh(solid.solid, solid.notes, choice)
    return MeshReading(solid.path, mesh, solid.unit, solid.unit_guessed, solid.unit_reason, tuple(solid.notes))


def read_bodies(path: str | Path, unit: str | None = None) -> list[MeshReading | Refusal]:
    """Read each body of a mesh file as a part, or as the reason why it cannot be one; the largest first.

    Bodies that touch or overlap are one. Raises as `read_mesh` does when the whole file is refused.
    """
    solid = _read_solid(Path(path), unit)
    stated = (solid.unit, solid.unit_guessed, solid.unit_reason)
    return [
        MeshReading(solid.path, mesh, *stated, tuple(notes))
        if isinstance(mesh, Mesh)
        else Refusal(solid.path, mesh.reason)
        for mesh, notes in body_meshes(solid.solid, solid.notes)
    ]


@dataclass(frozen=True, eq=False)
class _SolidReading:
    """All that a file bounds, in metres, before bodies are told apart; the other fields as in MeshReading."""

    path: Path
    solid: Manifold
    unit: str
    unit_guessed: bool
    unit_reason: str
    notes: list[str]


def _read_solid(path: Path, unit: str | None) -> _SolidReading:
    if unit is not None and unit not in USER_UNITS:
        raise InputError(f"unit {unit!r}: expected one of {', '.join(USER_UNITS)}")
    soup = read_triangles(path)
    notes = list(soup.notes)
    used = np.zeros(len(soup.vertices), dtype=bool)
    used[soup.part_faces] = True
    _check_finite(soup.vertices[used])
    longest = float(np.ptp(soup.vertices[used], axis=0).max())
    given = unit
    if unit is not None and path.suffix.lower() in STEP_SUFFIXES:  # whose reader has converted already
        given = None
        notes.append(f"did not use the given unit {unit}: STEP states its own")
    chosen, guessed, reason = _unit(longest, given, soup.unit)
    vertices = soup.vertices * FILE_UNITS[chosen]
    _check_size(longest * FILE_UNITS[chosen], chosen)
    vertices = _moved_to_origin(vertices, used, notes)
    return _SolidReading(path, solid_of_soup(replace(soup, vertices=vertices), notes), chosen, guessed, reason, notes)


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
    """(unit, whether guessed, reason) for a longest side in the unit of the file."""
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
    notes.append(f"moved to the origin from {np.linalg.norm(low + high) / 2:.4g} m away")
    return vertices - (low + high) / 2


def read_all(
    paths: Iterable[str | Path], unit: str | None = None, workers: int = 1
) -> tuple[list[MeshReading], list[Refusal]]:
    """Read many files; both lists keep the order of the paths, whatever the number of workers.

    Raises InputError for an unknown unit.
    """
    if unit is not None and unit not in USER_UNITS:
        raise InputError(f"unit {unit!r}: expected one of {', '.join(USER_UNITS)}")
    files = [Path(path) for path in paths]
    read = partial(_read_or_refuse, unit=unit)
    outcomes = list(read_parallel(read, files, workers) if workers > 1 and len(files) > 1 else map(read, files))
    readings = [outcome for outcome in outcomes if isinstance(outcome, MeshReading)]
    return readings, [outcome for outcome in outcomes if isinstance(outcome, Refusal)]


def _read_or_refuse(path: Path, unit: str | None) -> Outcome:
    try:
        return read_mesh(path, unit)
    except MeshRefused as refused:
        return Refusal(path, refused.reason)
    except MemoryError:
        return Refusal(path, "needs more memory than there is")


def read_parallel(read: Callable[[Path], Outcome], files: Sequence[Path], workers: int) -> Iterator[Outcome]:
    """Outcomes in order from several processes; a file that crashes its process is refused, the others are read."""
    done = 0
    while done < len(files):
        with _pool(min(workers, len(files) - done)) as pool:
            try:
                for outcome in pool.map(read, files[done:]):
                    yield outcome
                    done += 1
            except BrokenProcessPool:  # crashed by one of the files being read, so the next is read alone
                yield _read_alone(read, files[done])
                done += 1


def _read_alone(read: Callable[[Path], Outcome], path: Path) -> Outcome:
    with _pool(1) as pool:
        try:
            return pool.submit(read, path).result()
        except BrokenProcessPool:
            return Refusal(path, "its reader crashed")


def _pool(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, get_context("spawn"))  # a fork would copy locks that threads hold
