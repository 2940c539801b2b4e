"""Reading OBJ and OFF files: faces of any number of corners, their indices counted from either end."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.parts.files.foreign_content import line_number, plain_text
from kit1000.parts.files.polygons import triangles_of
from kit1000.parts.files.soup import TriangleSoup, check_indices

OBJ_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)
OBJ_SHORT = re.compile(rb"^[ \t]*v[ \t]+(?!\S+[ \t]+\S+[ \t]+\S)[^\n]*", re.MULTILINE)
OBJ_FACE = re.compile(rb"^[ \t]*fo?[ \t]+([^\n#]*)", re.MULTILINE)
OBJ_CURVED = re.compile(rb"^[ \t]*(surf|bmat|cstype)\b", re.MULTILINE)
REST = re.compile(rb"/[^\s]*")  # of a corner: its texture and its normal
MOST_COLOUR_WORDS = 4  # after the corners of a face
COMMENT = re.compile(rb"#[^\n]*")
OFF_HEADER = re.compile(rb"\s*(?:ST)?C?N?(4?n?)OFF\b[ \t]*(BINARY)?|\s*(?:ST)?C?N?OFF(?=\d)", re.IGNORECASE)


def read_obj(data: bytes) -> TriangleSoup:
    """The faces of an OBJ file; lines, points, textures and normals are ignored."""
    text = plain_text(data).replace(b"\\\n", b" ")
    if OBJ_CURVED.search(text):
        raise MeshRefused("holds curved surfaces (cstype, surf), which are not supported: export it as polygons")
    found = list(OBJ_VERTEX.finditer(text))
    vertices = _numbers([match.groups() for match in found], "OBJ")
    if short := OBJ_SHORT.search(text):
        raise MeshRefused(f"not readable as OBJ: line {line_number(text, short.start())} has fewer than 3 coordinates")
    places = np.array([match.start() for match in found], dtype=np.int64)
    rows, starts = [], []
    for match in OBJ_FACE.finditer(text):
        rows.append(REST.sub(b"", match[1]).split())
        starts.append(match.start())
    polygons = _whole(rows, "OBJ")
    before = np.searchsorted(places, starts)  # vertices above each face, for those counted from the back
    if isinstance(polygons, np.ndarray):
        polygons = np.where(polygons < 0, polygons + before[:, None], polygons - 1)
    else:
        polygons = [
            [i + above if i < 0 else i - 1 for i in row] for row, above in zip(polygons, before.tolist(), strict=True)
        ]
    return _soup(vertices, polygons, "OBJ")


def read_off(data: bytes) -> TriangleSoup:
    """The faces of an OFF file; colours, normals and textures are ignored."""
    text = COMMENT.sub(b"", plain_text(data))
    header = OFF_HEADER.match(text)
    if header and (header[1] or header[2]):
        raise MeshRefused("not readable as OFF: binary or not of three dimensions; save it as plain OFF")
    lines = [words for line in text[header.end() if header else 0 :].split(b"\n") if (words := line.split())]
    counts = _whole([lines[0][:2]], "OFF") if lines and len(lines[0]) >= 2 else []
    if not len(counts):
        raise MeshRefused("not readable as OFF: no numbers of vertices and faces")
    n, m = (int(count) for count in counts[0])
    try:
        vertices, faces = _off_by_lines(lines[1:], n, m)
    except MeshRefused as refused:
        wrapped = _off_by_words(lines[1:], n, m, _vertex_width(header[0] if header else b""))
        if wrapped is None:
            raise refused from None
        vertices, faces = wrapped
    return _soup(vertices, faces, "OFF")


def _off_by_lines(lines: list[list[bytes]], n: int, m: int) -> tuple[np.ndarray, np.ndarray | list[list[int]]]:
    """Vertices and faces where each has a line of its own; what else is on it, such as a colour, is ignored."""
    if min(n, m) < 0 or n + m > len(lines):
        raise MeshRefused(f"not readable as OFF: {n:,} vertices and {m:,} faces in {len(lines):,} lines")
    if any(len(words) < 3 for words in lines[:n]):
        raise MeshRefused("not readable as OFF: a vertex of fewer than 3 coordinates")
    vertices = _numbers([tuple(words[:3]) for words in lines[:n]], "OFF")
    sizes = [int(row[0]) for row in _whole([words[:1] for words in lines[n : n + m]], "OFF")]
    rows = [words[1 : size + 1] for words, size in zip(lines[n : n + m], sizes, strict=True)]
    if any(len(row) < size for row, size in zip(rows, sizes, strict=True)):
        raise MeshRefused("not readable as OFF: a face with fewer corners than it says")
    return vertices, _whole(rows, "OFF")


def _off_by_words(
    lines: list[list[bytes]], n: int, m: int, width: int
) -> tuple[np.ndarray, np.ndarray | list[list[int]]] | None:
    """Vertices of `width` numbers and faces that go on over lines, as Geomview reads them; None where they do not fit.

    A colour of a face ends with the line on which it stands.
    """
    words = [word for line in lines for word in line]
    ends = np.repeat(np.cumsum([len(line) for line in lines]), [len(line) for line in lines]).tolist()
    if min(n, m) < 0 or n * width + m > len(words):
        return None
    try:
        vertices = _numbers([tuple(words[k * width : k * width + 3]) for k in range(n)], "OFF")
        rows, place = [], n * width
        for _ in range(m):
            last = place + int(words[place])
            if not place < last < len(words) or ends[last] - last > MOST_COLOUR_WORDS + 1:
                return None
            rows.append(words[place + 1 : last + 1])
            place = ends[last]
        return vertices, _whole(rows, "OFF")
    except (ValueError, IndexError, MeshRefused):
        return None


def _vertex_width(header: bytes) -> int:
    """How many numbers a vertex has by the word before `OFF`: with colour, normal and texture beside its place."""
    word = header.strip().upper().partition(b"OFF")[0]
    return 3 + 2 * word.startswith(b"ST") + 4 * (b"C" in word) + 3 * (b"N" in word)


def _soup(vertices: np.ndarray, polygons: np.ndarray | Sequence[Sequence[int]], kind: str) -> TriangleSoup:
    flat = polygons.reshape(-1) if isinstance(polygons, np.ndarray) else [i for row in polygons for i in row]
    check_indices(np.asarray(flat, dtype=np.int64), len(vertices), f"not readable as {kind}")
    return TriangleSoup(vertices, triangles_of(vertices, polygons))


def _numbers(rows: list[tuple[bytes, ...]], kind: str) -> np.ndarray:
    """(n, 3) float64"""
    try:
        return np.array(rows, dtype="S").astype(np.float64).reshape(-1, 3)
    except ValueError:
        raise MeshRefused(f"not readable as {kind}: a coordinate is not a number") from None


def _whole(rows: list[list[bytes]], kind: str) -> np.ndarray | list[list[int]]:
    """Rows of whole numbers: an array where all have the same length."""
    sizes = {len(row) for row in rows}
    try:
        if len(sizes) == 1:
            return np.array(rows, dtype="S").astype(np.int64)
        return [[int(word) for word in row] for row in rows]
    except (ValueError, OverflowError):
        raise MeshRefused(f"not readable as {kind}: a corner of a face is not a whole number") from None
