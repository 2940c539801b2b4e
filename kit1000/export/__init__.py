"""Export of datasets to other formats: assemblies as URDF, STL or 3MF, scenes in the BOP format; kits for own parts."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kit1000.export.exporting import ASSEMBLY_FORMATS, FORMATS, SCENE_FORMATS, export

__all__ = ["ASSEMBLY_FORMATS", "FORMATS", "SCENE_FORMATS", "export"]


def __getattr__(name: str) -> Any:
    """Import the writers of datasets on first use: a kit for an own part needs none of them."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(import_module("kit1000.export.exporting"), name)
