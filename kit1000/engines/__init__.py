"""Running many independent jobs, in processes of this machine or on a Ray cluster: the results are the same.

An engine is a context manager that gives a `Spread`: like `map`, it takes a function and jobs, and yields results as
they come. The first error of a job stops the run and names it; a job whose worker dies is done again.
"""

from __future__ import annotations

from contextlib import AbstractContextManager

from kit1000.engines.cluster import ray
from kit1000.engines.jobs import AHEAD, RETRIES, Spread
from kit1000.engines.processes import local
from kit1000.errors import InputError

__all__ = ["AHEAD", "ENGINES", "RETRIES", "Spread", "engine", "local", "ray"]

ENGINES = ("local", "ray")


def engine(name: str, workers: int | None = None, address: str | None = None) -> AbstractContextManager[Spread]:
    """The engine that `--engine`, `--workers` and `--address` ask for. Raises InputError when they do not fit."""
    if name not in ENGINES:
        raise InputError(f"--engine: expected {' or '.join(ENGINES)}, got {name!r}")
    if name == "ray":
        return ray(address, workers)
    if address is not None:
        raise InputError("--address: names a Ray cluster, for --engine ray")
    return local(workers)
