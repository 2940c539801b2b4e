"""Laws of running jobs: all results, any number of workers, the first error stops the run and says where."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kit1000.data.engines import AHEAD, cores, local
from kit1000.errors import Fault, InputError, Kit1000Error

ROOT = Path(__file__).resolve().parents[1]
WORKERS = pytest.mark.parametrize("workers", [1, 2])


def square(x: int) -> int:
    return x * x


def stumble(x: int) -> int:
    if x == 3:
        raise ValueError("two\nlines")
    if x < 0:
        raise InputError("disk full")
    return x


def die(x: int) -> int:
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def nap(_: int) -> int:
    time.sleep(60)
    return os.getpid()


def counted(taken: list[int], n: int) -> Iterator[int]:
    for i in range(n):
        taken.append(i)
        yield i


@WORKERS
@pytest.mark.parametrize("jobs", [0, 1, 50])
def test_every_job_has_its_result(workers: int, jobs: int) -> None:
    with local(workers) as spread:
        assert sorted(spread(square, range(jobs))) == [x * x for x in range(jobs)]


def test_workers_serve_one_batch_after_another() -> None:
    with local(2) as spread:
        assert sorted(spread(square, range(3))) == [0, 1, 4]
        assert sorted(spread(square, range(3))) == [0, 1, 4]


@WORKERS
def test_an_unforeseen_error_stops_the_run_and_names_the_job_in_one_line(workers: int) -> None:
    taken: list[int] = []
    with pytest.raises(Fault) as caught, local(workers) as spread:
        list(spread(stumble, counted(taken, 1000)))
    assert str(caught.value).startswith("3: ValueError: two lines")
    assert len(taken) < 100


@WORKERS
def test_our_own_errors_come_through_as_they_are(workers: int) -> None:
    with pytest.raises(InputError, match=r"^disk full$"), local(workers) as spread:
        list(spread(stumble, [-1]))


def test_few_jobs_are_handed_out_ahead() -> None:
    taken: list[int] = []
    with local(2) as spread:
        next(iter(spread(square, counted(taken, 1000))))
        assert len(taken) <= 2 * AHEAD


def test_a_killed_worker_gives_one_line_that_names_the_suspects() -> None:
    with pytest.raises(Kit1000Error) as caught, local(2) as spread:
        list(spread(die, [3]))
    assert str(caught.value).startswith("a worker process died (killed, or out of memory), probably at one of: 3; run")
    assert "\n" not in str(caught.value)


def test_all_cores_are_used_unless_asked_otherwise() -> None:
    assert cores() == len(os.sched_getaffinity(0))


ORPHANS = """
import sys, test_engines
from kit1000.data.engines import local
if __name__ == "__main__":
    with local(2) as spread:
        print(*spread(test_engines.process_id, range(8)), flush=True)
        list(spread(test_engines.nap, range(8)))
"""


def process_id(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def gone(pid: int) -> bool:
    """Whether a process has ended; one that only waits to be buried has."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    stat = Path(f"/proc/{pid}/stat")  # where there is one; other systems bury at once
    return stat.exists() and stat.read_text().rsplit(")", 1)[1].split()[0] == "Z"


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_workers_go_with_the_process_that_started_them(how: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "orphans.py"
    script.write_text(ORPHANS)
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    command = [sys.executable, str(script)]
    run = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path}
    )
    assert run.stdout is not None
    pids = {int(word) for word in run.stdout.readline().split()}
    assert len(pids) == 2
    run.send_signal(how)
    run.communicate(timeout=20)
    deadline = time.monotonic() + 10
    while not all(map(gone, pids)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert all(map(gone, pids))
