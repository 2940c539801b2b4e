"""Recordings are read in part: only what is asked for, once, by several processes and threads."""

from __future__ import annotations

import os
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from kit1000.dataset.mcap_io import ObservationFile, reading
from tests.samples.recorded import BIG, observation, write


@pytest.fixture
def large(tmp_path: Path) -> Path:
    return write(tmp_path / "large.mcap", [observation(k, BIG) for k in range(5)])


@pytest.fixture
def bytes_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The sizes of all later reads from files."""
    sizes: list[int] = []
    plain = os.pread

    def pread(descriptor: int, size: int, offset: int) -> bytes:
        sizes.append(size)
        return plain(descriptor, size, offset)

    monkeypatch.setattr(os, "pread", pread)
    return sizes


def test_queries_are_read_without_the_images(large: Path, bytes_read: list[int]) -> None:
    file = ObservationFile(large)
    assert len(file.scene_ids) == 5
    assert sum(bytes_read) < 100_000
    bytes_read.clear()
    assert [row["part"] for row in file.queries("test-s0003")] == [0, 1, 2]
    assert sum(bytes_read) < large.stat().st_size / 5 / 4


def test_the_images_of_a_scene_are_read_once(large: Path, bytes_read: list[int]) -> None:
    file = ObservationFile(large)
    file.view("test-s0002", "ideal")
    file.view("test-s0002", "d415")
    whole = sum(bytes_read)
    file.observation("test-s0002")
    file.view("test-s0002", "ideal")
    assert sum(bytes_read) == whole
    assert whole < 1.3 * large.stat().st_size / 5


def test_images_stay_valid_when_their_chunk_leaves_the_cache(large: Path, tmp_path: Path) -> None:
    file = ObservationFile(large)
    depths = {scene_id: file.view(scene_id).depth for scene_id in file.scene_ids}
    other = ObservationFile(Path(shutil.copy(large, tmp_path / "other.mcap")))
    assert len([other.view(scene_id) for scene_id in other.scene_ids]) > reading.RECENT
    for k in range(5):
        assert depths[f"test-s{k:04d}"].tobytes() == observation(k, BIG).views["ideal"].depth.tobytes()


def test_a_file_can_be_used_in_other_processes_and_threads(large: Path) -> None:
    file = ObservationFile(large)
    wanted = file.view("test-s0001").depth.tobytes()
    copy = pickle.loads(pickle.dumps(file))
    assert copy.view("test-s0001").depth.tobytes() == wanted
    child = os.fork()
    if child == 0:
        os._exit(0 if file.view("test-s0001", "d415").depth.any() and file.queries("test-s0004") else 1)
    file.view("test-s0003", "d415")
    assert os.waitpid(child, 0)[1] == 0
    with ThreadPoolExecutor(4) as threads:
        k = [i % 5 for i in range(40)]
        found = list(threads.map(lambda i: file.view(f"test-s{i:04d}", "d415").depth.tobytes(), k))
    assert found == [observation(i, BIG).views["d415"].depth.tobytes() for i in k]
