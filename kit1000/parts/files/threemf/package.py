"""The archive of a 3MF file: its parts by name, whatever their case and percent-encoding, and its root model.

Part names are those of the Open Packaging Conventions: absolute, compared without case, percent-encoded or not.
"""

from __future__ import annotations

import posixpath
import zipfile
from typing import Any
from urllib.parse import unquote

from lxml import etree  # pyright: ignore[reportAttributeAccessIssue] (a compiled module)

from kit1000.errors import MeshRefused

RELATIONSHIPS = "_rels/.rels"
ROOT_RELATIONSHIP = "/3dmodel"  # ends the type of the relationship that names the root model
USUAL_ROOT = "3d/3dmodel.model"
XML_OPTIONS: dict[str, Any] = {
    "resolve_entities": False,
    "no_network": True,
    "huge_tree": True,
    "remove_comments": True,
}


class Package:
    """The parts of an archive."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self.archive = archive
        self.names = {plain(name): name for name in archive.namelist()}

    def open(self, name: str) -> Any:
        """A part as a file of bytes, by its plain name."""
        return self.archive.open(self.names[name])

    def xml(self, name: str) -> Any:
        """The root element of a part by its plain name; None where the archive lacks it."""
        if name not in self.names:
            return None
        with self.open(name) as file:
            return etree.parse(file, etree.XMLParser(**XML_OPTIONS)).getroot()

    def located(self, reference: str, source: str) -> str:
        """The plain name of a part that another one refers to: absolute, or else beside that part."""
        name = plain(reference)
        beside = plain(posixpath.normpath(posixpath.join(posixpath.dirname(source), unquote(reference))))
        found = name if reference.startswith("/") or name in self.names else beside
        if found not in self.names:
            raise MeshRefused(f"not readable as 3MF: names {name[:80]}, which is not in the archive")
        return found

    def root(self) -> str:
        """The plain name of the root model: the one that the relationships name, else the usual or the only one."""
        relationships = self.xml(plain(RELATIONSHIPS))
        for element in () if relationships is None else relationships.iterfind("{*}Relationship"):
            if element.get("Type", "").lower().endswith(ROOT_RELATIONSHIP):
                return self.located(element.get("Target", ""), "")
        models = sorted(name for name in self.names if name.endswith(".model"))
        if not models:
            raise MeshRefused("not readable as 3MF: no model file in the archive")
        return USUAL_ROOT if USUAL_ROOT in models else models[0]


def plain(name: str) -> str:
    """The name of a part as they are compared."""
    return unquote(name).replace("\\", "/").strip("/").lower()
