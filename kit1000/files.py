"""Atomic writes, hashes, canonical JSON, and the rule for what a command may write to.

The rule: `--out` is new, empty, or was written by an earlier run of the same command; else the command refuses it.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import shutil
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, TypeVar

import msgspec

from kit1000.errors import InputError

OWN_MARK, OWN_HEADER = b"kit1000", 256  # a picture or recording of ours has the mark in its first bytes
PICTURES = (b"\x89PNG", b"\x89MCAP")  # first bytes of files that carry the mark
REFUSED = "exists already and was not written by this command: choose another name"
LFS_POINTER = b"version https://git-lfs"  # first bytes of the file that Git LFS puts in place of a large one
LFS_ADVICE = "a Git LFS pointer instead of the file itself: run git lfs pull"
Kind = TypeVar("Kind")
PARTIAL = ".partial"  # suffix of a file or folder being written; both may be deleted


def user_cache(name: str) -> Path:
    """The folder of a cache, which may be deleted at any time: below $XDG_CACHE_HOME, or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "kit1000" / name


def check_output(folder: Path, *marks: str) -> None:
    """Raise InputError unless a command may write to a folder: it can, and the folder is new, empty or its own.

    Args:
        folder: what --out names.
        marks: names of files that every run of the command writes; one of them shows an earlier run.
    """
    check_writable(folder)
    if not folder.is_dir() or any((folder / mark).exists() for mark in marks):
        return
    if any(not entry.name.startswith(".") for entry in folder.iterdir()):  # hidden: a lock, files being written
        raise InputError(f"{folder}: is not empty and was not written by this command: choose another --out")


def check_output_file(path: Path) -> None:
    """Raise InputError unless a command may write a picture or recording: its place is free or it has our mark."""
    check_writable(path.parent)
    if path.is_dir():
        raise InputError(f"cannot write {path}: a folder exists where a file is needed")
    if path.is_file() and OWN_MARK not in path.read_bytes()[:OWN_HEADER].lower():
        raise InputError(f"{path}: {REFUSED}")


def write_own(path: Path, data: bytes) -> str:
    """Write a file as `write_bytes` does, unless a file that the same command cannot have written is there.

    Raises InputError when that file is of another kind: JSON with other keys, a text with another first line, a
    picture or recording without our mark.
    """
    if path.is_file() and (old := path.read_bytes()) != data and _kind(old) != _kind(data):
        raise InputError(f"{path}: {REFUSED}")
    return write_bytes(path, data)


def _kind(data: bytes) -> object:
    """What files of one command share: keys of a JSON object or of the first one of JSON lines; mark; first line."""
    first_line = data.partition(b"\n")[0]
    if data.startswith(PICTURES):
        return data[:4], OWN_MARK in data[:OWN_HEADER].lower()
    for text in (data, first_line):
        with suppress(ValueError, RecursionError):
            if isinstance(value := json.loads(text), dict):
                return sorted(value)
    return first_line


@contextmanager
def new_folder(folder: Path, what: str) -> Iterator[Path]:
    """A temporary folder to write into, renamed to `folder` at the end of the block, deleted when the block fails.

    Raises InputError when `folder` is not new or empty, or cannot be written. `what` names its contents in the message.
    """
    if os.path.lexists(folder) and not (folder.is_dir() and not any(folder.iterdir())):
        raise InputError(f"{folder} exists already: name a new folder for the {what}")
    partial = folder.with_name(f".{folder.name}.{os.getpid()}{PARTIAL}")
    try:
        partial.mkdir(parents=True)
        try:
            yield partial
            os.rename(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror or error}") from error


def write_bytes(path: Path, data: bytes) -> str:
    """Write a file atomically: complete or not at all, also after a crash; returns the SHA-256 in hex."""
    partial = path.with_name(f".{path.name}.{platform.node()}.{os.getpid()}-{threading.get_ident()}{PARTIAL}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {_os_error(error)}") from error
    finally:  # also on Ctrl-C; after the rename there is no partial file
        with suppress(OSError):
            partial.unlink()
    return hashlib.sha256(data).hexdigest()


