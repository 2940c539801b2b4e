"""Jobs in processes of this machine. When this process dies, in whatever way, its workers go with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from typing import Any

from kit1000.engines.cores import cores
from kit1000.engines.jobs import AHEAD, ONE_THREAD, RETRIES, Spread, named
from kit1000.errors import Kit1000Error


@contextmanager
def local(workers: int | None = None) -> Iterator[Spread]:
    """Spread jobs over processes of this machine.

    workers: None = one per core; 1 = in this process.
    """
    count = workers or cores()
    if count == 1:
        yield lambda function, jobs: map(partial(named, function), jobs)
        return
    pool = _Pool(count)
    try:
        yield partial(_spread, pool)
    except BaseException:
        pool.kill()
        raise
    pool.close()


@dataclass
class _Task:
    job: Any
    deaths: int = 0
    """How often a worker died that may have been at it."""


class _Pool:
    """Processes, all of which are replaced when one of them dies."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._executor = self._started()

    def _started(self) -> ProcessPoolExecutor:
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.count, mp_context=spawn, initializer=_begin)

    def submit(self, function: Callable[[Any], Any], job: Any) -> Future[Any]:
        """Hand out a job. Its future says BrokenProcessPool when a worker died, also before this call."""
        try:
            return self._executor.submit(named, function, job)
        except BrokenProcessPool as error:
            future: Future[Any] = Future()
            future.set_exception(error)
            return future

    def renew(self) -> None:
        self.kill()
        self._executor = self._started()

    def kill(self) -> None:
        for process in list((self._executor._processes or {}).values()):
            process.terminate()
        self._executor.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        self._executor.shutdown()


def _spread(pool: _Pool, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
    tasks: Iterator[_Task] = map(_Task, jobs)
    pending: dict[Future[Any], _Task] = {}  # the longest waiting first
    while True:
        with _signals_held():
            for task in islice(tasks, pool.count * AHEAD - len(pending)):
                pending[pool.submit(function, task.job)] = task
        if not pending:
            return
        done = wait(pending, return_when=FIRST_COMPLETED).done
        if any(map(_lost, done)):
            done = wait(pending).done  # all of them: the pool is gone, so none has long to wait
            again = [task for future, task in pending.items() if _lost(future)]
            _blame(again[: pool.count])
            tasks = chain(again, tasks)
            pool.renew()
        finished = {future: pending.pop(future) for future in done}
        yield from [future.result() for future in finished if not _lost(future)]


def _lost(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _blame(suspects: list[_Task]) -> None:
    """Count a death for the jobs that the dead worker may have been at, the longest waiting ones."""
    for task in suspects:
        task.deaths += 1
    worst = max(task.deaths for task in suspects)
    if worst > RETRIES:
        likely = ", ".join(str(task.job) for task in suspects if task.deaths == worst)
        raise Kit1000Error(
            f"a worker process died {worst} times (killed, or out of memory), probably at one of: {likely}; "
            "run the same command again, it continues; fewer --workers need less memory"
        )
    print("a worker process died (killed, or out of memory): its jobs are done again", file=sys.stderr)


@contextmanager
def _signals_held() -> Iterator[None]:
    """Ctrl-C waits meanwhile: processes started here never see it, their parent does and ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """One thread for this worker, before it imports what reads that; and an end when its parent is gone."""
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    _follow_parent()


def _follow_parent() -> None:
    """End this worker when its parent is gone, also by SIGKILL: it would wait for jobs for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
