"""A mesh file gives the same valid part in every read; a damaged one gives a valid part or a refusal of one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from kit1000.errors import MeshRefused
from kit1000.mesh import body_count, defect_float32
from kit1000.parts import read_mesh
from tests.samples.mini import l_shape, write_stl


@pytest.fixture(params=["stl", "ply", "obj"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    stl = write_stl(tmp_path / "corner.stl", l_shape())
    if request.param == "stl":
        return stl
    other = stl.with_suffix(f".{request.param}")
    trimesh.load_mesh(stl).export(other)
    return other


def check_reading(path: Path) -> bytes:
    """Check that a file gives a valid part; returns the bytes of its vertices."""
    reading = read_mesh(path)
    mesh = reading.mesh
    assert defect_float32(mesh) is None
    assert mesh.volume > 0
    assert body_count(mesh) == 1
    assert np.array_equal(mesh.vertices, mesh.rounded_float32().vertices)
    assert 1e-4 <= mesh.extents.max() <= 10  # [m]
    assert reading.unit
    assert all(line.strip() and "\n" not in line for line in (reading.unit_reason, *reading.notes))
    return mesh.vertices.tobytes()


def refusal_of(path: Path) -> str | None:
    """The reason for which a file is refused, or None when it gives a valid part."""
    try:
        check_reading(path)
    except MeshRefused as refused:
        return refused.reason
    return None


def test_a_valid_file_gives_the_same_part_in_every_read(path: Path) -> None:
    data = path.read_bytes()
    assert check_reading(path) == check_reading(path)
    assert path.read_bytes() == data


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, None])
def test_a_truncated_or_missing_file_gives_a_part_or_a_refusal(share: float | None, path: Path) -> None:
    data = path.read_bytes()
    path.unlink()
    if share is not None:
        path.write_bytes(data[: int(share * len(data))])
    reason = refusal_of(path)
    assert share or reason
    assert reason is None or (reason.strip() and "\n" not in reason)
