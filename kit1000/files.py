"""Files that are whole or absent: atomic writes, hashes, canonical JSON, and a lock on a folder being built.

A folder is a Path, or behind a URL a UPath of universal_pathlib, which has the methods of a Path that we use and goes
by that type here. Stores behind URLs have no locks, and no partial files: an object store takes a file whole.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import platform
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast
from urllib.parse import unquote

from kit1000.errors import InputError

PARTIAL = ".partial"  # suffix of a file being written; whatever bears it may be deleted


def folder(name: str) -> Path:
    """The folder that a path names, or a URL such as s3://bucket/data.

    Raises InputError when the URL is of a kind that cannot be reached, and says which package it takes.
    """
    if "://" not in name:
        return Path(name)
    if name.startswith("file:///"):
        return Path(unquote(name.removeprefix("file://")))
    try:
        from upath import UPath
    except ImportError:
        raise InputError(f"{name}: a URL as a folder needs more packages: pip install 'kit1000[ray]'") from None
    try:
        place = UPath(name)
        place.fs.invalidate_cache()  # finds the package that knows such places, and forgets what an earlier run saw
    except (ImportError, ValueError) as error:
        raise InputError(f"{name}: {error}") from error
    return cast(Path, place)


def is_url(path: Path) -> bool:
    """Whether a folder or file is none of this machine's, but behind a URL."""
    return not isinstance(path, Path)


def write_bytes(path: Path, data: bytes) -> str:
    """Write a file so that it is there entirely or not at all, also after a crash; returns the SHA-256 in hex."""
    (_put if is_url(path) else _replace)(path, data)
    return hashlib.sha256(data).hexdigest()


def _replace(path: Path, data: bytes) -> None:
    """Write beside the file, then rename: the name tells nodes with a common disk apart, processes and threads."""
    partial = path.with_name(f".{path.name}.{platform.node()}.{os.getpid()}-{threading.get_ident()}{PARTIAL}")
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


def _put(path: Path, data: bytes) -> None:
    """Write behind a URL."""
    try:
        _store(path, data)
    except Exception as error:  # every store has errors of its own
        raise InputError(f"cannot write {path}: {_told(error)}") from error


def _store(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except FileNotFoundError:  # not an object store: it wants its folders made
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


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
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"cannot read {path}: damaged or no JSON ({error})") from error


def sha256(path: Path) -> str | None:
    """Hash of a file's bytes in hex; None when there is no file, or none that can be read."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()


def clear_partial(folder: Path, *names: str) -> None:
    """Delete what an interrupted writer left behind: of files with these names, or of all below the folder."""
    if is_url(folder):
        return
    for pattern in [f".{name}.*{PARTIAL}" for name in names] or [f"**/.*{PARTIAL}"]:
        for leftover in folder.glob(pattern):
            leftover.unlink(missing_ok=True)


def remove_folder(folder: Path) -> None:
    """Delete a folder and all below it, or as much of it as can be deleted."""
    if not is_url(folder):
        shutil.rmtree(folder, ignore_errors=True)
        return
    store = cast(Any, folder).fs
    store.invalidate_cache()  # of listings: other machines have written there meanwhile
    with suppress(Exception):  # every store has errors of its own
        store.rm(cast(Any, folder).path, recursive=True)


def check_writable(folder: Path) -> None:
    """Raise InputError now when files could not be written to a folder later; leaves nothing behind."""
    if is_url(folder):
        _try_out(folder)
        return
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if not nearest.is_dir():
        raise InputError(f"cannot write to {folder}: {_said(NotADirectoryError(errno.ENOTDIR, 'Not a directory'))}")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"cannot write to {folder}: {_said(PermissionError(errno.EACCES, 'Permission denied'))}")


def _try_out(folder: Path) -> None:
    """Write behind a URL and delete again: stores do not tell beforehand what they will allow."""
    probe = folder / f".{platform.node()}.{os.getpid()}{PARTIAL}"
    try:
        _store(probe, b"")
        probe.unlink()
    except Exception as error:  # every store has errors of its own
        raise InputError(f"cannot write to {folder}: {_told(error)}") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder for one writer; the lock goes with the process, also when it is killed.

    Behind a URL there are no locks: two writers of the same plan only do the same work twice.
    """
    if is_url(folder):
        yield
        return
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


def _told(error: Exception) -> str:
    """What a store says of an error, in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"


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
