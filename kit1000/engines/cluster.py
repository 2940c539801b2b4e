"""Jobs on a Ray cluster, or on a local Ray that runs as long as the jobs.

Ray transfers jobs and their small results. Jobs write files themselves, so all nodes must share one folder: a shared
disk, or an object store (see `kit1000.files.parse_folder`).
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from kit1000.engines.cores import usable_cores
from kit1000.engines.jobs import JOBS_PER_WORKER, ONE_THREAD_ENV, RETRIES, ParallelMap, run_job
from kit1000.errors import InputError, Kit1000Error, internal_error
from kit1000.interrupts import keeping_sigterm

CONNECT_TIMEOUT_S = 5.0  # of a cluster; Ray itself tries for minutes
OBJECT_STORE_BYTES = 100 << 20  # shared memory of a local Ray: it holds small results, Ray's minimum is 75 MiB


@contextmanager
def ray_engine(address: str | None = None, workers: int | None = None) -> Iterator[ParallelMap]:
    """Run jobs on a Ray cluster, one processor for each job.

    Args:
        address: of a running cluster ("host:6379", "auto"), which receives this version of kit1000; None: a Ray on
            this machine, shut down afterwards.
        workers: number of jobs that run at once; None: as many as there are processors.
    """
    library = _library()
    with keeping_sigterm():  # Ray replaces it; an ended run still cleans up
        _connect(library, address, workers)
    try:
        yield partial(_map, library, workers if address else None)
    finally:
        library.shutdown()  # ends jobs of this run that are still running


def _library() -> Any:
    """The module `ray`, which reads its environment when it is imported."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # prevents a deprecation warning
    try:
        import ray as library
    except ImportError:
        raise InputError("--engine ray: needs Ray: pip install 'kit1000[ray]'") from None
    return library


def _connect(library: Any, address: str | None, workers: int | None) -> None:
    """Connect to a cluster, or start a local Ray."""
    quiet_options = {"logging_level": logging.ERROR, "log_to_driver": False, "include_dashboard": False}
    environment: dict[str, Any] = {"env_vars": ONE_THREAD_ENV}
    if address is None:
        environment["env_vars"] = ONE_THREAD_ENV | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        resources = {"num_cpus": workers or usable_cores(), "object_store_memory": OBJECT_STORE_BYTES}
        library.init("local", runtime_env=environment, **resources, **quiet_options)
        return
    _check_reachable(address)
    package = Path(__file__).parents[1]
    environment |= {"py_modules": [str(package)], "excludes": ["__pycache__"]}
    try:
        library.init(address, runtime_env=environment, **quiet_options)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"--address {address}: cannot join that Ray cluster: {_first_line(error)}") from error


def _check_reachable(address: str) -> None:
    """Raise InputError when an address is a host and a port without a listening server."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not (colon and port.isdigit()):
        return  # "auto" and the like
    try:
        socket.create_connection((host, int(port)), timeout=CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise InputError(f"--address {address}: no Ray cluster there ({error})") from error


def _map(library: Any, at_once: int | None, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
    task = library.remote(num_cpus=1, max_retries=RETRIES)(_run_on_node)
    working_directory = os.getcwd()
    queue = iter(jobs)
    pending: dict[Any, Any] = {}  # jobs by the reference to their result
    while True:
        for job in islice(queue, (at_once or JOBS_PER_WORKER * _processors(library)) - len(pending)):
            pending[task.remote(working_directory, function, job)] = job
        if not pending:
            return
        for reference in library.wait(list(pending), num_returns=1)[0]:
            yield _result(library, reference, pending.pop(reference))


def _run_on_node(folder: str, function: Callable[[Any], Any], job: Any) -> Any:
    """Run a job in the driver's working directory, if the node has it, so that relative paths mean the same."""
    with suppress(OSError):
        os.chdir(folder)
    return run_job(function, job)


def _processors(library: Any) -> int:
    """Number of processors of the cluster at this moment: it may grow and shrink."""
    return max(1, int(library.cluster_resources().get("CPU", 0)))


def _result(library: Any, reference: Any, job: Any) -> Any:
    try:
        return library.get(reference)
    except library.exceptions.RayTaskError as error:
        raise _node_error(library, job, error.cause) from error
    except library.exceptions.RuntimeEnvSetupError as error:
        raise Kit1000Error(f"{job}: a node could not receive kit1000: {_first_line(error)}") from error
    except library.exceptions.RayError as error:
        raise Kit1000Error(
            f"{job}: its worker died {RETRIES + 1} times (killed, out of memory, or the node was lost: "
            f"{_first_line(error)}); run the same command again, it continues"
        ) from error


def _node_error(library: Any, job: Any, cause: BaseException) -> Kit1000Error:
    """The error of a job on a node, as one for the user."""
    if isinstance(cause, Kit1000Error):
        return cause
    if isinstance(cause, (ImportError, library.exceptions.RaySystemError)):  # the job could not be unpickled there
        reason = _first_line(cause).removeprefix("System error: ")
        return InputError(f"{job}: {reason} on a node: install the same Python and packages there as here")
    return internal_error(str(job), cause)


def _first_line(error: BaseException) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
