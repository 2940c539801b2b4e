"""Reading OBJ files, whose faces have any number of corners, concave ones too, and PLY files of triangles."""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np

from kit1000.errors import MeshRefused, shown
from kit1000.parts.files.file_text import BYTE_ORDER_MARK, check_foreign, check_narrow, numbers, plain_text
from kit1000.parts.files.triangles import TriangleSoup, check_indices, decimal_step, float32_step, polygons_as_triangles

OBJ_CURVES = (b"surf", b"bmat", b"cstype", b"curv")
PLY_HEADER_END = re.compile(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)")
PLY_ELEMENT = re.compile(rb"^element[ \t]+(\w+)[ \t]+(\d+)", re.MULTILINE)
MAX_PLY_HEADER = 1 << 20  # [bytes]


def read_obj(data: bytes) -> TriangleSoup:
    """The faces of an OBJ file; lines, points, textures and normals are ignored."""
    text = plain_text(data)
    points: list[bytes] = []
    polygons: list[list[int]] = []
    count = 0
    for line in text.replace(b"\\\n", b" ").split(b"\n"):
        words = line.partition(b"#")[0].split()
        key = words[0] if words else b""
        if key == b"v":
            if len(words) < 4:
                raise MeshRefused(f"not readable as OBJ: {_shown(line)} has fewer than 3 coordinates")
            points += words[1:4]
            count += 1
        elif key in (b"f", b"fo"):
            try:
                corners = [int(word.partition(b"/")[0]) for word in words[1:]]
            except ValueError:
                raise MeshRefused(f"not readable as OBJ: in {_shown(line)} a number is not whole") from None
            polygons.append([i + count if i < 0 else i - 1 for i in corners])
        elif key in OBJ_CURVES:
            raise MeshRefused("holds curved surfaces (cstype, surf), which are not read: export it as polygons")
    vertices = numbers(points, text, "OBJ").reshape(-1, 3)
    check_indices(np.array([i for row in polygons for i in row], dtype=np.int64), len(vertices), "OBJ")
    return TriangleSoup(vertices, polygons_as_triangles(vertices, polygons), step=decimal_step(vertices))


def _shown(line: bytes) -> str:
    """A line in a message."""
    return repr(shown(line.strip()[:40].decode("utf-8", "replace")))


def read_ply(data: bytes) -> TriangleSoup:
    """The triangles of a PLY file, which trimesh reads; other properties are ignored.

    A damaged file may raise any exception.
    """
    check_foreign(data)
    check_narrow(data)
    data = data.removeprefix(BYTE_ORDER_MARK)
    end = PLY_HEADER_END.search(data, 0, MAX_PLY_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise MeshRefused("not readable as PLY: no header")
    header = data[: end.start()]
    elements = {name: int(count) for name, count in PLY_ELEMENT.findall(header)}
    if max(elements.values(), default=0) > len(data):
        raise MeshRefused(f"cut short or damaged: {max(elements.values()):,} elements declared in {len(data):,} bytes")
    if b"tristrips" in elements:
        raise MeshRefused("holds strips of triangles (tristrips), which are not read: export it as triangles")
    import trimesh  # only here: its import takes longer than reading most files

    mesh: Any = trimesh.load_mesh(io.BytesIO(data), file_type="ply", process=False)
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) != elements.get(b"face", 0):  # trimesh cuts polygons up as if they were convex
        raise MeshRefused("cut short, or with faces of more than three corners: export it as triangles")
    check_indices(faces, len(vertices), "PLY")
    is_text = re.search(rb"format[ \t]+ascii", header) is not None
    return TriangleSoup(vertices, faces, step=decimal_step(vertices) if is_text else float32_step(vertices))
