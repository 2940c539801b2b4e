"""Reading STL files, binary or text, in the dialects that occur.

Text: keywords in any case, any line ends, a byte order mark, headers and comments of any length, several solids.
The number of triangles that a binary file declares is compared with its size.
"""

from __future__ import annotations

import re
from itertools import islice

import numpy as np

from kit1000.errors import MeshRefused
from kit1000.parts.files.foreign_content import check_foreign, check_narrow, line_number, plain_text
from kit1000.parts.files.soup import TriangleSoup, soup_of_corners

HEADER = 84  # [bytes] 80 of comment, 4 of count
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
NAME = re.compile(rb"^[ \t]*(?:end)?solid\b(?:(?!\bfacet\s+normal\s+[-+.\dn])[^\n])*", re.MULTILINE | re.IGNORECASE)
FACET_BEGIN = re.compile(rb"\bfacet\s+normal\b", re.IGNORECASE)
CORNER = rb"\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)"
LOOP = re.compile(rb"\bouter\s+loop" + 3 * CORNER + rb"\s+endloop\b", re.IGNORECASE)
FACET_END = re.compile(rb"\bendfacet\b", re.IGNORECASE)
AFTER_SOLID = re.compile(
    rb"^[ \t]*end[ \t]*solid\b(.*?)(?=^[ \t]*solid\b|\Z)", re.MULTILINE | re.IGNORECASE | re.DOTALL
)
LOOP_BEGIN = re.compile(rb"\bouter\s+loop\b", re.IGNORECASE)
CORNERS = re.compile(rb"\bvertex\s", re.IGNORECASE)
BLOCK = 100_000  # triangles of a text that are converted at once


def read_stl(data: bytes, max_faces: int) -> TriangleSoup:
    """The triangles of an STL file, at most `max_faces`. Raises MeshRefused with one line when it has none."""
    declared = int.from_bytes(data[80:HEADER], "little") if len(data) >= HEADER else 0
    expected = HEADER + FACET.itemsize * declared
    if len(data) >= HEADER and len(data) == expected:
        return _binary(data, declared, max_faces)
    check_foreign(data)
    check_narrow(data)
    text = data.rstrip(b"\0")  # with which some programs fill up a block of the disk
    if b"\0" not in text[:4096] and _is_printable(text[:4096]):
        return _text(plain_text(text), max_faces)
    if len(data) < HEADER:
        raise MeshRefused(f"not a mesh: {len(data)} bytes, a binary STL has at least {HEADER}")
    held = (len(data) - HEADER) // FACET.itemsize
    if len(data) < expected:
        raise MeshRefused(f"cut short or not an STL: {declared:,} triangles declared, room for {held:,}")
    if (len(data) - expected) % FACET.itemsize == 0:  # as programs leave it that never go back to write the count
        raise MeshRefused(f"its header declares {declared:,} triangles, but {held:,} follow: export it again")
    return _binary(data, declared, max_faces, (f"ignored {len(data) - expected:,} bytes after the last triangle",))


def _binary(data: bytes, count: int, max_faces: int, notes: tuple[str, ...] = ()) -> TriangleSoup:
    if count > max_faces:
        raise MeshRefused(f"{count:,} triangles, more than {max_faces:,}")
    facets = np.frombuffer(data, FACET, count, HEADER)
    with np.errstate(invalid="ignore"):  # a signalling NaN; corners that are no numbers are refused later
        corners = facets["corners"].reshape(-1, 3).astype(np.float64)
    return soup_of_corners(corners, notes)


def _text(text: bytes, max_faces: int) -> TriangleSoup:
    if not FACET_BEGIN.search(text):
        raise MeshRefused("holds no triangles" if NAME.match(text.lstrip()) else "not a mesh: text file")
    body = NAME.sub(b"", AFTER_SOLID.sub(_without_comment, text))  # names and comments may hold any word
    count = sum(1 for _ in FACET_BEGIN.finditer(body))
    if count > max_faces:
        raise MeshRefused(f"{count:,} triangles, more than {max_faces:,}")
    loops = (match.groups() for match in LOOP.finditer(body))
    blocks = []
    while block := list(islice(loops, BLOCK)):
        blocks.append(_numbers(block))
    corners = np.concatenate([np.zeros((0, 3)), *blocks])
    if len(corners) != 3 * count:
        raise MeshRefused(_broken_facet(body))
    rest = FACET_END.split(body)[-1].split()
    if rest and b"facet".startswith(rest[0].lower()):
        raise MeshRefused(f"cut short: ends within the facet after number {count:,}")
    return soup_of_corners(corners)


def _without_comment(match: re.Match[bytes]) -> bytes:
    """Blank lines for all from the end of a solid to the next one, unless there are facets."""
    return match[0] if LOOP.search(match[1]) else b"\n" * match[0].count(b"\n")


def _numbers(loops: list[tuple[bytes, ...]]) -> np.ndarray:
    try:
        return np.array(loops, dtype="S").astype(np.float64).reshape(-1, 3)
    except ValueError:
        raise MeshRefused("not readable as STL: a coordinate is not a number") from None


def _broken_facet(body: bytes) -> str:
    """What is wrong with the first facet that has no loop of three corners."""
    begins = [match.start() for match in FACET_BEGIN.finditer(body)]
    for begin, end in zip(begins, [*begins[1:], len(body)], strict=True):
        facet = body[begin:end]
        loops, corners = len(LOOP_BEGIN.findall(facet)), len(CORNERS.findall(facet))
        if len(LOOP.findall(facet)) == 1 and loops == 1:
            continue
        place = f"the facet in line {line_number(body, begin):,}"
        if end == len(body) and corners < 3:
            return f"cut short: {place} has {corners} corners"
        return f"not readable as STL: {place} has {loops} loops and {corners} corners, expected 1 loop of 3"
    return "not readable as STL: loops outside of facets"


def _is_printable(data: bytes) -> bool:
    return all(byte >= 32 or byte in b"\t\n\r\f\v\x1a" for byte in data)
