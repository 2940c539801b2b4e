"""Whether a mesh source gives parts that kits can be made of, and refuses the rest in one line."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.mesh import body_count, defect_float32
from kit1000.parts.files.sources import ACCEPTED_SIZE, Outcome, Reading, Refusal

Read = Callable[[Path], Reading]
"""Reads one file as a part, or raises MeshRefused."""


def check_source(read: Read, files: Iterable[str | Path], name: str = "source") -> None:
    """Check a reader of mesh files on files that hold parts.

    Each is read twice with one result: a closed mesh of one body in metres, on the float32 grid, with its unit and what
    was done to it. Of cut copies, an empty one and a missing one, each is a part like that or is refused in one line.
    """
    for path in map(Path, files):
        before = path.read_bytes()
        outcome = _outcome(read, path, name)
        assert not isinstance(outcome, Refusal), f"{name}: {path.name} is refused: {outcome.reason}"
        _check_reading(outcome, path, name)
        again = _outcome(read, path, name)
        same = isinstance(again, Reading) and again.mesh.vertices.tobytes() == outcome.mesh.vertices.tobytes()
        assert same, f"{name}: {path.name} read twice gives two meshes"
        assert path.read_bytes() == before, f"{name}: {path.name} was changed by reading it"
        _check_damaged(read, path, before, name)


def _check_reading(reading: Reading, path: Path, name: str) -> None:
    mesh, where = reading.mesh, f"{name}: {path.name}"
    assert Path(reading.path) == path, f"{where}: the reading names {reading.path}"
    defect = defect_float32(mesh)
    assert defect is None, f"{where}: {defect}"
    assert mesh.volume > 0, f"{where}: inside out, its volume is {mesh.volume:.3g} m^3"
    bodies = body_count(mesh)
    assert bodies == 1, f"{where}: {bodies} bodies, expected 1"
    on_grid = np.array_equal(mesh.vertices, mesh.rounded_float32().vertices)
    assert on_grid, f"{where}: vertices are not on the float32 grid, so that files would hold others"
    low, high = ACCEPTED_SIZE
    longest = float(mesh.extents.max())
    assert low <= longest <= high, f"{where}: longest side {longest:.4g} m, expected {low:g} to {high:g} (metres?)"
    told = bool(reading.unit and reading.unit_reason)
    assert told, f"{where}: does not say in which unit it was read, and why"
    lines = (reading.unit_reason, *reading.notes)
    assert all(line.strip() and "\n" not in line for line in lines), f"{where}: a note is empty or not one line"


def _check_damaged(read: Read, path: Path, data: bytes, name: str) -> None:
    """Whatever is left of a file is a part or is refused: no other exception, no broken mesh."""
    with TemporaryDirectory() as folder:
        for share in (0.0, 0.1, 0.5, 0.9):
            cut = Path(folder) / f"cut at {share:.0%}{path.suffix}"
            cut.write_bytes(data[: int(share * len(data))])
            outcome = _outcome(read, cut, name)
            if isinstance(outcome, Reading):
                assert share > 0, f"{name}: an empty file is read as a part"
                _check_reading(outcome, cut, name)
        missing = _outcome(read, Path(folder) / f"missing{path.suffix}", name)
        assert isinstance(missing, Refusal), f"{name}: a file that is not there is read as a part"


def _outcome(read: Read, path: Path, name: str) -> Outcome:
    try:
        reading = read(path)
    except MeshRefused as refused:
        reading = Refusal(path, refused.reason)
    except Exception as error:
        said = f"{type(error).__name__} ({' '.join(str(error).split())})"
        raise AssertionError(f"{name}: {path.name} ends in {said}, expected MeshRefused") from error
    if isinstance(reading, Refusal):
        one_line = bool(reading.reason.strip()) and "\n" not in reading.reason
        assert one_line, f"{name}: refuses {path.name} with {reading.reason!r}, expected one line"
        return reading
    said = f"{name}: {path.name} gives a {type(reading).__name__}"
    assert isinstance(reading, Reading), f"{said}, expected a kit1000.parts.files.sources.Reading"
    return reading
