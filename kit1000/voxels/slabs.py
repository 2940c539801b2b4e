"""Slabs of a grid's first axis, distributed over threads; compiled loops release the interpreter lock.

Slabs do not depend on the number of threads, so results do not either.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from kit1000.errors import InputError
from kit1000.parallel import usable_cores

SLAB_VOXELS = 1 << 17  # half a megabyte of float32: fits the cache of a core, and gives enough slabs for all threads


def for_each_slab(work: Callable[[int, int], None], shape: tuple[int, int, int], threads: int | None) -> None:
    """Call work(start, stop) for ranges that cover the first axis. `threads` None: all available cores."""
    if threads is not None and not (isinstance(threads, int) and threads >= 1):
        raise InputError(f"threads: expected a whole number from 1 up, or None for all cores, got {threads!r}")
    step = max(SLAB_VOXELS // (shape[1] * shape[2]), 1)
    ranges = [(start, min(start + step, shape[0])) for start in range(0, shape[0], step)]
    count = min(threads or usable_cores(), len(ranges))
    if count == 1:
        for start, stop in ranges:
            work(start, stop)
        return
    with ThreadPoolExecutor(count) as pool:
        for _ in pool.map(lambda slab: work(*slab), ranges):
            pass  # reading the results raises the exceptions of the threads
