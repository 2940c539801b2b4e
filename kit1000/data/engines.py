"""Running many independent jobs: in processes of this machine, each result the same as if it ran alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from kit1000.errors import Kit1000Error

Job = TypeVar("Job")
Result = TypeVar("Result")

AHEAD = 4  # jobs handed out per worker before results are taken: keeps workers fed and memory flat


@contextmanager
def local(workers: int | None) -> Iterator[Callable[[Callable[[Job], Result], Iterable[Job]], Iterator[Result]]]:
    """A function like `map` that spreads jobs over processes and yields results as they come.

    workers: None = one per core; 1 = in this process. The first error of a job stops the run and names it.
    """
    count = workers or cores()
    if count == 1:
        yield map
        return
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_alone)
    try:
        yield lambda function, jobs: _spread(pool, count * AHEAD, function, jobs)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    pool.shutdown()


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _spread(pool: ProcessPoolExecutor, ahead: int, function: Callable, jobs: Iterable) -> Iterator:
    pending: set[Future] = set()
    queue = iter(jobs)
    try:
        while True:
            for job in queue:
                pending.add(pool.submit(function, job))
                if len(pending) >= ahead:
                    break
            if not pending:
                return
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()
    except BrokenProcessPool:
        raise Kit1000Error(
            "a worker process died (killed, or out of memory): run the same command again, it continues"
        ) from None


def _alone() -> None:
    """Workers leave Ctrl-C to the process that started them, and use one thread each."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
