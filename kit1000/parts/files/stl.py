"""Reading STL files, binary or text.

Text may have keywords in any case, any line ends, a byte order mark, comments, and several solids. The number of
triangles that a binary file declares is compared with its size before memory is allocated.
"""

from __future__ import annotations

import re

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.parts.files.file_text import check_foreign, check_narrow, line_number, numbers, plain_text
from kit1000.parts.files.triangles import TriangleSoup, decimal_step, float32_step

HEADER = 84  # [bytes] 80 of comment, 4 of count
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
# A name or comment ends at the line's end, or at the first facet if all is on one line.
NAME = re.compile(rb"(?:^[ \t]*solid\b|\bend[ \t]*solid|[#;])(?:(?!\bfacet\s+normal\s+[-+.\dn])[^\n])*", re.MULTILINE)
WORD = rb"\s+(\S+)"
FACET_TEXT = re.compile(
    rb"\s*facet\s+normal(?:\s+\S+){3}\s+outer\s+loop" + 3 * (rb"\s+vertex" + 3 * WORD) + rb"\s+endloop\s+endfacet"
)
PIECE = 100_000  # facets of text whose words are turned into numbers at once


def read_stl(data: bytes, max_faces: int) -> TriangleSoup:
    """The triangles of an STL file, at most `max_faces`. Raises MeshRefused with one line if there are none."""
    declared = int.from_bytes(data[80:HEADER], "little") if len(data) >= HEADER else 0
    if len(data) >= HEADER and len(data) == HEADER + FACET.itemsize * declared:
        return _binary(data, declared, max_faces)
    check_foreign(data)
    check_narrow(data)
    text = data.rstrip(b"\0\x1a")  # some programs fill up a block of the disk
    if text and all(byte >= 32 or byte in b"\t\n\r\f\v" for byte in text[:4096]):
        return _text(plain_text(text), max_faces)
    raise MeshRefused(_binary_fault(data, declared))


def _binary_fault(data: bytes, declared: int) -> str:
    """What is wrong with a binary file whose size is not that of its declared triangles."""
    if len(data) < HEADER:
        return f"not a mesh: {len(data)} bytes, a binary STL has at least {HEADER}"
    held, rest = divmod(len(data) - HEADER, FACET.itemsize)
    if held < declared:
        return f"cut short or not an STL: {declared:,} triangles declared, room for {held:,}"
    if (np.frombuffer(data, FACET, declared, HEADER)["attribute"] != 0).any():
        return "holds attribute bytes besides its triangles: export it without colours or attributes"
    if rest == 0:  # some programs never go back to write the count
        return f"its header declares {declared:,} triangles, but {held:,} follow: export it again"
    surplus = len(data) - HEADER - FACET.itemsize * declared
    return f"holds {surplus:,} bytes after the last triangle: export it without colours or attributes"


def _binary(data: bytes, count: int, max_faces: int) -> TriangleSoup:
    _check_count(count, max_faces)
    facets = np.frombuffer(data, FACET, count, HEADER)
    with np.errstate(invalid="ignore"):  # a signalling NaN; corners that are no numbers are refused later
        corners = facets["corners"].reshape(-1, 3).astype(np.float64)
    return _soup(corners, float32_step(corners))


def _text(text: bytes, max_faces: int) -> TriangleSoup:
    """The facets of a text: it may hold nothing but facets, names of solids, and comments."""
    text = text.lower()
    body = NAME.sub(b"", text)
    if b"facet" not in body:
        raise MeshRefused("holds no triangles" if re.match(rb"\s*solid\b", text) else "not a mesh: text file")
    _check_count(body.count(b"endfacet"), max_faces)
    pieces, words, place = [], [], 0
    while facet := FACET_TEXT.match(body, place):
        words += facet.groups()
        place = facet.end()
        if len(words) >= 9 * PIECE:
            pieces.append(numbers(words, text, "STL"))
            words = []
    rest = body[place:].lstrip()
    if rest:
        line, end = line_number(body, len(body) - len(rest)), rest.find(b"endfacet")
        if end < 0:
            raise MeshRefused(f"cut short: the facet in line {line:,} has no end")
        raise MeshRefused(f"not readable as STL: the facet in line {line:,} is no normal and one loop of 3 corners")
    corners = np.concatenate([*pieces, numbers(words, text, "STL")]).reshape(-1, 3)
    return _soup(corners, decimal_step(corners))


def _check_count(count: int, max_faces: int) -> None:
    if count > max_faces:
        raise MeshRefused(f"{count:,} triangles, more than {max_faces:,}")


def _soup(corners: np.ndarray, step: float) -> TriangleSoup:
    """The soup of corners (3 m, 3), three for each triangle."""
    return TriangleSoup(corners, np.arange(len(corners)).reshape(-1, 3), step=step)
