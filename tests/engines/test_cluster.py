"""Tests of the Ray engine on a cluster of two nodes: the same bytes, lost jobs run again, errors name jobs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from kit1000 import engines, files
from kit1000.engines import JOBS_PER_WORKER, RETRIES, ParallelMap
from kit1000.errors import InputError, InternalError, Kit1000Error
from kit1000.generation.build import generate
from tests.samples.checkout import ROOT
from tests.samples.jobs import fail_at_three, kill_own_process, square
from tests.samples.mini import MINI, file_hashes, l_shape_sources

pytest.importorskip("ray", reason="an engine that is asked for: pip install 'kit1000[ray]'")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # Ray leaves the logs of its processes open
]
STORE = 100 << 20  # bytes of shared memory a node


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A cluster of two nodes with one processor each, whose workers find the functions of this file.

    Its working directory is not that of the tests, as on a real cluster.
    """
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.chdir("/")
        head = {"num_cpus": 1, "object_store_memory": STORE, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=head)
        cluster.add_node(num_cpus=1, object_store_memory=STORE)
    yield str(cluster.address)
    cluster.shutdown()


def node_id() -> str:
    import ray

    return ray.get_runtime_context().get_node_id()


def kill_first_attempts(job: tuple[int, str]) -> int:
    """The first attempt at every third job kills its process by a signal, or exits."""
    number, folder = job
    attempts = sorted(Path(folder).glob(f"{number}-*"))
    (Path(folder) / f"{number}-{len(attempts)}").touch()
    if number % 3 == 0 and not attempts:
        os.kill(os.getpid(), signal.SIGKILL) if number % 2 else os._exit(1)
    return number


def worker_environment(name: str) -> tuple[str, str, str, str]:
    """Node, path of kit1000, absolute path of a relative one, and thread limit of a worker."""
    import kit1000

    time.sleep(0.3)  # longer than a job takes to reach the other node
    return node_id(), str(kit1000.__file__), str(Path(name).resolve()), os.environ["NUMBA_NUM_THREADS"]


def process_id(_: int) -> int:
    return os.getpid()


def sleep_and_return_id(_: int) -> None:
    time.sleep(60)


def with_node(function: Callable[[Any], Any], job: Any) -> tuple[str, Any]:
    """The id of the node of a job, and its result."""
    return node_id(), function(job)


