"""Export of an assembly as one STL in millimetres, z up, standing on z = 0: ready for a slicer."""

from __future__ import annotations

from pathlib import Path

from kit1000.dataset.mesh_files import stl_bytes
from kit1000.files import write_own
from kit1000.values import Assembly


def write_stl(assembly: Assembly, path: Path) -> Path:
    """Write a binary STL, unless one of another origin is there; returns the path."""
    write_own(path, stl_bytes(assembly.mesh))
    return path
