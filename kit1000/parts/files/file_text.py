"""The bytes of a mesh file before it is read: foreign content is refused by name, text becomes lines and numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from kit1000.errors import MeshRefused, shown
from kit1000.files import LFS_ADVICE, LFS_POINTER

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
ARCHIVES = {b"PK\x03\x04": "a zip archive", b"\x1f\x8b": "compressed by gzip", b"7z\xbc\xaf": "a 7z archive"}
ARCHIVES |= {b"Rar!": "a RAR archive", b"BZh": "compressed by bzip2", b"\xfd7zXZ": "compressed by xz"}
WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")
WIDE_LETTERS = 16  # of a text in UTF-16 every other byte is zero
DECIMAL_COMMA = re.compile(rb"[-+]?\d*,\d+([eE][-+]?\d+)?")


def check_foreign(data: bytes, is_archive: bool = False) -> None:
    """Raise MeshRefused if a file holds a Git LFS pointer, a web page or an archive instead of a mesh.

    is_archive: whether the format of the mesh is itself an archive.
    """
    start = data[:256].removeprefix(BYTE_ORDER_MARK).lstrip().lower()
    if start.startswith(LFS_POINTER):
        raise MeshRefused(LFS_ADVICE)
    if start.startswith((b"<!doctype html", b"<html")):
        raise MeshRefused("a web page instead of a mesh: download the file itself")
    packed = next((name for magic, name in ARCHIVES.items() if data.startswith(magic)), None)
    if packed and not is_archive:
        raise MeshRefused(f"{packed} instead of a mesh: unpack it first")


def check_narrow(data: bytes) -> None:
    """Raise MeshRefused for text in UTF-16 or UTF-32."""
    start = data[: 2 * WIDE_LETTERS]
    alternate = any(start[k::2] == b"\0" * WIDE_LETTERS and b"\0" not in start[1 - k :: 2] for k in (0, 1))
    if data.startswith(WIDE_MARKS) or alternate:
        raise MeshRefused("text in UTF-16 or UTF-32, expected ASCII or UTF-8: save it in UTF-8")


def plain_text(data: bytes) -> bytes:
    """Text without byte order mark, whose lines end in a line feed. Raises MeshRefused for binary data."""
    check_foreign(data)
    check_narrow(data)
    if b"\0" in data[:4096]:
        raise MeshRefused("not a mesh: binary data, expected text")
    data = data.removeprefix(BYTE_ORDER_MARK)
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def numbers(words: Sequence[bytes], text: bytes, kind: str) -> np.ndarray:
    """(n,) float64 the words of a text as numbers. Raises MeshRefused with the line of the first that is none."""
    try:
        return np.array(words, dtype="S1" if not words else "S").astype(np.float64)
    except ValueError:
        bad = next(word for word in words if not _is_number(word))
    place = re.search(rb"(?<!\S)" + re.escape(bad) + rb"(?!\S)", text)
    line = f"line {line_number(text, place.start()):,}: " if place else ""
    fault = f"not readable as {kind}: {line}{shown(bad[:40].decode('utf-8', 'replace'))!r} is no number"
    comma = DECIMAL_COMMA.fullmatch(bad) is not None
    raise MeshRefused(fault + (" (a decimal comma): export it with decimal points" if comma else ""))


def line_number(text: bytes, place: int) -> int:
    """The line of a place in a text, counted from 1."""
    return text.count(b"\n", 0, place) + 1


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
