"""Conformance of a mesh reader: valid parts, or a refusal of one line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.mesh import body_count, defect_float32
from kit1000.parts.files.read import ACCEPTED_SIZE, MeshReading, Outcome, Refusal

Read = Callable[[Path], MeshReading]
"""Reads one file as a part, or raises MeshRefused."""


def check_source(read: Read, files: Iterable[str | Path], name: str = "source") -> None:
    """Check a reader of mesh files on files of valid parts.

    Two reads of a file give the same result: a closed mesh of one body in metres, with float32 coordinates, its unit
    and the repairs. Truncated, empty and missing files give such a part or a refusal of one line.
    """
    for path in map(Path, files):
        before = path.read_bytes()
        outcome = _read_or_refuse(read, path, name)
        assert not isinstance(outcome, Refusal), f"{name}: {path.name} is refused: {outcome.reason}"
        _check_part(outcome, path, name)
        again = _read_or_refuse(read, path, name)
        same = isinstance(again, MeshReading) and again.mesh.vertices.tobytes() == outcome.mesh.vertices.tobytes()
        assert same, f"{name}: {path.name} gives two different meshes when read twice"
        assert path.read_bytes() == before, f"{name}: {path.name} is modified by reading it"
        _check_damaged_files(read, path, before, name)


def _check_part(reading: MeshReading, path: Path, name: str) -> None:
    mesh, where = reading.mesh, f"{name}: {path.name}"
    assert Path(reading.path) == path, f"{where}: the result has path {reading.path}"
    defect = defect_float32(mesh)
    assert defect is None, f"{where}: {defect}"
    assert mesh.volume > 0, f"{where}: inside out, its volume is {mesh.volume:.3g} m^3"
    bodies = body_count(mesh)
    assert bodies == 1, f"{where}: {bodies} bodies, expected 1"
    on_grid = np.array_equal(mesh.vertices, mesh.rounded_float32().vertices)
    assert on_grid, f"{where}: vertices are not exact in float32, so that saved files would differ"
    low, high = ACCEPTED_SIZE
    longest = float(mesh.extents.max())
    assert low <= longest <= high, f"{where}: longest side {longest:.4g} m, expected {low:g} to {high:g} (metres?)"
    has_unit = bool(reading.unit and reading.unit_reason)
    assert has_unit, f"{where}: has no unit, or no reason for it"
    lines = (reading.unit_reason, *reading.notes)
    assert all(line.strip() and "\n" not in line for line in lines), (
        f"{where}: a note or the reason of the unit is empty or has several lines"
    )


def _check_damaged_files(read: Read, path: Path, data: bytes, name: str) -> None:
    """Truncated files give a valid part or a refusal: no other exception, no invalid mesh."""
    with TemporaryDirectory() as folder:
        for share in (0.0, 0.1, 0.5, 0.9):
            cut = Path(folder) / f"cut at {share:.0%}{path.suffix}"
            cut.write_bytes(data[: int(share * len(data))])
            outcome = _read_or_refuse(read, cut, name)
            if isinstance(outcome, MeshReading):
                assert share > 0, f"{name}: an empty file is read as a part"
                _check_part(outcome, cut, name)
        missing = _read_or_refuse(read, Path(folder) / f"missing{path.suffix}", name)
        assert isinstance(missing, Refusal), f"{name}: a missing file is read as a part"


def _read_or_refuse(read: Read, path: Path, name: str) -> Outcome:
    try:
        reading = read(path)
    except MeshRefused as refused:
        reading = Refusal(path, refused.reason)
    except Exception as error:
        raised = f"{type(error).__name__} ({' '.join(str(error).split())})"
        raise AssertionError(f"{name}: {path.name} raises {raised}, expected MeshRefused") from error
    if isinstance(reading, Refusal):
        one_line = bool(reading.reason.strip()) and "\n" not in reading.reason
        assert one_line, f"{name}: refuses {path.name} with {reading.reason!r}, expected a reason of one line"
        return reading
    kind = type(reading).__name__
    assert isinstance(reading, MeshReading), (
        f"{name}: {path.name} gives a {kind}, expected a kit1000.parts.files.read.MeshReading"
    )
    return reading
