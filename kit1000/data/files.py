"""Files that are whole or absent: atomic writes, hashes, canonical JSON, and a lock on a folder being built."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from kit1000.errors import InputError

PARTIAL = ".partial"  # suffix of a file being written; whatever bears it may be deleted


def write_bytes(path: Path, data: bytes) -> str:
    """Write a file so that it is there entirely or not at all, also after a crash; returns the SHA-256 in hex."""
    partial = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {_said(error)}") from error
    finally:  # also on Ctrl-C; after the rename there is nothing left to delete
        with suppress(OSError):
            partial.unlink()
    return hashlib.sha256(data).hexdigest()


def write_json(path: Path, value: Any) -> str:
    """Write a value as JSON, sorted keys, one top-level entry a line, full precision; returns the SHA-256."""
    return write_bytes(path, json_bytes(value))


def json_bytes(value: Any) -> bytes:
    """The canonical bytes of a JSON value: the same value gives the same bytes everywhere."""
    if isinstance(value, dict):
        rows = [f"{json.dumps(key)}: {_compact(value[key])}" for key in sorted(value)]
        return ("{\n" + ",\n".join(rows) + "\n}\n").encode()
    return (_compact(value) + "\n").encode()


def read_json(path: Path) -> Any:
    """Read a JSON file. Raises InputError in one line when it is missing, unreadable or no JSON."""
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"cannot read {path}: damaged or no JSON ({error})") from error


def sha256(path: Path) -> str | None:
    """Hash of a file's bytes in hex; None when there is no file, or none that can be read."""
    digest = hashlib.sha256()
    try:
        with open(path, "rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()


def clear_partial(folder: Path, *names: str) -> None:
    """Delete what an interrupted writer left behind: of files with these names, or of all below the folder."""
    for pattern in [f".{name}.*{PARTIAL}" for name in names] or [f"**/.*{PARTIAL}"]:
        for leftover in folder.glob(pattern):
            leftover.unlink(missing_ok=True)


def check_writable(folder: Path) -> None:
    """Raise InputError now when files could not be written to a folder later; makes nothing."""
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if not nearest.is_dir():
        raise InputError(f"cannot write to {folder}: {_said(NotADirectoryError(errno.ENOTDIR, 'Not a directory'))}")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"cannot write to {folder}: {_said(PermissionError(errno.EACCES, 'Permission denied'))}")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder for one writer; the lock goes with the process, also when it is killed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = open(folder / ".lock", "w")  # noqa: SIM115 (held until the end of the block)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {_said(error)}") from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{folder} is being written by another process: wait for it or choose another --out"
            ) from None
        except OSError as error:
            raise InputError(f"cannot lock {folder}: {_said(error)}; choose a folder on another disk") from error
        yield


def _compact(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(", ", ": "), allow_nan=False)


def _said(error: OSError) -> str:
    """What the system says of an error, and how to mend it."""
    mend = ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        mend = "; free some space and run the same command again"
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        mend = "; choose a folder you may write to with --out"
    elif error.errno in (errno.ENOTDIR, errno.EEXIST):
        mend = "; a file stands where a folder is needed"
    elif error.errno == errno.EISDIR:
        mend = "; a folder stands where a file is needed"
    return f"{error.strerror or error}{mend}"
