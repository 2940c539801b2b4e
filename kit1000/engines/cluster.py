"""Jobs on a Ray cluster, or on a Ray that is started here for the time of the run.

Ray carries jobs and their small records; files are written by the jobs themselves, so all nodes must see one folder:
a shared disk, or an object store (see `kit1000.files.folder`).
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from kit1000.engines.cores import cores
from kit1000.engines.jobs import AHEAD, ONE_THREAD, RETRIES, Spread, named
from kit1000.errors import InputError, Kit1000Error, internal_error

ANSWER_S = 5.0  # to wait for a cluster to answer; Ray itself tries for minutes
STORE_BYTES = 100 << 20  # of shared memory for a Ray of our own: it carries records, Ray's least is 75 MiB


@contextmanager
def ray(address: str | None = None, workers: int | None = None) -> Iterator[Spread]:
    """Spread jobs over a Ray cluster, a processor for each job.

    address: of a running cluster ("host:6379", "auto"), to whose nodes this version of kit1000 is sent along; None =
        a Ray on this machine, shut down afterwards.
    workers: jobs that run at once; None = as many as there are processors.
    """
    library = _library()
    with _sigterm_kept():
        _join(library, address, workers)
    try:
        yield partial(_spread, library, workers if address else None)
    finally:
        library.shutdown()  # jobs of this run that are still at work go with it


def _library() -> Any:
    """The package Ray, which reads its environment when it is imported."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else it warns of a change to come
    try:
        import ray as library
    except ImportError:
        raise InputError("--engine ray: needs Ray: pip install 'kit1000[ray]'") from None
    return library


def _join(library: Any, address: str | None, workers: int | None) -> None:
    """Connect to a cluster, or start a Ray here."""
    quiet = {"logging_level": logging.ERROR, "log_to_driver": False, "include_dashboard": False}
    environment: dict[str, Any] = {"env_vars": ONE_THREAD}
    if address is None:
        environment["env_vars"] = ONE_THREAD | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        own = {"num_cpus": workers or cores(), "object_store_memory": STORE_BYTES}
        library.init("local", runtime_env=environment, **own, **quiet)
        return
    _check_answers(address)
    package = Path(__file__).parents[2]
    environment |= {"py_modules": [str(package)], "excludes": ["__pycache__"]}
    try:
        library.init(address, runtime_env=environment, **quiet)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"--address {address}: cannot join that Ray cluster: {_first_line(error)}") from error


def _check_answers(address: str) -> None:
    """Raise InputError when an address names a host and a port where nobody listens."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not (colon and port.isdigit()):
        return  # "auto" and the like
    try:
        socket.create_connection((host, int(port)), timeout=ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise InputError(f"--address {address}: no Ray cluster answers there ({error})") from error


def _spread(library: Any, at_once: int | None, function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
    task = library.remote(num_cpus=1, max_retries=RETRIES)(_on_node)
    here = os.getcwd()
    queue = iter(jobs)
    pending: dict[Any, Any] = {}  # jobs by the reference to their result
    while True:
        for job in islice(queue, (at_once or AHEAD * _processors(library)) - len(pending)):
            pending[task.remote(here, function, job)] = job
        if not pending:
            return
        for reference in library.wait(list(pending), num_returns=1)[0]:
            yield _result(library, reference, pending.pop(reference))


def _on_node(folder: str, function: Callable[[Any], Any], job: Any) -> Any:
    """Do a job where relative paths mean what they mean to the driver, if the node has that folder at all."""
    with suppress(OSError):
        os.chdir(folder)
    return named(function, job)


def _processors(library: Any) -> int:
    """Processors of the cluster as it is now: it may grow and shrink."""
    return max(1, int(library.cluster_resources().get("CPU", 0)))


def _result(library: Any, reference: Any, job: Any) -> Any:
    try:
        return library.get(reference)
    except library.exceptions.RayTaskError as error:
        raise _told(library, job, error.cause) from error
    except library.exceptions.RuntimeEnvSetupError as error:
        raise Kit1000Error(f"{job}: a node could not take kit1000 from here: {_first_line(error)}") from error
    except library.exceptions.RayError as error:
        raise Kit1000Error(
            f"{job}: its worker died {RETRIES + 1} times (killed, out of memory, or the node was lost: "
            f"{_first_line(error)}); run the same command again, it continues"
        ) from error


def _told(library: Any, job: Any, cause: BaseException) -> Kit1000Error:
    """What went wrong on a node."""
    if isinstance(cause, Kit1000Error):
        return cause
    if isinstance(cause, (ImportError, library.exceptions.RaySystemError)):  # the job could not even be read there
        lack = _first_line(cause).removeprefix("System error: ")
        return InputError(f"{job}: {lack} on a node: install there what kit1000 needs, the same Python and packages")
    return internal_error(str(job), cause)


def _first_line(error: BaseException) -> str:
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)


@contextmanager
def _sigterm_kept() -> Iterator[None]:
    """Ray takes SIGTERM for itself: give it back, so that a run that is ended goes down in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
