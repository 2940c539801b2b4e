"""Jobs in processes of this machine. The workers end when this process ends, even when it is killed."""

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

from kit1000.engines.cores import usable_cores
from kit1000.engines.jobs import JOBS_PER_WORKER, ONE_THREAD_ENV, RETRIES, ParallelMap, run_job
from kit1000.engines.main_guard import check_main_guard
from kit1000.errors import Kit1000Error


@contextmanager
def local_engine(workers: int | None = None) -> Iterator[ParallelMap]:
    """Run jobs in processes of this machine.

    Args:
        workers: number of processes; None: one per core; 1: in this process.

    Raises:
        InputError: the script that runs would be run again by each process.
    """
    count = workers or usable_cores()
    if count == 1:
        yield lambda function, jobs: map(partial(run_job, function), jobs)
        return
    check_main_guard()
    pool = _Pool(count)
    try:
        yield partial(_map, pool)
    except BaseException:
        pool.kill()
        raise
    pool.close()


@dataclass
class _Task:
    job: Any
    deaths: int = 0
    """Number of times that a worker died that may have been running the job."""


class _Pool:
    """Worker processes, all of which are replaced when one of them dies."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._executor = self._start()

    def _start(self) -> ProcessPoolExecutor:
        spawn = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.count, mp_context=spawn, initializer=start_worker)

    def submit(self, function: Callable[[Any], Any], job: Any) -> Future[Any]:
        """Submit a job. Its future raises BrokenProcessPool when a worker died, also before this call."""
        try:
            return self._executor.submit(run_job, function, job)
        except BrokenProcessPool as error:
            future: Future[Any] = Future()
            future.set_exception(error)
            return future

    def restart(self) -> None:
        self.kill()
        self._executor = self._start()

    def kill(self) -> None:
        for process in list((self._executor._processes or {}).values()):
            process.terminate()
        self._executor.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        self._executor.shutdown()


def _map(pool: _Pool, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
    tasks: Iterator[_Task] = map(_Task, jobs)
    pending: dict[Future[Any], _Task] = {}  # the longest waiting first
    while True:
        with _sigint_blocked():
            for task in islice(tasks, pool.count * JOBS_PER_WORKER - len(pending)):
                pending[pool.submit(function, task.job)] = task
        if not pending:
            return
        done = wait(pending, return_when=FIRST_COMPLETED).done
        if any(map(_lost, done)):
            done = wait(pending).done  # all of them: the pool is broken, so they end at once
            lost_tasks = [task for future, task in pending.items() if _lost(future)]
            _count_deaths(lost_tasks[: pool.count])
            tasks = chain(lost_tasks, tasks)
            pool.restart()
        finished = {future: pending.pop(future) for future in done}
        yield from [future.result() for future in finished if not _lost(future)]


def _lost(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _count_deaths(possible_causes: list[_Task]) -> None:
    """Count a death for the jobs that the dead worker may have been running, which are the oldest ones.

    Raises Kit1000Error when a job has more deaths than RETRIES.
    """
    for task in possible_causes:
        task.deaths += 1
    most_deaths = max(task.deaths for task in possible_causes)
    if most_deaths > RETRIES:
        likely = ", ".join(str(task.job) for task in possible_causes if task.deaths == most_deaths)
        raise Kit1000Error(
            f"a worker process died {most_deaths} times (killed, or out of memory), probably at one of: {likely}; "
            "run the same command again, it continues; fewer --workers need less memory"
        )
    print("a worker process died (killed, or out of memory): its jobs are run again", file=sys.stderr)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Block Ctrl-C in this block: processes started here ignore it, and their parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_worker() -> None:
    """Set up a worker: one thread, set before the imports that read it, and an end when its parent is gone."""
    for name, value in ONE_THREAD_ENV.items():
        os.environ.setdefault(name, value)
    _end_with_parent()


def _end_with_parent() -> None:
    """End this worker when its parent is gone, also by SIGKILL: it would wait for jobs forever."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
