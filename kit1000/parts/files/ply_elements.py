"""Reading PLY files: ASCII and binary, faces of any number of corners."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.parts.files.foreign_content import BYTE_ORDER_MARK, check_narrow
from kit1000.parts.files.polygons import triangles_of
from kit1000.parts.files.soup import TriangleSoup, check_indices

TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
TYPES |= {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"}
TYPES |= {"float": "f4", "double": "f8", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
HEADER_END = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r)", re.MULTILINE)
CORNER_LISTS = ("vertex_indices", "vertex_index")
MAX_HEADER = 1 << 20  # [bytes]


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    """numpy's code of the value, or of each value of a list."""
    counter: str | None
    """numpy's code of the length of a list; None for a single value."""


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


def read_ply(data: bytes) -> TriangleSoup:
    """The faces of a PLY file; colours, normals and all other properties are ignored."""
    form, elements, body = _header(data)
    columns = _text_columns(elements, body) if form == "ascii" else _binary_columns(elements, body, ORDERS[form])
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    if not {"x", "y", "z"} <= vertex.keys():
        raise MeshRefused("not readable as PLY: vertices without x, y and z")
    names = [*CORNER_LISTS, *(name for name, values in face.items() if not _is_column(values))]
    corners = next((face[name] for name in names if name in face), None)
    if corners is None:
        if "tristrips" in columns:
            raise MeshRefused("holds strips of triangles (tristrips), which are not supported: export it as polygons")
        corners = np.zeros((0, 3), dtype=np.int64)
    vertices = np.stack([np.asarray(vertex[axis], dtype=np.float64) for axis in "xyz"], axis=1)
    flat = corners.reshape(-1) if isinstance(corners, np.ndarray) else [i for row in corners for i in row]
    check_indices(np.asarray(flat, dtype=np.int64), len(vertices), "damaged")
    return TriangleSoup(vertices, triangles_of(vertices, corners))


def _is_column(values: Any) -> bool:
    return isinstance(values, np.ndarray) and values.ndim == 1


def _header(data: bytes) -> tuple[str, list[_Element], bytes]:
    """(format, elements, everything after the header)"""
    check_narrow(data)
    data = data.removeprefix(BYTE_ORDER_MARK)
    end = HEADER_END.search(data.replace(b"\r", b"\n") if b"\n" not in data[:100] else data, 0, MAX_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise MeshRefused("not readable as PLY: no header")
    form, elements = "", []
    for line in re.split(r"[\r\n]+", data[: end.start()].decode("latin-1")):
        words = line.split()
        try:
            if words[:1] == ["format"]:
                form = words[1]
            elif words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2]), ()))
            elif words[:1] == ["property"]:
                last = elements[-1]
                elements[-1] = _Element(last.name, last.count, (*last.properties, _property(words)))
        except (IndexError, KeyError, ValueError):
            raise MeshRefused(f"not readable as PLY: {line[:60]!r} in its header") from None
    if form not in ("ascii", *ORDERS):
        raise MeshRefused(f"not readable as PLY: format {form[:40]!r}")
    for element in elements:
        if element.count > len(data):
            raise MeshRefused(f"cut short or damaged: {element.count:,} elements declared in {len(data):,} bytes")
    return form, elements, data[end.end() :]


def _property(words: list[str]) -> _Property:
    if words[1] == "list":
        return _Property(words[4], TYPES[words[3]], TYPES[words[2]])
    return _Property(words[2], TYPES[words[1]], None)


def _cut_short(element: _Element) -> MeshRefused:
    return MeshRefused(
        f"cut short or damaged: fewer than the declared {element.count:,} of element {element.name[:40]}"
    )


def _text_columns(elements: list[_Element], body: bytes) -> dict[str, dict[str, Any]]:
    """The values of each property by element and name: (n,), (n, k), or lists of unequal lengths."""
    words, place, columns = body.split(), 0, {}
    for element in elements:
        try:
            values, place = _text_rows(element, words, place)
        except (ValueError, OverflowError):
            raise MeshRefused(f"not readable as PLY: no number in element {element.name[:40]}") from None
        except IndexError:
            raise _cut_short(element) from None
        columns[element.name] = values
    return columns


