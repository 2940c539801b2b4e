"""Atomic writes, hashes, canonical JSON, and a lock on a folder that is being written.

A folder is a Path, or for a URL a UPath of universal_pathlib, which has the methods of Path that are used here and is
typed as Path. Object stores behind URLs have no locks and no partial files: they store a file in one operation.
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
from typing import IO, Any, TypeVar, cast
from urllib.parse import unquote

import msgspec

from kit1000.errors import InputError

OWN_MARK, OWN_HEADER = b"kit1000", 256  # what a picture or recording of ours has in its first bytes
LFS_POINTER = b"version https://git-lfs"  # first bytes of what stands in place of a file that Git LFS keeps
LFS_ADVICE = "a Git LFS pointer instead of the file itself: run git lfs pull"
Kind = TypeVar("Kind")
PARTIAL = ".partial"  # suffix of a file being written; files with it may be deleted


def parse_folder(name: str) -> Path:
    """The folder of a path or a URL such as s3://bucket/data.

    Raises InputError when the URL's scheme is not supported; the message names the missing package.
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
        place.fs.invalidate_cache()  # imports the package for the scheme, and drops listings of earlier runs
    except (ImportError, ValueError) as error:
        raise InputError(f"{name}: {error}") from error
    return cast(Path, place)


def user_cache(name: str) -> Path:
    """The folder of that name for what may be deleted at any time: below $XDG_CACHE_HOME, or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "kit1000" / name


def is_url(path: Path) -> bool:
    """Whether a folder or file is behind a URL."""
    return not isinstance(path, Path)


def write_bytes(path: Path, data: bytes) -> str:
    """Write a file atomically: complete or not at all, also after a crash; returns the SHA-256 in hex."""
    (_write_url if is_url(path) else _write_local)(path, data)
    return hashlib.sha256(data).hexdigest()


def write_own(path: Path, data: bytes) -> str:
    """Write a file as `write_bytes` does, unless one of another origin is there.

    Raises InputError where a file is neither equal nor of the same kind: JSON with the same keys, a text with the same
    first line, or a picture or recording that this package wrote.
    """
    if not is_url(path) and path.is_file():
        old = path.read_bytes()
        if old != data and not _same_kind(old, data):
            raise InputError(f"{path}: is there already and of another origin: it stays; name another file")
    return write_bytes(path, data)


def check_own_mark(path: Path) -> None:
    """Raise InputError where a picture or recording that is not of this package would be replaced."""
    if path.is_file() and OWN_MARK not in path.read_bytes()[:OWN_HEADER].lower():
        raise InputError(f"{path}: is there already and of another origin: it stays; name another file")


def _same_kind(old: bytes, new: bytes) -> bool:
    if new.startswith((b"\x89PNG", b"\x89MCAP")):
        return old[:4] == new[:4] and OWN_MARK in old[:OWN_HEADER].lower()
    keys = [_keys(data) for data in (old, new)]
    return keys[0] == keys[1] if keys[1] else old.partition(b"\n")[0] == new.partition(b"\n")[0]


def _keys(data: bytes) -> set[str] | None:
    """The keys of a JSON object, or of the first one of JSON lines; None for anything else."""
    for text in (data, data.partition(b"\n")[0]):
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            continue
        return set(value) if isinstance(value, dict) else None
    return None


def _write_local(path: Path, data: bytes) -> None:
    """Write a partial file, then rename it; its name is unique by node, process and thread."""
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


def _write_url(path: Path, data: bytes) -> None:
    """Write a file behind a URL."""
    try:
        _write_store(path, data)
    except Exception as error:  # every store has its own exceptions
        raise InputError(f"cannot write {path}: {_store_error(error)}") from error


def _write_store(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except FileNotFoundError:  # not an object store: it needs its folders
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def write_json(path: Path, value: Any) -> str:
    """Write a value as JSON: sorted keys, one top-level entry a line, full precision; returns the SHA-256 in hex."""
    return write_bytes(path, json_bytes(value))


def json_bytes(value: Any) -> bytes:
    """The canonical bytes of a JSON value: the same value gives the same bytes everywhere."""
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
    if is_url(folder):
        return
    for pattern in [f".{name}.*{PARTIAL}" for name in names] or [f"**/.*{PARTIAL}"]:
        for leftover in folder.glob(pattern):
            leftover.unlink(missing_ok=True)


def remove_folder(folder: Path) -> None:
    """Delete a folder and everything below it, as far as it can be deleted."""
    if not is_url(folder):
        shutil.rmtree(folder, ignore_errors=True)
        return
    store = cast(Any, folder).fs
    store.invalidate_cache()  # of listings: other machines may have written there
    with suppress(Exception):  # every store has its own exceptions
        store.rm(cast(Any, folder).path, recursive=True)


def check_writable(folder: Path) -> None:
    """Raise InputError when files cannot be written to a folder; leaves no file behind."""
    if is_url(folder):
        _check_url_writable(folder)
        return
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if not nearest.is_dir():
        raise InputError(f"cannot write to {folder}: {_os_error(NotADirectoryError(errno.ENOTDIR, 'Not a directory'))}")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"cannot write to {folder}: {_os_error(PermissionError(errno.EACCES, 'Permission denied'))}")


def _check_url_writable(folder: Path) -> None:
    """Write and delete a file behind a URL: stores do not report permissions."""
    probe = folder / f".{platform.node()}.{os.getpid()}{PARTIAL}"
    try:
        _write_store(probe, b"")
        probe.unlink()
    except Exception as error:  # every store has its own exceptions
        raise InputError(f"cannot write to {folder}: {_store_error(error)}") from error


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder for one writer; the lock ends with the process, also when it is killed.

    There are no locks behind a URL: two writers of the same plan do the same work twice.
    """
    if is_url(folder):
        yield
        return
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

    Raises BlockingIOError where another process has it, another OSError where the disk has no locks, and InputError on
    systems without them.
    """
    try:
        import fcntl
    except ImportError:
        raise InputError("writing to folders needs Linux or macOS; on Windows use WSL (wsl --install)") from None
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _compact(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(", ", ": "), allow_nan=False)


def _store_error(error: Exception) -> str:
    """The error of an object store as one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"


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
