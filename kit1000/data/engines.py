"""Running many independent jobs: in processes of this machine, each result the same as if it ran alone."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import TypeVar

from kit1000.errors import Kit1000Error, fault

Job = TypeVar("Job")
Result = TypeVar("Result")

AHEAD = 4  # jobs handed out per worker before results are taken: keeps workers fed and memory flat


@contextmanager
def local(workers: int | None) -> Iterator[Callable[[Callable[[Job], Result], Iterable[Job]], Iterator[Result]]]:
    """A function like `map` that spreads jobs over processes and yields results as they come.

    workers: None = one per core; 1 = in this process. The first error of a job stops the run; one that nobody foresaw
    names the job by its str(). When this process dies, in whatever way, its workers go with it.
    """
    count = workers or cores()
    if count == 1:
        yield lambda function, jobs: map(partial(_named, function), jobs)
        return
    pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"), initializer=_follow_parent)
    try:
        yield lambda function, jobs: _spread(pool, count, function, jobs)
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _spread(pool: ProcessPoolExecutor, count: int, function: Callable, jobs: Iterable) -> Iterator:
    pending: dict[Future, object] = {}  # with their jobs, the longest waiting first
    queue = iter(jobs)
    while True:
        try:
            with _signals_held():
                for job in islice(queue, count * AHEAD - len(pending)):
                    pending[pool.submit(_named, function, job)] = job
            if not pending:
                return
            results = [(future, future.result()) for future in wait(pending, return_when=FIRST_COMPLETED).done]
        except BrokenProcessPool:
            likely = ", ".join(str(job) for job in islice(pending.values(), count))
            raise Kit1000Error(
                f"a worker process died (killed, or out of memory), probably at one of: {likely}; "
                "run the same command again, it continues; fewer --workers need less memory"
            ) from None
        for future, result in results:
            del pending[future]
            yield result


def _named(function: Callable[[Job], Result], job: Job) -> Result:
    """Do a job; an exception that nobody foresaw becomes one line that names it."""
    try:
        return function(job)
    except Kit1000Error:
        raise
    except Exception as error:
        raise fault(str(job), error) from error


@contextmanager
def _signals_held() -> Iterator[None]:
    """Ctrl-C waits meanwhile: processes started here never see it, their parent does and ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _follow_parent() -> None:
    """End this worker when its parent is gone, also by SIGKILL: it would wait for jobs for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
