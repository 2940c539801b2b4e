"""Reading a file of a submission as text, with a fault for every reason why it cannot be opened or decoded."""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path

from kit1000.files import LFS_POINTER
from kit1000.submission.faults import Fault, printable

LARGEST_FILE = 1 << 28  # bytes; a million predictions are 150 MB
SAMPLE_SIZE = 4096  # bytes that are tested to tell text from binary data
BINARY_SHARE = 0.1  # share of unprintable bytes among them above which a file is binary
UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]"
)  # control characters, and bytes that are not UTF-8

FILE_SIGNATURES = (
    (b"\x1f\x8b", "a gzip file", "unpack it with gunzip"),
    (b"PK\x03\x04", "a zip file or a spreadsheet", "unpack it, or save the spreadsheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "a spreadsheet", "save the spreadsheet as CSV"),
    (b"BZh", "a bzip2 file", "unpack it with bunzip2"),
    (b"\xfd7zXZ", "an xz file", "unpack it with unxz"),
    (b"\x28\xb5\x2f\xfd", "a zstd file", "unpack it with unzstd"),
    (b"\x93NUMPY", "a numpy file", "write the rows with kit1000.write_submission"),
    (b"\x89HDF", "an HDF5 file", "write the rows with kit1000.write_submission"),
    (b"PAR1", "a parquet file", "write the rows with kit1000.write_submission"),
    (b"\x80\x04\x95", "a pickle", "write the rows with kit1000.write_submission"),
    (b"\x80\x05\x95", "a pickle", "write the rows with kit1000.write_submission"),
    (b"%PDF", "a PDF", "write plain text"),
    (LFS_POINTER, "a git-lfs pointer, not the file itself", "fetch the file with git lfs pull"),
)
BYTE_ORDER_MARKS = (
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


def file_error(file: str, code: str, actual: str, expected: str, repair: str) -> Fault:
    """An error that concerns a whole file."""
    return Fault(file, None, None, actual, expected, repair, "error", code)


def file_warning(file: str, code: str, actual: str, expected: str, repair: str) -> Fault:
    """A warning that concerns a whole file."""
    return Fault(file, None, None, actual, expected, repair, "warning", code)


def read_file(path: Path, file: str, inside: Path | None = None) -> tuple[bytes | None, list[Fault]]:
    """The bytes of a regular file, or None and the reason.

    Args:
        path: of the file.
        file: its name in messages.
        inside: the folder that a link must not lead out of; then nothing outside is opened, nor looked for.
    """
    try:
        target = path
        if inside is not None:
            target, folder = _resolved(path), _resolved(inside)
            if not target.is_relative_to(folder):
                actual, expected = "is a symbolic link that leads out of the folder", "a file in the folder"
                return None, [file_error(file, "foreign-link", actual, expected, "replace the link with the file")]
        fault = _kind_fault(os.stat(target), file)
        return (None, [fault]) if fault else _read_regular(target, file, follow=inside is None)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        return None, [_open_fault(path, file, error)]


def _resolved(path: Path) -> Path:
    """The path without links."""
    try:
        return path.resolve()
    except RuntimeError as error:  # as Python before 3.13 reports a loop
        raise OSError(errno.ELOOP, "a loop of links") from error


def _read_regular(path: Path, file: str, follow: bool) -> tuple[bytes | None, list[Fault]]:
    """The bytes of a file, which is looked at again once it is open; without waiting for the other end of a pipe."""
    opened = os.open(path, os.O_RDONLY | os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW))
    try:
        fault = _kind_fault(os.fstat(opened), file)
        if fault:
            return None, [fault]
        with open(opened, "rb", closefd=False) as stream:
            return stream.read(LARGEST_FILE + 1), []
    finally:
        os.close(opened)


def _kind_fault(status: os.stat_result, file: str) -> Fault | None:
    """Why a file is not read although it is there."""
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
        if path.is_symlink():
            repair = "replace the link with the file"
            return file_error(file, "broken-link", "is a symbolic link to a missing file", "a file", repair)
        similar = _similar_name(path)
        repair = f"rename {similar}" if similar else "correct the path, or write the file with kit1000.write_submission"
        return file_error(file, "missing-file", "does not exist", f"a file {printable(path.name)}", repair)
    if code == errno.ELOOP:
        repair = "replace the link with the file"
        return file_error(file, "link-loop", "is a symbolic link to itself", "a file", repair)
    if code in (errno.EACCES, errno.EPERM):
        repair = "change its permissions with chmod"
        return file_error(file, "no-permission", "may not be read", "a file with read permission", repair)
    reason = " ".join(str(error.strerror if isinstance(error, OSError) else error).split())
    actual = f"cannot be read ({printable(reason)})"
    return file_error(file, "unreadable", actual, "a readable file", "write or copy the file again")


def _similar_name(path: Path) -> str | None:
    """Another name in the folder that was probably intended."""
    try:
        names = sorted(os.listdir(path.parent))
    except (OSError, ValueError):
        return None
    same = [name for name in names if name.casefold() == path.name.casefold()]
    others = [name for name in names if name.casefold().endswith(path.suffix)] if path.suffix else []
    similar = same or (others if len(others) == 1 else [])
    return printable(similar[0]) if similar else None


def decode_text(data: bytes, file: str) -> tuple[str | None, list[Fault]]:
    """Bytes as text with `\\n` line endings; None for binary data. Bytes that are not UTF-8 become lone surrogates."""
    if not data.strip(b" \t\r\n\x00") and not data.strip():
        return None, [file_error(file, "empty", "is empty", "text", "write the file again")]
    for signature, kind, repair in FILE_SIGNATURES:
        if data.startswith(signature):
            return None, [file_error(file, "binary", f"is {kind}", "plain text", repair)]
    text, faults = _decode(data, file)
    if text is None:
        return None, faults
    if "\r" in text:
        actual = "has line endings of Windows or an old Mac"
        faults.append(file_warning(file, "line-endings", actual, "Unix line endings", "no change needed: it is read"))
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text, faults


def _decode(data: bytes, file: str) -> tuple[str | None, list[Fault]]:
    wide = _wide_encoding(data)
    if wide:
        repair = f"convert it: iconv -f {wide.upper()} -t UTF-8"
        fault = file_error(file, "not-utf-8", f"is {wide[:6].upper()} text", "UTF-8 text", repair)
        return data.decode(wide, "replace").removeprefix("\ufeff"), [fault]
    faults = []
    if data.startswith(b"\xef\xbb\xbf"):
        repair = "no change needed: it is read"
        faults.append(file_warning(file, "byte-order-mark", "begins with a byte order mark", "plain UTF-8", repair))
        data = data[3:]
    sample = data[:SAMPLE_SIZE].decode("utf-8", "surrogateescape")
    if len(UNPRINTABLE.findall(sample)) > BINARY_SHARE * len(sample) + 1:
        fault = file_error(file, "binary", "contains binary data", "plain text", "write the file again")
        return None, [*faults, fault]
    return data.decode("utf-8", "surrogateescape"), faults


def _wide_encoding(data: bytes) -> str | None:
    """UTF-16 or UTF-32, by its byte order mark or because every other byte is 0; None for other encodings."""
    for mark, encoding in BYTE_ORDER_MARKS:
        if data.startswith(mark):
            return encoding
    sample = data[: SAMPLE_SIZE // 2 * 2]
    half = len(sample) // 2
    zeros = (sample[0::2].count(0), sample[1::2].count(0))
    if half > 4 and max(zeros) > 0.8 * half and min(zeros) < 0.2 * half:
        return "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
    return None
