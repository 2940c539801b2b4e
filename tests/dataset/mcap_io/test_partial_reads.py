"""Recordings are read in part: only what is asked for, once, by several processes and threads."""

from __future__ import annotations

import os
import pickle
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk

from kit1000.dataset.mcap_io import ObservationFile, reading, writing
from tests.samples.recorded import BIG, observation, same, write


@pytest.fixture
def large(tmp_path: Path) -> Path:
    return write(tmp_path / "large.mcap", [observation(k, BIG) for k in range(5)])


@pytest.fixture
def bytes_read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The compressed sizes of all chunks that are read later."""
    sizes: list[int] = []

    def breakup(chunk: Chunk, validate_crc: bool) -> list[McapRecord]:
        sizes.append(len(chunk.data))
        return breakup_chunk(chunk, validate_crc)

    monkeypatch.setattr(reading, "breakup_chunk", breakup)
    return sizes


def test_only_the_requested_messages_are_read(large: Path, bytes_read: list[int]) -> None:
    file, scene = ObservationFile(large), large.stat().st_size / 5
    assert len(file.scene_ids) == 5
    assert not bytes_read
    assert [row["part"] for row in file.queries("test-s0003")] == [0, 1, 2]
    assert sum(bytes_read) < scene / 100
    file.view("test-s0003", "ideal")
    assert sum(bytes_read) < 0.6 * scene
    file.view("test-s0003", "ideal")
    file.queries("test-s0003")
    assert len(bytes_read) == 2
    file.observation("test-s0003")
    assert sum(bytes_read) <= scene


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


def test_a_file_of_data_2_0_0_with_a_chunk_for_each_scene_is_read_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes = [observation(k) for k in range(3)]
    monkeypatch.setattr(writing, "LARGE", ())
    file = ObservationFile(write(tmp_path / "older.mcap", scenes))
    assert file.view_keys("test-s0001") == ("ideal", "d415")
    assert all(same(file.observation(scene.scene_id), scene) for scene in scenes)
