"""Tests of engines: all results with any number of workers; the first error stops the run and names the job."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from kit1000.engines import JOBS_PER_WORKER, RETRIES, engine, local_engine
from kit1000.engines.cores import usable_cores
from kit1000.errors import InputError, InternalError, Kit1000Error
from tests.samples.checkout import ROOT
from tests.samples.jobs import fail_at_three, kill_own_process, square

WORKERS = pytest.mark.parametrize("workers", [1, 2])


def kill_first_attempts(job: tuple[int, Path]) -> int:
    """The first two attempts at every fifth job kill their process."""
    number, folder = job
    attempts = sorted(folder.glob(f"{number}-*"))
    (folder / f"{number}-{len(attempts)}").touch()
    if number % 5 == 2 and len(attempts) < RETRIES:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def sleep_and_return_id(_: int) -> int:
    time.sleep(60)
    return os.getpid()


def recording_iterator(submitted: list[int], n: int) -> Iterator[int]:
    for i in range(n):
        submitted.append(i)
        yield i


@WORKERS
@pytest.mark.parametrize("jobs", [0, 1, 50])
def test_every_job_has_its_result(workers: int, jobs: int) -> None:
    with local_engine(workers) as parallel_map:
        assert sorted(parallel_map(square, range(jobs))) == [x * x for x in range(jobs)]


def test_workers_serve_one_batch_after_another() -> None:
    with local_engine(2) as parallel_map:
        assert sorted(parallel_map(square, range(3))) == [0, 1, 4]
        assert sorted(parallel_map(square, range(3))) == [0, 1, 4]


@WORKERS
def test_an_unforeseen_error_stops_the_run_and_names_the_job_in_one_line(workers: int) -> None:
    submitted: list[int] = []
    with pytest.raises(InternalError) as caught, local_engine(workers) as parallel_map:
        list(parallel_map(fail_at_three, recording_iterator(submitted, 1000)))
    assert str(caught.value).startswith("3: ValueError: two lines")
    assert len(submitted) < 100


@WORKERS
def test_errors_of_the_package_are_raised_unchanged(workers: int) -> None:
    with pytest.raises(InputError, match=r"^disk full$"), local_engine(workers) as parallel_map:
        list(parallel_map(fail_at_three, [-1]))


def test_few_jobs_are_submitted_ahead() -> None:
    submitted: list[int] = []
    with local_engine(2) as parallel_map:
        next(iter(parallel_map(square, recording_iterator(submitted, 1000))))
        assert len(submitted) <= 2 * JOBS_PER_WORKER


def test_jobs_of_killed_workers_are_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with local_engine(2) as parallel_map:
        assert sorted(parallel_map(kill_first_attempts, [(i, tmp_path) for i in range(6)])) == list(range(6))
        assert sorted(parallel_map(square, range(3))) == [0, 1, 4]
    assert len(list(tmp_path.glob("2-*"))) == RETRIES + 1
    assert "a worker process died" in capsys.readouterr().err


def test_a_job_that_kills_every_worker_is_named_in_one_line() -> None:
    with pytest.raises(Kit1000Error) as caught, local_engine(2) as parallel_map:
        list(parallel_map(kill_own_process, [3]))
    assert str(caught.value).startswith(
        f"a worker process died {RETRIES + 1} times (killed, or out of memory), probably at one of: 3; run"
    )
    assert "\n" not in str(caught.value)


def test_results_before_a_death_are_kept_and_the_possible_causes_named() -> None:
    results: list[int] = []
    with (
        pytest.raises(Kit1000Error, match=r"probably at one of: (\d, )?3(, \d+)?; run"),
        local_engine(2) as parallel_map,
    ):
        results.extend(parallel_map(kill_own_process, range(20)))
    assert len(set(results)) == len(results)


def test_all_cores_are_used_unless_asked_otherwise() -> None:
    assert usable_cores() == len(os.sched_getaffinity(0))


def test_an_engine_is_chosen_by_name() -> None:
    with engine("local", workers=1) as parallel_map:
        assert list(parallel_map(square, [3])) == [9]
    with pytest.raises(InputError, match=r"--engine: expected local or ray, got 'spark'"):
        engine("spark")
    with pytest.raises(InputError, match="--address: is that of a Ray cluster and needs --engine ray"):
        engine("local", address="auto")


def test_without_ray_the_error_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"--engine ray: .*pip install 'kit1000\[ray\]'"), engine("ray"):
        pass


ORPHANS = """
import sys
from tests.engines import test_local
from kit1000.engines import local_engine
if __name__ == "__main__":
    with local_engine(2) as parallel_map:
        print(*parallel_map(test_local.process_id, [sys.argv[1]] * 2), flush=True)
        list(parallel_map(test_local.sleep_and_return_id, range(8)))
"""


def process_id(folder: str) -> int:
    """The id of this process, after a second process has started."""
    (Path(folder) / f"{os.getpid()}.pid").touch()
    deadline = time.monotonic() + 30
    while len(list(Path(folder).glob("*.pid"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    return os.getpid()


def has_ended(pid: int) -> bool:
    """Whether a process has ended, zombies included."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    stat = Path(f"/proc/{pid}/stat")  # only Linux has it, and there zombies are found
    return stat.exists() and stat.read_text().rsplit(")", 1)[1].split()[0] == "Z"


@pytest.mark.parametrize("signal_number", [signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_the_process_that_started_them(signal_number: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "orphans.py"
    script.write_text(ORPHANS)
    path = str(ROOT)
    command = [sys.executable, str(script), str(tmp_path)]
    run = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # tests run in the background ignore Ctrl-C
    )
    assert run.stdout is not None
    pids = {int(word) for word in run.stdout.readline().split()}
    assert len(pids) == 2
    run.send_signal(signal_number)
    run.communicate(timeout=20)
    deadline = time.monotonic() + 10
    while not all(map(has_ended, pids)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert all(map(has_ended, pids))
