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
NAME = re.compile(rb"^[ \t]*(?:end)?solid\b(?:(?!\bfacet\s+normal\s+[-+.\dn])[^\n])*", re.MULTILINE)  # in lower case
AFTER_SOLID = re.compile(rb"^[ \t]*end[ \t]*solid\b(.*?)(?=^[ \t]*solid\b|\Z)", re.MULTILINE | re.DOTALL)
FACET_BEGIN = re.compile(rb"facet\s+normal\b")
CORNER = rb"\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)"
LOOP = re.compile(rb"outer\s+loop" + 3 * CORNER + rb"\s+endloop\b")
FACET_END = re.compile(rb"endfacet\b")
LOOP_BEGIN = re.compile(rb"outer\s+loop\b")
CORNERS = re.compile(rb"vertex\s")
WORDS = 21  # of a facet, with the places of its keywords and coordinates among them
KEYWORDS = {0: b"facet", 1: b"normal", 5: b"outer", 6: b"loop", 19: b"endloop", 20: b"endfacet"}
KEYWORDS |= dict.fromkeys((7, 11, 15), b"vertex")
COORDINATES = (8, 9, 10, 12, 13, 14, 16, 17, 18)
PIECE = 1 << 22  # [bytes] of a regular text that are split into words at once
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
    if text and b"\0" not in text[:4096] and _is_printable(text[:4096]):
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
    text = text.lower()
    regular = _regular(text, max_faces)
    return soup_of_corners(_corners(text, max_faces) if regular is None else regular)


def _regular(text: bytes, max_faces: int) -> np.ndarray | None:
    """(3 m, 3) the corners of a text in lower case of nothing but solids; None for any other text.

    Ten times faster than a search for facets.
    """
    pieces, place, count = [], len(text) - len(text.lstrip()), 0
    while (name := NAME.match(text, place)) is not None:
        end = text.find(b"endsolid", name.end())
        if end < 0:  # the last one may have no end, but then nothing follows
            end = len(text)
        begin = name.end()
        while begin < end:
            stop = text.find(b"endfacet", begin + PIECE, end)
            stop = end if stop < 0 else stop + len(b"endfacet")
            piece = _of_words(text[begin:stop].split())
            if piece is None:
                return None
            count += len(piece) // 3
            if count > max_faces:
                raise MeshRefused(f"more than {max_faces:,} triangles")
            pieces.append(piece)
            begin = stop
        line = text.find(b"\n", end)
        place = len(text) if line < 0 else line + 1
        while text[place : place + 1].isspace():
            place += 1
    rest = text[place:]  # a comment, unless it may hold more of a solid
    return np.concatenate(pieces) if count and b"facet" not in rest and b"solid" not in rest else None


def _of_words(words: list[bytes]) -> np.ndarray | None:
    """(3 m, 3) the corners of the words of facets; None where a keyword is in another place."""
    if len(words) % WORDS or any({*words[place::WORDS]} - {word} for place, word in KEYWORDS.items()):
        return None
    columns = [np.array(words[place::WORDS], dtype="S") for place in COORDINATES] if words else []
    try:
        table = [column.astype(np.float64) for column in columns]
    except ValueError:
        return None
    return np.stack(table, axis=1).reshape(-1, 3) if table else np.zeros((0, 3))


def _corners(text: bytes, max_faces: int) -> np.ndarray:
    """(3 m, 3) the corners of the facets in a text in lower case, whatever stands between them."""
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
    if rest and b"facet".startswith(rest[0]):
        raise MeshRefused(f"cut short: ends within the facet after number {count:,}")
    return corners


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