@contextmanager
def ray_engine_with_nodes(address: str, nodes: list[str]) -> Iterator[ParallelMap]:
    """The engine; appends the node of every result to a list."""
    with engines.ray_engine(address) as parallel_map:

        def parallel_map_with_nodes(function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
            for place, result in parallel_map(partial(with_node, function), jobs):
                nodes.append(place)
                yield result

        yield parallel_map_with_nodes


@pytest.mark.parametrize("url", [False, True])
def test_two_nodes_share_the_work_and_write_the_bytes_of_one_process(url: bool, address: str, tmp_path: Path) -> None:
    sources = l_shape_sources(tmp_path / "files")
    generate(MINI, tmp_path / "alone", workers=1, sources=sources)
    out = files.parse_folder(f"local://{tmp_path}/out") if url else tmp_path / "out"
    nodes: list[str] = []
    generate(MINI, out, sources=sources, engine=ray_engine_with_nodes(address, nodes))
    assert file_hashes(tmp_path / "out") == file_hashes(tmp_path / "alone")
    assert len(set(nodes)) == 2


def test_a_node_runs_this_version_in_the_drivers_folder(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with engines.ray_engine(address) as parallel_map:
        nodes, packages, places, threads = zip(*parallel_map(worker_environment, ["out"] * 10), strict=True)
    assert len(set(nodes)) == 2
    assert not any(Path(package).is_relative_to(ROOT) for package in packages)
    assert set(places) == {str(tmp_path / "out")}
    assert set(threads) == {"1"}


def test_every_job_has_its_result_and_few_are_submitted_ahead(address: str) -> None:
    submitted: list[int] = []

    def jobs() -> Iterator[int]:
        for i in range(200):
            submitted.append(i)
            yield i

    with engines.ray_engine(address) as parallel_map:
        assert list(parallel_map(square, [])) == []
        results = parallel_map(square, jobs())
        first = next(results)
        assert len(submitted) <= 2 * JOBS_PER_WORKER
        assert sorted([first, *results]) == [x * x for x in range(200)]
    with engines.ray_engine(address, workers=1) as parallel_map:
        submitted.clear()
        next(parallel_map(square, jobs()))
        assert len(submitted) == 1


def test_jobs_of_killed_workers_are_run_again(address: str, tmp_path: Path) -> None:
    with engines.ray_engine(address) as parallel_map:
        assert sorted(parallel_map(kill_first_attempts, [(i, str(tmp_path)) for i in range(7)])) == list(range(7))
    assert [len(list(tmp_path.glob(f"{i}-*"))) for i in range(7)] == [2, 1, 1, 2, 1, 1, 2]


def test_a_job_that_kills_every_worker_is_named_in_one_line(address: str) -> None:
    with pytest.raises(Kit1000Error) as caught, engines.ray_engine(address) as parallel_map:
        list(parallel_map(kill_own_process, [3]))
    assert str(caught.value).startswith(f"3: its worker died {RETRIES + 1} times (killed, out of memory, or")
    assert "\n" not in str(caught.value)


def test_errors_stop_the_run_as_they_do_without_ray(address: str) -> None:
    with pytest.raises(InternalError) as caught, engines.ray_engine(address) as parallel_map:
        list(parallel_map(fail_at_three, range(1000)))
    assert str(caught.value).startswith("3: ValueError: two lines (")
    with pytest.raises(InputError, match=r"^disk full$"), engines.ray_engine(address) as parallel_map:
        list(parallel_map(fail_at_three, [-1]))


def test_a_module_missing_on_a_node_is_named(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "unheard_of.py").write_text("def job(x): return x")
    monkeypatch.syspath_prepend(str(tmp_path))
    import unheard_of  # pyright: ignore[reportMissingImports]

    with (
        pytest.raises(InputError, match=r"^7: No module named 'unheard_of' on a node: install.*$"),
        engines.ray_engine(address) as parallel_map,
    ):
        list(parallel_map(unheard_of.job, [7]))


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere.invalid:6379", "nonsense"])
def test_an_address_without_a_cluster_is_one_line(address: str) -> None:
    started = time.monotonic()
    with pytest.raises(InputError, match=f"^--address {address}: .*$") as caught, engines.ray_engine(address):
        pass
    assert "\n" not in str(caught.value)
    assert time.monotonic() - started < 30


ALONE = """
import sys
from tests.engines import test_cluster
from kit1000 import engines
if __name__ == "__main__":
    with engines.ray_engine(workers=2) as parallel_map:
        print(*{*parallel_map(test_cluster.process_id, range(8))}, flush=True)
        list(parallel_map(test_cluster.sleep_and_return_id, range(8)))
"""


def is_running(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.parametrize("signal_number", [signal.SIGKILL, signal.SIGINT])
def test_a_local_ray_ends_with_the_process_that_started_it(signal_number: signal.Signals, tmp_path: Path) -> None:
    script = tmp_path / "alone.py"
    script.write_text(ALONE)
    path = str(ROOT)
    run = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # tests run in the background ignore Ctrl-C
    )
    assert run.stdout is not None
    pids = {int(word) for word in run.stdout.readline().split()}
    assert pids
    run.send_signal(signal_number)
    run.communicate(timeout=60)
    deadline = time.monotonic() + 60
    while any(map(is_running, pids)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(map(is_running, pids))


def test_the_handler_of_sigterm_is_restored() -> None:
    def handler(*_: object) -> None: ...

    before = signal.signal(signal.SIGTERM, handler)
    try:
        with engines.ray_engine(workers=1) as parallel_map:
            assert signal.getsignal(signal.SIGTERM) is handler
            assert list(parallel_map(square, [3])) == [9]
    finally:
        signal.signal(signal.SIGTERM, before)
