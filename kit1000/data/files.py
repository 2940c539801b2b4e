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


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that it is there entirely or not at all, also after a crash between write and rename."""
    partial = path.with_name(f".{path.name}.{os.getpid()}{PARTIAL}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise InputError(f"cannot write {path}: {error.strerror or error}{_mend(error)}") from error


def write_json(path: Path, value: Any) -> None:
    """Write a value as JSON with sorted keys, one top-level entry a line, floats in full precision."""
    write_bytes(path, json_bytes(value))


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
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read {path}: {error}") from error


def sha256(path: Path) -> str:
    """Hash of a file's bytes, in hex."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest() if hasattr(hashlib, "file_digest") else _digest(file)


def clear_partial(folder: Path) -> None:
    """Delete what an interrupted writer left behind."""
    for leftover in folder.rglob(f".*{PARTIAL}"):
        leftover.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder for one writer; the lock goes with the process, also when it is killed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = open(folder / ".lock", "w")  # noqa: SIM115 (held until the end of the block)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}{_mend(error)}") from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{folder} is being written by another process: wait for it or choose another --out"
            ) from None
        yield


def _compact(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(", ", ": "), allow_nan=False)


def _digest(file: Any) -> str:
    digest = hashlib.sha256()
    while block := file.read(1 << 20):
        digest.update(block)
    return digest.hexdigest()


def _mend(error: OSError) -> str:
    if error.errno == errno.ENOSPC:
        return "; free some space and run the same command again: it continues"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return "; choose a folder you may write to with --out"
    if error.errno in (errno.ENOTDIR, errno.EEXIST):
        return "; a file stands where a folder is needed"
    return ""
