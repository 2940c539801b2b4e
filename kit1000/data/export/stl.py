"""An assembly as one STL in millimetres, z up, standing on z = 0: ready for a slicer."""

from __future__ import annotations

from pathlib import Path

from kit1000.data.files import write_bytes
from kit1000.data.meshes import stl_bytes
from kit1000.values import Assembly


def write_stl(assembly: Assembly, path: Path) -> Path:
    """Write a binary STL; a file of that name is replaced."""
    write_bytes(path, stl_bytes(assembly.mesh))
    return path