def _text_rows(element: _Element, words: list[bytes], place: int) -> tuple[dict[str, Any], int]:
    singles = [entry.name for entry in element.properties if entry.counter is None]
    if len(singles) == len(element.properties):
        end = place + element.count * len(singles)
        if end > len(words):
            raise IndexError
        table = np.array(words[place:end], dtype="S").astype(np.float64).reshape(element.count, len(singles))
        return dict(zip(singles, table.T, strict=True)), end
    values: dict[str, list] = {entry.name: [] for entry in element.properties}
    for _ in range(element.count):
        for entry in element.properties:
            size = 1 if entry.counter is None else int(words[place])
            begin = place + (entry.counter is not None)
            row = words[begin : begin + size]
            if size < 0 or len(row) < size:
                raise IndexError
            numbers = [int(word) if entry.kind[0] in "iu" else float(word) for word in row]
            values[entry.name].append(numbers[0] if entry.counter is None else numbers)
            place = begin + size
    return {
        entry.name: np.array(values[entry.name]) if entry.counter is None else values[entry.name]
        for entry in element.properties
    }, place


def _binary_columns(elements: list[_Element], body: bytes, order: str) -> dict[str, dict[str, Any]]:
    """As `_text_columns`."""
    place, columns = 0, {}
    for element in elements:
        sizes = _first_sizes(element, body, place, order)
        row = np.dtype(
            [
                field
                for k, (entry, size) in enumerate(zip(element.properties, sizes, strict=True))
                for field in _fields(k, entry, size, order)
            ]
        )
        end = place + element.count * row.itemsize
        table = np.frombuffer(body, row, element.count, place) if end <= len(body) else None
        if table is not None and _all_alike(element, table, sizes):
            columns[element.name] = {entry.name: table[f"v{k}"] for k, entry in enumerate(element.properties)}
            place = end
        elif all(entry.counter is None for entry in element.properties):
            raise _cut_short(element)
        else:
            columns[element.name], place = _binary_rows(element, body, place, order)
    return columns


def _fields(k: int, entry: _Property, size: int, order: str) -> list[tuple]:
    """The numpy fields of a property whose list has `size` values."""
    if entry.counter is None:
        return [(f"v{k}", order + entry.kind)]
    return [(f"n{k}", order + entry.counter), (f"v{k}", order + entry.kind, (size,))]


def _first_sizes(element: _Element, body: bytes, place: int, order: str) -> list[int]:
    """The lengths of the lists in the first row; 1 for single values."""
    sizes = []
    for entry in element.properties:
        if entry.counter is None or element.count == 0:
            sizes.append(1)
        else:
            sizes.append(_number(body, place, order + entry.counter, element))
            place += np.dtype(entry.counter).itemsize
        place += sizes[-1] * np.dtype(entry.kind).itemsize
    return sizes


def _number(body: bytes, place: int, kind: str, element: _Element) -> int:
    """A length in the body."""
    size = np.dtype(kind).itemsize
    value = int(np.frombuffer(body[place : place + size], kind)[0]) if place + size <= len(body) else -1
    if not 0 <= value <= len(body):
        raise _cut_short(element)
    return value


def _all_alike(element: _Element, table: np.ndarray, sizes: list[int]) -> bool:
    lists = [(k, size) for k, (entry, size) in enumerate(zip(element.properties, sizes, strict=True)) if entry.counter]
    return all((table[f"n{k}"] == size).all() for k, size in lists)


def _binary_rows(element: _Element, body: bytes, place: int, order: str) -> tuple[dict[str, Any], int]:
    """The values of rows whose lists have unequal lengths, and where they end."""
    values: dict[str, list] = {entry.name: [] for entry in element.properties}
    for _ in range(element.count):
        for entry in element.properties:
            size = 1
            if entry.counter is not None:
                size = _number(body, place, order + entry.counter, element)
                place += np.dtype(entry.counter).itemsize
            end = place + size * np.dtype(entry.kind).itemsize
            if end > len(body):
                raise _cut_short(element)
            numbers = np.frombuffer(body, order + entry.kind, size, place).tolist()
            values[entry.name].append(numbers[0] if entry.counter is None else numbers)
            place = end
    return values, place
