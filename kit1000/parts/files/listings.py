"""Finding mesh files: a file itself, all below a folder, or those of a list of paths as editors save it."""

from __future__ import annotations

import codecs
import os
from pathlib import Path

from kit1000.errors import InputError
from kit1000.parts.files.formats import MESH_SUFFIXES

MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
QUOTES = ("'", '"')


def mesh_files(path: str | Path) -> list[Path]:
    """The mesh files of a path: the file itself, all below a folder (sorted), or those of a .txt list of paths.

    Paths in a list are relative to it; blank lines and lines beginning with # are skipped; listed folders are searched.

    Raises:
        InputError: the path does not exist, or the folder or list has no mesh.
    """
    path = Path(path)
    if path.is_dir():
        found = _meshes_below(path)
    elif path.suffix.lower() == ".txt" and path.is_file():
        found = _meshes_listed(path)
    elif path.exists():
        return [path]
    else:
        raise InputError(f"{path}: does not exist; expected a mesh file, a folder or a .txt list of them")
    if not found:
        raise InputError(f"{path}: no mesh files inside; looked for {' '.join(MESH_SUFFIXES)}")
    return found


def _meshes_below(folder: Path) -> list[Path]:
    """Mesh files below a folder, sorted, without hidden files and folders."""
    files = (file for file in folder.rglob("*") if file.suffix.lower() in MESH_SUFFIXES and file.is_file())
    inner = ((file, file.relative_to(folder).parts) for file in files)
    return sorted(file for file, parts in inner if not any(part.startswith(".") for part in parts))


def _meshes_listed(listing: Path) -> list[Path]:
    found: list[Path] = []
    for line in _text(listing).replace("\r\n", "\n").replace("\r", "\n").split("\n"):
        name = line.strip()
        if not name or name.startswith("#"):
            continue
        entry = listing.parent / name
        if name[0] == name[-1] and name[0] in QUOTES and len(name) > 2 and not entry.exists():
            entry = listing.parent / name[1:-1]
        found.extend(_meshes_below(entry) if entry.is_dir() else [entry])
    return found


def _text(listing: Path) -> str:
    """The text of a list; names that are no UTF-8 are those of the file system."""
    try:
        data = listing.read_bytes()
        encoding = next((name for mark, name in MARKS.items() if data.startswith(mark)), None)
        text = os.fsdecode(data) if encoding is None else data.decode(encoding)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{listing}: cannot be read as a list of paths: {error}") from None
    if "\0" in text:
        raise InputError(
            f"{listing}: cannot be read as a list of paths: it holds binary data, or UTF-16 without a mark"
        )
    return text
