"""Runs many independent jobs, in processes of this machine or on a Ray cluster, with the same results.

An engine is a context manager that returns a `ParallelMap`: like `map`, it takes a function and jobs, and yields
results in the order in which they finish. The first error of a job stops the run; a job whose worker dies is run again.
"""

from __future__ import annotations

from contextlib import AbstractContextManager

from kit1000.engines.cluster import ray_engine
from kit1000.engines.jobs import JOBS_PER_WORKER, RETRIES, ParallelMap
from kit1000.engines.main_guard import check_main_guard
from kit1000.engines.processes import local_engine
from kit1000.errors import InputError

__all__ = [
    "ENGINES",
    "JOBS_PER_WORKER",
    "RETRIES",
    "ParallelMap",
    "check_main_guard",
    "engine",
    "local_engine",
    "ray_engine",
]

ENGINES = ("local", "ray")


def engine(name: str, workers: int | None = None, address: str | None = None) -> AbstractContextManager[ParallelMap]:
    """The engine of the options `--engine`, `--workers` and `--address`. Raises InputError when they do not fit."""
    if name not in ENGINES:
        raise InputError(f"--engine: expected {' or '.join(ENGINES)}, got {name!r}")
    if name == "ray":
        return ray_engine(address, workers)
    if address is not None:
        raise InputError("--address: is that of a Ray cluster and needs --engine ray")
    return local_engine(workers)
