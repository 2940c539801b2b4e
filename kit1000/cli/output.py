"""Standard output and error as a command may find them: full, closed, or in an encoding that lacks a letter."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from typing import Any

from kit1000.errors import InputError


class _Checked:
    """A stream whose failures are input errors: the disk or the device behind it is the user's."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        return self._call(self._stream.write, text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        self._call(self._stream.flush)

    def _call(self, function: Any, *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise InputError(f"cannot write the results to standard output: {error.strerror or error}") from error


def system_fault() -> str | None:
    """Why commands cannot run here, in one line: another operating system, or no place for the results."""
    if find_spec("fcntl") is None:
        return "runs on Linux and macOS; on Windows use WSL (wsl --install)"
    if sys.stdout is None:
        return "standard output is closed: redirect it to a file or to /dev/null"
    return None


@contextmanager
def checked_output() -> Iterator[None]:
    """Print letters that an encoding lacks with escapes, and raise InputError when results cannot be written.

    The output is flushed at the end of the block; after a failure what is left of it is thrown away.
    """
    if sys.stderr is None:  # else it would be printed among the results
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (until the process ends)
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):
            stream.reconfigure(errors="backslashreplace")  # pyright: ignore[reportAttributeAccessIssue]
    before = sys.stdout
    sys.stdout = _Checked(before)  # pyright: ignore[reportAttributeAccessIssue]
    try:
        try:
            yield
        except SystemExit:  # after --help
            sys.stdout.flush()
            raise
        sys.stdout.flush()
    except (InputError, BrokenPipeError):
        _discard(before)
        raise
    finally:
        sys.stdout = before


def _discard(stream: Any) -> None:
    """Throw away what a stream cannot write, or Python would complain when it ends; a stream that works is flushed."""
    try:
        stream.flush()
    except OSError:
        with suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
