"""What all engines have in common: the form of a spread, how a job is called, how often a lost one is tried again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from kit1000.errors import Kit1000Error, internal_error

Job = TypeVar("Job")
Result = TypeVar("Result")

Spread = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

AHEAD = 4  # jobs handed out per worker before results are taken: keeps workers fed and memory flat
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: there are as many of them as cores, and their threads would be in each other's way."""
RETRIES = 2  # times that a job whose worker died is done again: by the third death it is to blame itself


def named(function: Callable[[Job], Result], job: Job) -> Result:
    """Do a job; an exception that nobody foresaw becomes one line that names it by its str()."""
    try:
        return function(job)
    except Kit1000Error:
        raise
    except Exception as error:
        raise internal_error(str(job), error) from error
