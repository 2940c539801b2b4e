"""Signals that end a command: SIGTERM raises KeyboardInterrupt as Ctrl-C does; a wait for Ctrl-C."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

LOOK_EVERY = 0.5  # [s] between two looks for a signal


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Let SIGTERM raise KeyboardInterrupt in the block, as Ctrl-C does, so that a killed command ends its workers too.

    The handler before is restored after the block: a process forked later, such as a worker of a pool, would inherit
    it, and a worker that SIGTERM interrupts instead of ending may wait for ever.
    """
    with keeping_sigterm():
        if in_main_thread():
            signal.signal(signal.SIGTERM, signal.default_int_handler)
        yield


@contextmanager
def keeping_sigterm() -> Iterator[None]:
    """Restore the handler of SIGTERM after the block. Only the main thread can set it: others do nothing."""
    if not in_main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if before is not None:  # None: set by compiled code, which Python can neither read nor restore
            signal.signal(signal.SIGTERM, before)


def wait_until_interrupted() -> None:
    """Wait in the main thread for KeyboardInterrupt.

    A wait without an end can miss it: a signal that comes just before the thread blocks sets a flag that only a running
    interpreter reads. So the thread looks twice a second.
    """
    while True:
        time.sleep(LOOK_EVERY)


def in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
