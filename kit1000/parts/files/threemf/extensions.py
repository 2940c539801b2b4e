"""Extensions of 3MF: those that change no shape, and those without which an object would be read wrong.

An unknown extension that a model requires, and a shape that is no mesh, are refused by name: left out, the rest of the
file would be taken for the part.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] (a compiled module)

from kit1000.errors import MeshRefused

HARMLESS = ("production", "material", "trianglesets", "slice")
"""Extensions that are read, or that say nothing about the mesh; coarse meshes beside slices are refused by object."""
NAMED = {
    "booleanoperations": "boolean shapes",
    "beamlattice": "beam lattices",
    "securecontent": "encrypted content",
    "displacement": "displaced surfaces",
    "volumetric": "volumetric data",
    "implicit": "implicit shapes",
    "alternatives": "stand-ins for other meshes",
}
"""What an extension is about, by a word of its address."""
EXPORT = "export it as a plain mesh of triangles"
INSIDE_OBJECTS = ("mesh", "components", "metadatagroup", "metadata", "settings", "alternatives", "volumes")
FULL = "fullres"


def check_required(model: Any, path: str) -> None:
    """Raise MeshRefused when a model element requires an extension that is not known here."""
    for prefix in model.get("requiredextensions", "").split():
        address = model.nsmap.get(prefix)
        if address is None or not any(f"/{word}/" in address for word in HARMLESS) or "/alternatives/" in address:
            raise MeshRefused(f"{path[:80]} requires the 3MF extension {_described(prefix, address)}; {EXPORT}")


def _described(prefix: str, address: str | None) -> str:
    """An extension for a message, by its prefix and its address in full."""
    topic = next((text for word, text in NAMED.items() if word in (address or "")), None)
    about = f"{topic}, " if topic else ""
    return f"{prefix[:40]} ({about}{address[:120] if address else 'not declared'}), which is not supported"


def shape_fault(element: Any) -> str | None:
    """Why an object element cannot be read as a mesh; None where it can. Asked only of objects that the build uses."""
    shapes = [etree.QName(child).localname for child in element if isinstance(child.tag, str)]
    unknown = [shape for shape in shapes if shape not in INSIDE_OBJECTS]
    if unknown and not {"mesh", "components"} & {*shapes}:
        return f"object {element.get('id', '')[:20]} is a {unknown[0][:40]}, which is not supported; {EXPORT}"
    detail = _detail(element.attrib)
    if detail not in (None, FULL):
        what = f"object {element.get('id', '')[:20]} has a mesh of resolution {detail[:40]}"
        return f"{what}, a stand-in for its shape; {EXPORT}"
    return None


def _detail(attributes: Mapping[str, str]) -> str | None:
    """The resolution that an object states, of the slice extension or of alternatives."""
    names = ("meshresolution", "modelresolution")
    return next((value for name, value in attributes.items() if etree.QName(name).localname in names), None)
