"""Export of an assembly as one STL in millimetres, z up, standing on z = 0: ready for a slicer."""

from __future__ import annotations

from pathlib import Path

from kit1000.dataset.mesh_files import stl_bytes
from kit1000.files import write_bytes
from kit1000.values import Assembly


def write_stl(assembly: Assembly, path: Path) -> Path:
    """Write a binary STL, replacing an existing file; returns the path."""
    write_bytes(path, stl_bytes(assembly.mesh))
    return path
