"""How long work takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

Made = TypeVar("Made")
Clock = Callable[[], float]


def timed(work: Callable[[], Made], clock: Clock = time.perf_counter) -> tuple[float, Made]:
    """The seconds that work takes, and what it makes.

    clock: `time.process_time` counts those of the processor, which other programs hardly lengthen.
    """
    start = clock()
    made = work()
    return clock() - start, made


def fastest(work: Callable[[], Made], repeats: int, clock: Clock = time.perf_counter) -> tuple[float, Made]:
    """The fewest seconds of several repeats, which other programs lengthen least, and what the last one makes."""
    seconds, made = timed(work, clock)
    for _ in range(repeats - 1):
        again, made = timed(work, clock)
        seconds = min(seconds, again)
    return seconds, made
