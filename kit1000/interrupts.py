"""Signals that end a command: SIGTERM raises as Ctrl-C does, a wait that none slips past, work that ends in order."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

LOOK_EVERY = 0.5  # [s]


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


@dataclass
class Deferral:
    """Whether the work of a block is asked to end."""

    requested: bool = False


@contextmanager
def deferred_interrupts(notice: str) -> Iterator[Deferral]:
    """Let the first Ctrl-C or SIGTERM in the block only ask it to end, and print a notice; the second one raises.

    The handlers before are restored. Only the main thread can set them: in others nothing is asked.
    """
    deferral = Deferral()
    if not in_main_thread():
        yield deferral
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if deferral.requested:
            raise KeyboardInterrupt
        deferral.requested = True
        print(notice, file=sys.stderr, flush=True)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, handle)
    try:
        yield deferral
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def wait_until_interrupted() -> None:
    """Wait in the main thread for KeyboardInterrupt.

    A wait without an end can miss it: a signal that comes just before the thread blocks sets a flag that only a running
    interpreter reads. So the thread looks twice a second.
    """
    while True:
        time.sleep(LOOK_EVERY)


def in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
