"""Tests of jobs on a Ray cluster of two nodes: the bytes of one process, errors that name their job."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from kit1000.errors import InputError, InternalError, Kit1000Error
from kit1000.generation.build import generate
from kit1000.parallel import JOBS_PER_WORKER, ParallelMap, ray_engine
from tests.samples.checkout import ROOT
from tests.samples.jobs import all_end, fail_at_three, kill_own_process, signalled, square
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


def worker_environment(name: str) -> tuple[str, str, str, str]:
    """Node, path of kit1000, absolute path of a relative one, and thread limit of a worker."""
    import kit1000

    time.sleep(0.3)  # longer than a job takes to reach the other node
    return node_id(), str(kit1000.__file__), str(Path(name).resolve()), os.environ["NUMBA_NUM_THREADS"]


def with_node(function: Callable[[Any], Any], job: Any) -> tuple[str, Any]:
    """The id of the node of a job, and its result."""
    return node_id(), function(job)


@contextmanager
def engine_with_nodes(address: str, nodes: list[str]) -> Iterator[ParallelMap]:
    """The engine; appends the node of every result to a list."""
    with ray_engine(address) as parallel_map:

        def spread(function: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
            for place, result in parallel_map(partial(with_node, function), jobs):
                nodes.append(place)
                yield result

        yield spread


def test_two_nodes_share_the_work_and_write_the_bytes_of_one_process(address: str, tmp_path: Path) -> None:
    sources = l_shape_sources(tmp_path / "files")
    generate(MINI, tmp_path / "alone", workers=1, sources=sources)
    nodes: list[str] = []
    generate(MINI, tmp_path / "out", sources=sources, engine=engine_with_nodes(address, nodes))
    assert file_hashes(tmp_path / "out") == file_hashes(tmp_path / "alone")
    assert len(set(nodes)) == 2


def test_a_node_runs_this_version_in_the_drivers_folder(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with ray_engine(address) as parallel_map:
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

    with ray_engine(address) as parallel_map:
        assert list(parallel_map(square, [])) == []
        results = parallel_map(square, jobs())
        first = next(results)
        assert len(submitted) <= 2 * JOBS_PER_WORKER
        assert sorted([first, *results]) == [x * x for x in range(200)]
    with ray_engine(address, workers=1) as parallel_map:
        submitted.clear()
        next(parallel_map(square, jobs()))
        assert len(submitted) == 1


@pytest.mark.parametrize(
    ("function", "job", "kind", "facts"),
    [
        (fail_at_three, 3, InternalError, ("3: ValueError: two lines (",)),
        (fail_at_three, -1, InputError, ("disk full",)),
        (kill_own_process, 3, Kit1000Error, ("3: ", "lost", "run the same command again")),
    ],
)
def test_an_error_stops_the_run_in_one_line(
    address: str, function: Callable[[int], int], job: int, kind: type[Exception], facts: tuple[str, ...]
) -> None:
    with pytest.raises(kind) as caught, ray_engine(address) as parallel_map:
        list(parallel_map(function, [job, 5, 6]))
    assert all(fact in str(caught.value) for fact in facts)
    assert "\n" not in str(caught.value)


def test_a_module_missing_on_a_node_is_named(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "unheard_of.py").write_text("def job(x): return x")
    monkeypatch.syspath_prepend(str(tmp_path))
    import unheard_of  # pyright: ignore[reportMissingImports]

    with pytest.raises(InputError) as caught, ray_engine(address) as parallel_map:
        list(parallel_map(unheard_of.job, [7]))
    assert all(fact in str(caught.value) for fact in ("7: ", "'unheard_of'", "on a node"))


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere.invalid:6379", "nonsense"])
def test_an_address_without_a_cluster_is_one_line(address: str) -> None:
    with pytest.raises(InputError, match=f"^--address {address}: .*$") as caught, ray_engine(address):
        pass
    assert "\n" not in str(caught.value)


ALONE = """
import sys
from kit1000.parallel import ray_engine
from tests.samples import jobs
with ray_engine(workers=2) as spread:
    print(*spread(jobs.process_id, [sys.argv[1]] * 2), flush=True)
    list(spread(jobs.sleep, range(8)))
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_local_ray_ends_with_the_process_that_started_it(number: signal.Signals, tmp_path: Path) -> None:
    ids = signalled(ALONE, tmp_path, number)
    assert ids
    assert all_end(ids, 60)


def test_the_handler_of_sigterm_is_restored() -> None:
    def handler(*_: object) -> None: ...

    before = signal.signal(signal.SIGTERM, handler)
    try:
        with ray_engine(workers=1) as parallel_map:
            assert signal.getsignal(signal.SIGTERM) is handler
            assert list(parallel_map(square, [3])) == [9]
    finally:
        signal.signal(signal.SIGTERM, before)
