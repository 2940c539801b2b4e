"""Tests of jobs in processes: all results with any number of workers; the first error stops the run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from kit1000.errors import InputError, InternalError, Kit1000Error
from kit1000.parallel import JOBS_PER_WORKER, local_engine, ray_engine, usable_cores
from tests.samples.checkout import ROOT
from tests.samples.jobs import all_end, fail_at_three, kill_own_process, nap, signalled, square

HELD: list[np.ndarray] = []  # by the workers of a test
WORKERS = pytest.mark.parametrize("workers", [1, 2])


def recording_iterator(submitted: list[int], n: int) -> Iterator[int]:
    for i in range(n):
        submitted.append(i)
        yield i


@WORKERS
def test_every_job_of_every_batch_has_its_result(workers: int) -> None:
    with local_engine(workers) as parallel_map:
        for jobs in (0, 1, 50):
            assert sorted(parallel_map(square, range(jobs))) == [x * x for x in range(jobs)]


@WORKERS
def test_an_error_stops_the_run_and_an_unforeseen_one_names_its_job(workers: int) -> None:
    submitted: list[int] = []
    with pytest.raises(InternalError) as caught, local_engine(workers) as parallel_map:
        list(parallel_map(fail_at_three, recording_iterator(submitted, 1000)))
    assert str(caught.value).startswith("3: ValueError: two lines")
    assert len(submitted) < 100
    with pytest.raises(InputError, match=r"^disk full$"), local_engine(workers) as parallel_map:
        list(parallel_map(fail_at_three, [-1]))


def test_few_jobs_are_submitted_ahead_and_a_run_may_end_early() -> None:
    submitted: list[int] = []
    with local_engine(2) as parallel_map:
        next(iter(parallel_map(nap, recording_iterator(submitted, 1000))))
    assert len(submitted) < 10 * JOBS_PER_WORKER  # each job that ends meanwhile makes room for one more


def thread_limits(_: int) -> list[str | None]:
    return [os.environ.get(f"{name}_NUM_THREADS") for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")]


def grow(_: int) -> int:
    HELD.append(np.ones(45_000_000))  # 0.36 GB
    time.sleep(1.1)  # joblib measures once a second
    return os.getpid()


def test_a_worker_may_fill_its_caches(recwarn: pytest.WarningsRecorder) -> None:
    with local_engine(2) as parallel_map:
        assert len(set(parallel_map(grow, range(6)))) == 2
    assert not recwarn.list


def test_a_worker_has_one_thread() -> None:
    with local_engine(2) as parallel_map:
        assert list(parallel_map(thread_limits, [0])) == [["1"] * 4]


def test_a_dead_worker_ends_the_run_in_one_line_and_the_next_run_works() -> None:
    with pytest.raises(Kit1000Error) as caught, local_engine(2) as parallel_map:
        list(parallel_map(kill_own_process, range(20)))
    assert all(fact in str(caught.value) for fact in ("worker", "died", "run the same command again", "--workers"))
    assert "\n" not in str(caught.value)
    with local_engine(2) as parallel_map:
        assert list(parallel_map(square, [3])) == [9]


def test_a_script_needs_no_main_guard(tmp_path: Path) -> None:
    script = tmp_path / "mine.py"
    script.write_text(
        "from kit1000.parallel import local_engine\n"
        "def double(x): return 2 * x\n"
        "with local_engine(2) as spread:\n    print(sorted(spread(double, range(3))))\n"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False, env=environment)
    assert (done.stdout, done.stderr) == ("[0, 2, 4]\n", "")


def test_one_worker_needs_no_process_and_a_missing_ray_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert usable_cores() == len(os.sched_getaffinity(0))
    with local_engine(1) as parallel_map:
        assert list(parallel_map(square, [3])) == [9]
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"kit1000\[ray\]"), ray_engine():
        pass


ORPHANS = """
import sys
from kit1000.parallel import local_engine
from tests.samples import jobs
with local_engine(2) as spread:
    print(*spread(jobs.process_id, [sys.argv[1]] * 2), flush=True)
    list(spread(jobs.sleep, range(8)))
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_process_that_started_them(number: signal.Signals, tmp_path: Path) -> None:
    ids = signalled(ORPHANS, tmp_path, number)
    assert len(set(ids)) == 2
    assert all_end(ids, 20)
