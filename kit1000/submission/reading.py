"""Reading a file of a submission: every reason why it cannot be opened or decoded is a fault, not an exception.

The files come from strangers: links that lead out of their folder, pipes, devices and files without end are not read.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from kit1000.files import LFS_ADVICE, LFS_POINTER
from kit1000.submission.faults import Fault, file_error, printable

LARGEST_FILE = 1 << 28  # bytes; a million predictions are 150 MB


def read_text(path: Path, file: str, inside: Path | None = None) -> str | Fault:
    """The UTF-8 text of a file with `\\n` line ends, without byte order mark; or why there is none.

    Args:
        path: of the file.
        file: its name in messages.
        inside: the folder that a link must not lead out of; any link is followed if absent.
    """
    data = read_file(path, file, inside)
    if isinstance(data, Fault):
        return data
    if data.startswith(LFS_POINTER):
        return file_error(file, "git-lfs", "is " + LFS_ADVICE.partition(":")[0], "text", "run git lfs pull")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        actual = f"is not UTF-8 text (byte 0x{data[error.start]:02X})"
        return Fault(file, line, "not-utf-8", actual, "UTF-8 text", "unpack the file, or save it as UTF-8")
    if not text.strip():
        return file_error(file, "empty", "is empty", "text", "write the file again")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_file(path: Path, file: str, inside: Path | None = None) -> bytes | Fault:
    """The bytes of a regular file, or why it is not read; for the arguments see `read_text`.

    If `inside` is given, nothing outside of it is opened.
    """
    try:
        target = path
        if inside is not None:
            target, folder = _resolved(path), _resolved(inside)
            if not target.is_relative_to(folder):
                actual, expected = "is a symbolic link that leads out of the folder", "a file in the folder"
                return file_error(file, "foreign-link", actual, expected, "replace the link with the file")
        return _kind_fault(os.stat(target), file) or _read_regular(target, file, follow=inside is None)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        return _open_fault(path, file, error)


def _resolved(path: Path) -> Path:
    """The path without links."""
    try:
        return path.resolve()
    except RuntimeError as error:  # Python before 3.13 reports a loop so
        raise OSError(errno.ELOOP, "a loop of links") from error


def _read_regular(path: Path, file: str, follow: bool) -> bytes | Fault:
    """The bytes of a file. Its kind is checked again once it is open; a pipe is not waited for."""
    opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW))
    try:
        fault = _kind_fault(os.fstat(opened), file)
        if fault is not None:
            return fault
        with open(opened, "rb", closefd=False) as stream:
            return stream.read(LARGEST_FILE + 1)
    finally:
        os.close(opened)


def _kind_fault(status: os.stat_result, file: str) -> Fault | None:
    """Why a file that exists is not read."""
    if stat.S_ISDIR(status.st_mode):
        return file_error(file, "folder", "is a folder", "a file", "replace the folder with the file")
    if not stat.S_ISREG(status.st_mode):
        repair = "copy its content into a file"
        return file_error(file, "not-a-file", "is not a regular file", "a regular file", repair)
    if status.st_size > LARGEST_FILE:
        size, most = status.st_size >> 20, LARGEST_FILE >> 20
        repair = "write one row per query of the dataset and nothing else"
        return file_error(file, "file-too-large", f"has {size} MiB", f"at most {most} MiB", repair)
    return None


def _open_fault(path: Path, file: str, error: OSError | ValueError) -> Fault:
    """Why a file could not be opened."""
    code = error.errno if isinstance(error, OSError) else None
    if code in (errno.ENOENT, errno.ENOTDIR):
        what = "is a symbolic link to a missing file" if path.is_symlink() else "does not exist"
        repair = "correct the path, or write the file with kit1000.write_submission"
        return file_error(file, "missing-file", what, f"a file {printable(path.name)}", repair)
    reason = " ".join(str(error.strerror if isinstance(error, OSError) else error).split())
    actual = f"cannot be read ({printable(reason)})"
    return file_error(file, "unreadable", actual, "a readable file", "check its permissions and links")
