"""What a file holds instead of a mesh: a pointer of Git LFS, a web page, an archive, text in UTF-16."""

from __future__ import annotations

from kit1000.errors import MeshRefused
from kit1000.files import LFS_ADVICE, LFS_POINTER

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
ARCHIVES = {b"PK\x03\x04": "a zip archive", b"\x1f\x8b": "compressed by gzip", b"7z\xbc\xaf": "a 7z archive"}
ARCHIVES |= {b"Rar!": "a RAR archive", b"BZh": "compressed by bzip2", b"\xfd7zXZ": "compressed by xz"}
WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")
WIDE_LETTERS = 16  # of a text whose every other byte is zero


def check_foreign(data: bytes, archive: bool = False) -> None:
    """Raise MeshRefused, with what to do, for a file that holds something else than a mesh.

    archive: whether the format of the mesh is itself an archive.
    """
    start = data[:256].removeprefix(BYTE_ORDER_MARK).lstrip().lower()
    if start.startswith(LFS_POINTER):
        raise MeshRefused(LFS_ADVICE)
    if start.startswith((b"<!doctype html", b"<html")):
        raise MeshRefused("a web page instead of a mesh: download the file itself")
    packed = next((name for magic, name in ARCHIVES.items() if data.startswith(magic)), None)
    if packed and not archive:
        raise MeshRefused(f"{packed} instead of a mesh: unpack it first")


def check_narrow(data: bytes) -> None:
    """Raise MeshRefused for text of two or four bytes a letter."""
    start = data[: 2 * WIDE_LETTERS]
    alternate = any(start[k::2] == b"\0" * WIDE_LETTERS and b"\0" not in start[1 - k :: 2] for k in (0, 1))
    if data.startswith(WIDE_MARKS) or alternate:
        raise MeshRefused("text in UTF-16 or UTF-32, expected ASCII or UTF-8: save it in UTF-8")


def plain_text(data: bytes) -> bytes:
    """Text as lines that end in a line feed, without byte order mark. Raises MeshRefused for binary data."""
    check_narrow(data)
    if b"\0" in data[:4096]:
        raise MeshRefused("not a mesh: binary data, expected text")
    data = data.removeprefix(BYTE_ORDER_MARK)
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def line_number(text: bytes, place: int) -> int:
    """The line of a place in a text, counted from 1."""
    return text.count(b"\n", 0, place) + 1
