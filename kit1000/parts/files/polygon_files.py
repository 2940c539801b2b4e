"""Reading OBJ and PLY files: faces with any number of corners, concave ones too."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from kit1000.errors import MeshRefused, shown
from kit1000.parts.files.file_text import BYTE_ORDER_MARK, check_foreign, check_narrow, numbers, plain_text
from kit1000.parts.files.triangles import (
    TriangleSoup,
    check_indices,
    decimal_step,
    float32_step,
    polygons_as_triangles,
)

OBJ_CURVES = (b"surf", b"bmat", b"cstype", b"curv")
PLY_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
PLY_TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
PLY_TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"}
PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
PLY_HEADER_END = re.compile(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)")
PLY_CORNERS = ("vertex_indices", "vertex_index")
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


@dataclass(frozen=True)
class _Property:
    """A property of a PLY element."""

    name: str
    kind: str
    """numpy's code of the value, or of each value of a list; float64 in a text."""
    counter: str | None
    """numpy's code of the length of a list; None for a single value."""


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


def read_ply(data: bytes) -> TriangleSoup:
    """The faces of a PLY file, in text or binary; colours, normals and all other properties are ignored."""
    check_foreign(data)
    check_narrow(data)
    elements, body, is_text = _ply_header(data.removeprefix(BYTE_ORDER_MARK))
    if is_text:  # read as if it were binary, with all values float64
        body = numbers(body.split(), data, "PLY").tobytes()
    columns, place = {}, 0
    for element in elements:
        try:
            columns[element.name], place = _ply_columns(element, body, place)
        except ValueError:
            declared = f"fewer than the declared {element.count:,} of element {shown(element.name[:40])}"
            raise MeshRefused(f"cut short or damaged: {declared}") from None
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    if not {"x", "y", "z"} <= vertex.keys():
        raise MeshRefused("not readable as PLY: vertices without x, y and z")
    if "tristrips" in columns:
        raise MeshRefused("holds strips of triangles (tristrips), which are not read: export it as polygons")
    vertices = np.stack([vertex[axis].astype(np.float64) for axis in "xyz"], axis=1)
    polygons = next((face[name] for name in PLY_CORNERS if name in face), [])
    if face and not len(polygons):
        raise MeshRefused("not readable as PLY: faces without vertex_indices")
    flat = np.concatenate([np.ravel(row) for row in polygons]) if len(polygons) else np.zeros(0)
    if (flat != np.rint(flat)).any():
        raise MeshRefused("not readable as PLY: a corner of a face is not a whole number")
    check_indices(flat, len(vertices), "PLY")
    step = decimal_step(vertices) if is_text else float32_step(vertices) if vertex["x"].dtype.itemsize == 4 else 0.0
    return TriangleSoup(vertices, polygons_as_triangles(vertices, polygons), step=step)


def _ply_header(data: bytes) -> tuple[list[_Element], bytes, bool]:
    """(elements, everything after the header, whether that is text)"""
    end = PLY_HEADER_END.search(data, 0, MAX_PLY_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise MeshRefused("not readable as PLY: no header")
    form, elements = "", []

    def code(word: str) -> str:
        """numpy's code of a type."""
        kind = PLY_TYPES[word]
        return "<f8" if form == "ascii" else PLY_ORDERS[form] + kind

    for line in re.split(r"[\r\n]+", data[: end.start()].decode("latin-1")):
        words = line.split()
        try:
            if words[:1] == ["format"]:
                form = words[1]
                if form not in ("ascii", *PLY_ORDERS):
                    raise MeshRefused(f"not readable as PLY: format {shown(form[:40])!r}")
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2]), ()))
            elif words[:1] == ["property"]:
                entry = _Property(words[-1], code(words[-2]), code(words[2]) if words[1] == "list" else None)
                last = elements[-1]
                elements[-1] = _Element(last.name, last.count, (*last.properties, entry))
        except (IndexError, KeyError, ValueError):
            raise MeshRefused(f"not readable as PLY: {shown(line[:60])!r} in its header") from None
    for element in elements:
        if not 0 <= element.count <= len(data):
            raise MeshRefused(f"cut short or damaged: {element.count:,} elements declared in {len(data):,} bytes")
    return elements, data[end.end() :], form == "ascii"


def _ply_columns(element: _Element, body: bytes, place: int) -> tuple[dict[str, Any], int]:
    """The values of each property by name, (n,), (n, k) or lists of unequal lengths, and where the element ends.

    Raises ValueError if the body ends before.
    """
    if not element.count or not element.properties:
        return {}, place
    fields: list[tuple] = []
    begin = place
    for entry in element.properties:  # lists are as long as those of the first row
        size = 1
        if entry.counter:
            size = _length(body, entry.counter, begin)
            fields.append((f"{entry.name} length", entry.counter))
            begin += np.dtype(entry.counter).itemsize
        fields.append((entry.name, entry.kind, (size,)) if entry.counter else (entry.name, entry.kind))
        begin += size * np.dtype(entry.kind).itemsize
    row = np.dtype(fields)
    end = place + element.count * row.itemsize
    lists = [entry.name for entry in element.properties if entry.counter]
    if not lists or end <= len(body):
        table = np.frombuffer(body, row, element.count, place)
        if all((table[f"{name} length"] == row[name].shape[0]).all() for name in lists):
            return {entry.name: table[entry.name] for entry in element.properties}, end
    return _ply_rows(element, body, place)


def _ply_rows(element: _Element, body: bytes, place: int) -> tuple[dict[str, Any], int]:
    """As `_ply_columns`, for lists of unequal lengths."""
    values: dict[str, list] = {entry.name: [] for entry in element.properties}
    for _ in range(element.count):
        for entry in element.properties:
            size = 1
            if entry.counter:
                size = _length(body, entry.counter, place)
                place += np.dtype(entry.counter).itemsize
            read = np.frombuffer(body, entry.kind, size, place)
            values[entry.name].append(read)
            place += read.nbytes
    return {e.name: values[e.name] if e.counter else np.concatenate(values[e.name]) for e in element.properties}, place


def _length(body: bytes, counter: str, place: int) -> int:
    """The length of a list that begins at a place. Raises ValueError if it is beyond the end of the body."""
    size = float(np.frombuffer(body, counter, 1, place)[0])
    if not 0 <= size <= len(body) or size != int(size):
        raise ValueError("a length of a list")
    return int(size)
