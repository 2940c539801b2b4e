"""A solid as one object of a 3MF in millimetres, z up: ready for a slicer.

The writer of trimesh puts random identifiers into every file; the bytes of this one depend only on the mesh.
Coordinates have full precision: values read back equal those written.
"""

from __future__ import annotations

import io
import zipfile
from xml.sax.saxutils import quoteattr

from kit1000.mesh import Mesh

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PACKAGE = "http://schemas.openxmlformats.org/package/2006"
XML = '<?xml version="1.0" encoding="UTF-8"?>\n'
TYPES = f"""{XML}<Types xmlns="{PACKAGE}/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""
RELATIONS = f"""{XML}<Relationships xmlns="{PACKAGE}/relationships">
<Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""
ALWAYS = (1980, 1, 1, 0, 0, 0)  # the earliest time in the zip format


def threemf_bytes(name: str, mesh: Mesh) -> bytes:
    """A mesh as a 3MF of one object."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for path, text in (
            ("[Content_Types].xml", TYPES),
            ("_rels/.rels", RELATIONS),
            ("3D/3dmodel.model", _model(name, mesh)),
        ):
            entry = zipfile.ZipInfo(path, ALWAYS)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, text)
    return packed.getvalue()


def _model(name: str, mesh: Mesh) -> str:
    vertices = (f'<vertex x="{x!r}" y="{y!r}" z="{z!r}"/>' for x, y, z in (mesh.vertices * 1e3).tolist())
    triangles = (f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces.tolist())
    lines = [
        f'<model unit="millimeter" xml:lang="en-US" xmlns="{CORE}">',
        '<metadata name="Application">KIT1000</metadata>',
        "<resources>",
        f'<object id="1" type="model" name={quoteattr(name)}>',
        "<mesh>",
        "<vertices>",
        *vertices,
        "</vertices>",
        "<triangles>",
        *triangles,
        "</triangles>",
        "</mesh>",
        "</object>",
        "</resources>",
        "<build>",
        '<item objectid="1"/>',
        "</build>",
        "</model>",
    ]
    return XML + "\n".join(lines) + "\n"
