"""Atomic writing of a new folder: it appears when it is complete, or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kit1000.errors import InputError


@contextmanager
def new_folder(folder: Path, what: str) -> Iterator[Path]:
    """A temporary folder to write into, renamed to `folder` at the end of the block, deleted when the block fails.

    Raises InputError when `folder` exists or cannot be written. `what` names its contents in the messages.
    """
    if os.path.lexists(folder):
        raise InputError(f"{folder} exists already: name a new folder for the {what}")
    partial = folder.with_name(f".{folder.name}.{os.getpid()}.partial")
    try:
        partial.mkdir(parents=True)
        try:
            yield partial
            os.rename(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror or error}") from error
