"""Reading a file of a submission whatever it holds: the reasons why it cannot be opened, or is no text."""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path

from kit1000.submission.faults import Fault, printable

LARGEST = 1 << 28  # bytes; a million predictions take 150 MB
SAMPLE = 4096  # bytes looked at to tell a text from other things
BINARY_SHARE = 0.1  # of those bytes that stand in no text
STRAY = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")  # controls, and bytes that are not UTF-8

MAGIC = (
    (b"\x1f\x8b", "a gzip file", "unpack it with gunzip"),
    (b"PK\x03\x04", "a zip file or a spreadsheet's own format", "unpack it, or save the sheet as CSV"),
    (b"\xd0\xcf\x11\xe0", "a spreadsheet's own format", "save the sheet as CSV"),
    (b"BZh", "a bzip2 file", "unpack it with bunzip2"),
    (b"\xfd7zXZ", "an xz file", "unpack it with unxz"),
    (b"\x28\xb5\x2f\xfd", "a zstd file", "unpack it with unzstd"),
    (b"\x93NUMPY", "a file of numpy", "write the rows with kit1000.write_submission"),
    (b"\x89HDF", "an HDF5 file", "write the rows with kit1000.write_submission"),
    (b"PAR1", "a parquet file", "write the rows with kit1000.write_submission"),
    (b"\x80\x04\x95", "a pickle", "write the rows with kit1000.write_submission"),
    (b"\x80\x05\x95", "a pickle", "write the rows with kit1000.write_submission"),
    (b"%PDF", "a PDF", "write plain text"),
    (b"version https://git-lfs", "a pointer of git lfs, not the file itself", "fetch the file with git lfs pull"),
)
WIDE = (
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)


def whole(file: str, name: str, seen: str, wanted: str, repair: str) -> Fault:
    """An error of a file as a whole."""
    return Fault(file, None, None, seen, wanted, repair, "error", name)


def aside(file: str, name: str, seen: str, wanted: str, repair: str) -> Fault:
    """A warning about a file as a whole."""
    return Fault(file, None, None, seen, wanted, repair, "warning", name)


def file_bytes(path: Path, file: str) -> tuple[bytes | None, list[Fault]]:
    """The bytes of a file, or why there are none; `file` is what messages call it."""
    try:
        found = os.stat(path)
        if stat.S_ISDIR(found.st_mode):
            return None, [whole(file, "folder", "is a folder", "a file", "put the file itself there")]
        if not stat.S_ISREG(found.st_mode):
            return None, [
                whole(file, "no-regular-file", "is no regular file", "a file", "copy its content into a file")
            ]
        if found.st_size > LARGEST:
            size, most = found.st_size >> 20, LARGEST >> 20
            return None, [
                whole(file, "too-large", f"has {size} MiB", f"at most {most} MiB", "leave out what is not asked")
            ]
        return path.read_bytes(), []
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        return None, [_unopened(path, file, error)]


def _unopened(path: Path, file: str, error: OSError | ValueError) -> Fault:
    """Why a file could not be opened."""
    code = error.errno if isinstance(error, OSError) else None
    if code in (errno.ENOENT, errno.ENOTDIR):
        if path.is_symlink():
            return whole(file, "broken-link", "is a link that leads nowhere", "a file", "put the file itself there")
        near = _same_but_for_case(path)
        repair = f"rename {near}" if near else "check the path, or write the file with kit1000.write_submission"
        return whole(file, "missing-file", "does not exist", f"a file {printable(path.name)}", repair)
    if code == errno.ELOOP:
        return whole(file, "link-loop", "is a link that leads back to itself", "a file", "put the file itself there")
    if code in (errno.EACCES, errno.EPERM):
        return whole(file, "no-permission", "may not be read", "a file you may read", "change its rights with chmod")
    said = " ".join(str(error.strerror if isinstance(error, OSError) else error).split())
    return whole(file, "unreadable", f"cannot be read ({printable(said)})", "a readable file", "copy it anew")


def _same_but_for_case(path: Path) -> str | None:
    """Another name in the folder that was probably meant."""
    try:
        names = sorted(os.listdir(path.parent))
    except (OSError, ValueError):
        return None
    near = [name for name in names if name.casefold() == path.name.casefold()]
    others = [name for name in names if name.casefold().endswith(path.suffix)] if path.suffix else []
    found = near or (others if len(others) == 1 else [])
    return printable(found[0]) if found else None


def text_of(data: bytes, file: str) -> tuple[str | None, list[Fault]]:
    """Bytes as text with line ends made `\\n`; bytes that are no UTF-8 become lone surrogates, for the reader to name.

    No text comes back for what is none.
    """
    if not data.strip(b" \t\r\n\x00") and not data.strip():
        return None, [whole(file, "empty", "is empty", "a header and a row a query", "write the predictions again")]
    for magic, what, repair in MAGIC:
        if data.startswith(magic):
            return None, [whole(file, "binary", f"is {what}", "plain text", repair)]
    text, faults = _decoded(data, file)
    if text is None:
        return None, faults
    if "\r" in text:
        seen = "has line ends of Windows or an old Mac"
        faults.append(
            aside(file, "line-ends", seen, "line ends of Unix", "nothing need be done: they are read all the same")
        )
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    return text, faults


def _decoded(data: bytes, file: str) -> tuple[str | None, list[Fault]]:
    wide = _wide_encoding(data)
    if wide:
        repair = f"convert it: iconv -f {wide.upper()} -t UTF-8"
        fault = whole(file, "wide-text", f"is {wide[:6].upper()} text", "UTF-8 text", repair)
        return data.decode(wide, "replace").removeprefix("\ufeff"), [fault]
    faults = []
    if data.startswith(b"\xef\xbb\xbf"):
        repair = "nothing need be done: it is read all the same"
        faults.append(aside(file, "byte-order-mark", "begins with a byte order mark", "plain UTF-8", repair))
        data = data[3:]
    sample = data[:SAMPLE].decode("utf-8", "surrogateescape")
    if len(STRAY.findall(sample)) > BINARY_SHARE * len(sample) + 1:
        return None, [*faults, whole(file, "binary", "holds bytes of no text", "plain text", "write the file again")]
    return data.decode("utf-8", "surrogateescape"), faults


def _wide_encoding(data: bytes) -> str | None:
    """UTF-16 or UTF-32, by its mark or because every other byte is 0."""
    for mark, encoding in WIDE:
        if data.startswith(mark):
            return encoding
    sample = data[: SAMPLE // 2 * 2]
    half = len(sample) // 2
    zeros = (sample[0::2].count(0), sample[1::2].count(0))
    if half > 4 and max(zeros) > 0.8 * half and min(zeros) < 0.2 * half:
        return "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
    return None
