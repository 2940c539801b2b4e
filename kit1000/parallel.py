"""Runs many independent jobs, in processes of this machine by joblib or on a Ray cluster, with the same results.

An engine is a context manager that returns a `ParallelMap`: like `map`, it takes a function and jobs, and yields
results in the order in which they finish. The first error of a job stops the run. Jobs write files themselves and skip
what is written already, so that the same command continues a run.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

from kit1000.errors import InputError, Kit1000Error, internal_error
from kit1000.interrupts import keeping_sigterm

ParallelMap = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

JOBS_PER_WORKER = 2  # submitted at once; all fit into joblib's queue, whose workers are else not ended in order
LOOK_EVERY = 1.0  # [s] between two looks of a worker whether its parent is there
ONE_THREAD_ENV = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: there is one worker per core, so more threads would only compete."""
CONNECT_TIMEOUT_S = 5.0  # of the server of a cluster
OBJECT_STORE_BYTES = 100 << 20  # shared memory of a local Ray: it holds small results, Ray's minimum is 75 MiB
CONTINUES = "run the same command again, it continues"


def usable_cores() -> int:
    """Number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def thread_map(threads: int | None) -> Iterator[Callable[[Callable, Iterable], Iterable]]:
    """A `map` over threads, for compiled loops, which run side by side; none is started for a single one.

    threads: their number; None: one per core.
    """
    count = threads or usable_cores()
    if count == 1:
        yield map
        return
    with ThreadPoolExecutor(count) as pool:
        yield pool.map


@contextmanager
def local_engine(workers: int | None = None) -> Iterator[ParallelMap]:
    """Run jobs in processes of this machine.

    Args:
        workers: number of processes; None: one per core; 1: in this process.

    Raises Kit1000Error when a worker dies.
    """
    count = workers or usable_cores()
    if count == 1:
        yield lambda function, jobs: map(partial(_run_job, function), jobs)
        return
    begun: list[Any] = []
    try:
        yield partial(_map, count, begun)
    except BrokenProcessPool:
        raise Kit1000Error(
            f"a worker process died (killed, or out of memory); {CONTINUES}; fewer --workers need less memory"
        ) from None
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # joblib counts the jobs that it cancels
            for results in begun:
                results.close()  # ends the workers when an error left jobs


def _map(count: int, begun: list[Any], function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
    from joblib import Parallel, delayed, parallel_config

    limit = parallel_config("loky", inner_max_num_threads=1, initializer=start_worker, initargs=(os.getpid(),))
    options: dict[str, Any] = {"pre_dispatch": JOBS_PER_WORKER * count, "batch_size": 1, "max_nbytes": None}
    resource_tracker.ensure_running()  # Python unblocks SIGINT when it starts this process, so it is started before
    with limit, _sigint_blocked():  # workers inherit the block: Ctrl-C ends them through this process
        pool = Parallel(count, return_as="generator_unordered", **options)
        begun.append(pool(delayed(_run_job)(function, job) for job in jobs))
    return begun[-1]


def _run_job(function: Callable[[Any], Any], job: Any) -> Any:
    """Run a job; an unforeseen exception becomes an InternalError with one line that names the job by its str()."""
    try:
        return function(job)
    except Kit1000Error:
        raise
    except Exception as error:
        raise internal_error(str(job), error) from error


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_worker(parent: int) -> None:
    """Set up a worker process: it uses one thread, and ends when the process with the id `parent` is gone."""
    from joblib.externals.loky import process_executor

    os.environ.update({name: os.environ.get(name, value) for name, value in ONE_THREAD_ENV.items()})
    process_executor._MAX_MEMORY_LEAK_SIZE = sys.maxsize  # 0.3 GB of cached parts and kits are no leak of memory

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_EVERY)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def ray_engine(address: str | None = None, workers: int | None = None) -> Iterator[ParallelMap]:
    """Run jobs on a Ray cluster, one processor for each job; all nodes must share the folder that the jobs write to.

    Args:
        address: of a running cluster ("host:6379", "auto"), which receives this version of kit1000; None: a Ray on
            this machine, shut down afterwards.
        workers: number of jobs that run at once; None: as many as there are processors.

    Raises:
        InputError: Ray is not installed, or there is no cluster at the address.
        Kit1000Error: a worker or its node is lost.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # prevents a deprecation warning
    try:
        import ray
    except ImportError:
        raise InputError("--engine ray: needs Ray: pip install 'kit1000[ray]'") from None
    with keeping_sigterm():  # Ray replaces it; an ended run still cleans up
        _connect(ray, address, workers)
    try:
        yield partial(_map_on_ray, ray, workers if address else None)
    finally:
        ray.shutdown()  # ends jobs of this run that are still running


def _connect(ray: Any, address: str | None, workers: int | None) -> None:
    """Connect to a cluster, or start a local Ray."""
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False, "include_dashboard": False}
    if address is None:
        variables = ONE_THREAD_ENV | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        resources = {"num_cpus": workers or usable_cores(), "object_store_memory": OBJECT_STORE_BYTES}
        ray.init("local", runtime_env={"env_vars": variables}, **resources, **quiet)
        return
    _check_reachable(address)
    environment = {"env_vars": ONE_THREAD_ENV, "py_modules": [str(Path(__file__).parent)], "excludes": ["__pycache__"]}
    try:
        ray.init(address, runtime_env=environment, **quiet)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"--address {address}: cannot join that Ray cluster: {_first_line(error)}") from error


def _check_reachable(address: str) -> None:
    """Raise InputError when an address is a host and a port without a listening server: Ray would try for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon and port.isdigit():
        try:
            socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT_S).close()
        except (OSError, OverflowError) as error:
            raise InputError(f"--address {address}: no Ray cluster there ({error})") from error


def _map_on_ray(ray: Any, at_once: int | None, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
    task = ray.remote(num_cpus=1, max_retries=0)(_run_on_node)
    folder, queue = os.getcwd(), iter(jobs)
    pending: dict[Any, Any] = {}  # jobs by the reference to their result
    while True:
        processors = max(1, int(ray.cluster_resources().get("CPU", 0)))  # a cluster may grow and shrink
        for job in islice(queue, (at_once or JOBS_PER_WORKER * processors) - len(pending)):
            pending[task.remote(folder, function, job)] = job
        if not pending:
            return
        for reference in ray.wait(list(pending), num_returns=1)[0]:
            yield _result(ray, reference, pending.pop(reference))


def _run_on_node(folder: str, function: Callable[[Any], Any], job: Any) -> Any:
    """Run a job in the driver's working directory, if the node has it, so that relative paths mean the same."""
    with suppress(OSError):
        os.chdir(folder)
    return _run_job(function, job)


def _result(ray: Any, reference: Any, job: Any) -> Any:
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, Kit1000Error):
            raise error.cause from error
        reason = _first_line(error.cause).removeprefix("System error: ")  # the job could not be unpickled there
        raise InputError(f"{job}: {reason} on a node: install the same Python and packages there as here") from error
    except ray.exceptions.RayError as error:
        raise Kit1000Error(f"{job}: its worker or node was lost: {_first_line(error)}; {CONTINUES}") from error


def _first_line(error: BaseException) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
