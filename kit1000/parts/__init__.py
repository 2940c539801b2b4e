"""Parts: families of procedural machine parts, drawn in millimetres, and meshes read from files.

The public names load on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kit1000.parts.family import Family, make_part, part_of_mesh
    from kit1000.parts.family_catalog import FAMILIES
    from kit1000.parts.files.read import mesh_files, read_mesh

__all__ = ["FAMILIES", "Family", "make_part", "mesh_files", "part_of_mesh", "read_mesh"]

_MODULES = {"FAMILIES": "family_catalog", "mesh_files": "files.read", "read_mesh": "files.read"}  # others: family


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'kit1000.parts' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module(f"kit1000.parts.{_MODULES.get(name, 'family')}"), name)


def __dir__() -> list[str]:
    return list(__all__)
