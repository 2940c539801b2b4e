"""Jobs for the tests of engines, as functions of a module, so that workers can import them."""

from __future__ import annotations

import os
import signal

from kit1000.errors import InputError


def square(x: int) -> int:
    return x * x


def fail_at_three(x: int) -> int:
    if x == 3:
        raise ValueError("two\nlines")
    if x < 0:
        raise InputError("disk full")
    return x


def kill_own_process(x: int) -> int:
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x
