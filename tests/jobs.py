"""Jobs to be run by any engine, as functions of a module: workers find them by their names."""

from __future__ import annotations

import os
import signal

from kit1000.errors import InputError


def square(x: int) -> int:
    return x * x


def stumble(x: int) -> int:
    if x == 3:
        raise ValueError("two\nlines")
    if x < 0:
        raise InputError("disk full")
    return x


def die(x: int) -> int:
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x