def write_json(path: Path, value: Any) -> str:
    """Write a value as JSON: sorted keys, one top-level entry a line, full precision; returns the SHA-256 in hex."""
    return write_bytes(path, json_bytes(value))


def json_bytes(value: Any) -> bytes:
    """The canonical bytes of a JSON value, which are the same everywhere: one top-level entry a line."""
    if isinstance(value, dict):
        rows = [f"{json.dumps(key)}: {_compact(value[key])}" for key in sorted(value)]
        return ("{\n" + ",\n".join(rows) + "\n}\n").encode()
    return (_compact(value) + "\n").encode()


def with_checksum(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of a JSON object with `checksum`: the SHA-256 in hex of the bytes of the others."""
    plain = {key: value for key, value in entries.items() if key != "checksum"}
    return plain | {"checksum": hashlib.sha256(json_bytes(plain)).hexdigest()}


def read_json(path: Path) -> Any:
    """The value in a JSON file. Raises InputError when it is missing, unreadable or no JSON."""
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        raise InputError(f"no file {path}") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"cannot read {path}: damaged or no JSON ({error})") from error


def converted(value: Any, kind: type[Kind], place: object) -> Kind:
    """A JSON value as a msgspec struct or dataclass.

    Raises InputError that begins with the place, such as a path, and names the field that does not fit.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise InputError(f"{place}: {error}") from None


def sha256(path: Path) -> str | None:
    """SHA-256 of a file's bytes in hex; None when it is missing or unreadable."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()


def clear_partial(folder: Path, *names: str) -> None:
    """Delete partial files of interrupted writers: of files with these names, or all below the folder."""
    for pattern in [f".{name}.*{PARTIAL}" for name in names] or [f"**/.*{PARTIAL}"]:
        for leftover in folder.glob(pattern):
            leftover.unlink(missing_ok=True)


def check_writable(folder: Path) -> None:
    """Raise InputError when files cannot be written to a folder, which need not exist."""
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if not nearest.is_dir():
        raise InputError(f"cannot write to {folder}: {_os_error(NotADirectoryError(errno.ENOTDIR, 'Not a directory'))}")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"cannot write to {folder}: {_os_error(PermissionError(errno.EACCES, 'Permission denied'))}")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder for one writer; the lock ends with the process, also when it is killed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = open(folder / ".lock", "w")  # noqa: SIM115 (held until the end of the block)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {_os_error(error)}") from error
    with handle:
        try:
            lock_file(handle)
        except BlockingIOError:
            raise InputError(
                f"{folder} is being written by another process: wait for it or choose another --out"
            ) from None
        except OSError as error:
            raise InputError(f"cannot lock {folder}: {_os_error(error)}; choose a folder on another disk") from error
        yield


def lock_file(file: IO[Any]) -> None:
    """Lock an open file until it is closed; the lock ends with the process, also when it is killed.

    Raises BlockingIOError when another process has it, another OSError when the disk has no locks, and InputError on
    systems without them.
    """
    try:
        import fcntl
    except ImportError:
        raise InputError("writing to folders needs Linux or macOS; on Windows use WSL (wsl --install)") from None
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _compact(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(", ", ": "), allow_nan=False)


def _os_error(error: OSError) -> str:
    """The error of the operating system, with a hint how to fix it."""
    hint = ""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        hint = "; free some space and run the same command again"
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        hint = "; choose a folder you may write to with --out"
    elif error.errno in (errno.ENOTDIR, errno.EEXIST):
        hint = "; a file exists where a folder is needed"
    elif error.errno == errno.EISDIR:
        hint = "; a folder exists where a file is needed"
    return f"{error.strerror or error}{hint}"
