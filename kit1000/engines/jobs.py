"""What all engines share: the type of their map, the call of a job, and the number of retries of a lost job."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from kit1000.errors import Kit1000Error, internal_error

Job = TypeVar("Job")
Result = TypeVar("Result")

ParallelMap = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

JOBS_PER_WORKER = 4  # submitted at once: keeps workers busy and memory bounded
ONE_THREAD_ENV = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
"""Environment of a worker: there is one worker per core, so more threads would only compete."""
RETRIES = 2  # of a job whose worker died; at the third death the job itself is reported as the cause


def run_job(function: Callable[[Job], Result], job: Job) -> Result:
    """Run a job; an unforeseen exception becomes an InternalError with one line that names the job by its str()."""
    try:
        return function(job)
    except Kit1000Error:
        raise
    except Exception as error:
        raise internal_error(str(job), error) from error
