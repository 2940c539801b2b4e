"""Tests of the volume cache: values have the precision of the encoding, and damaged files are made again."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kit1000.dataset import volume_cache as cache_module
from kit1000.dataset.volume_cache import CacheSize, Entry, Key, VolumeCache
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.voxels import Grid, Volume, from_float16, from_uint8, to_float16, to_uint8

STEPS = {"uint8": 1 / 127, "float16": 2**-12}  # by how much a value may be off
WRONG_NAME = ("", "..", "a/b", "/a", ".hidden", "a b", "a\n")


def some_key(item: str = "test-s0007-p2-snap.kit", **recipe: object) -> Key:
    return Key("abc123", "test-s0007", item, {"source": "depth", "shape": [5, 6, 7], **recipe})


def some_volume(seed: int = 0, shape: tuple[int, int, int] = (5, 6, 7)) -> Volume:
    """Random values, a tenth of them unknown, on a grid with numbers that need full precision."""
    rng = np.random.default_rng(seed)
    values = rng.uniform(-1, 1, shape)
    values[rng.random(shape) < 0.1] = np.nan
    return Volume(Grid(shape, 1e-3 / 3, Pose.exp(rng.normal(size=6))), values)


def must_not_be_called() -> Volume:
    raise AssertionError("made again")


@pytest.mark.parametrize("encoding", ["uint8", "float16"])
def test_a_volume_read_back_has_the_precision_of_its_encoding(tmp_path: Path, encoding: str) -> None:
    cache, volume = VolumeCache(tmp_path, encoding), some_volume()
    to, back = {"uint8": (to_uint8, from_uint8), "float16": (to_float16, from_float16)}[encoding]
    first = cache.volume(some_key(), lambda: volume)
    again = VolumeCache(tmp_path, encoding).volume(some_key(), must_not_be_called)
    wanted = back(volume.grid, to(volume))
    for found in (first, again):
        assert found.grid == volume.grid  # to the last bit
        assert np.array_equal(found.values, wanted.values, equal_nan=True)
        assert np.array_equal(found.known, volume.known)
        assert np.array_equal(found.occupied, volume.occupied)
        assert np.abs(found.values - volume.values)[volume.known].max() <= STEPS[encoding]


def test_an_entry_opens_in_numpy_and_costs_a_byte_a_voxel(tmp_path: Path) -> None:
    for encoding, to in (("uint8", to_uint8), ("float16", to_float16)):
        cache, volume = VolumeCache(tmp_path, encoding), some_volume(shape=(40, 41, 42))
        cache.volume(some_key(), lambda: volume)  # noqa: B023
        path = cache.path(some_key())
        for mode in (None, "r"):
            assert np.array_equal(np.load(path, mmap_mode=mode), to(volume), equal_nan=encoding == "float16")
        assert 0 < path.stat().st_size - to(volume).nbytes < 1000


def test_different_keys_have_different_files(tmp_path: Path) -> None:
    caches = [VolumeCache(tmp_path, encoding) for encoding in STEPS]
    keys = [
        some_key(),
        some_key("test-s0007-p2-snap.part"),
        some_key(voxel=1e-3),
        some_key(voxel=1.0000000000000002e-3),
        some_key()._replace(scene_id="test-s0008"),
        some_key()._replace(dataset_id="abc124"),
    ]
    paths = {cache.path(key) for cache in caches for key in keys}
    assert len(paths) == len(caches) * len(keys)
    for seed, key in enumerate(keys):
        caches[0].volume(key, lambda: some_volume(seed))  # noqa: B023
    for seed, key in enumerate(keys):
        assert caches[0].volume(key, must_not_be_called).grid == some_volume(seed).grid


def test_the_order_in_a_recipe_does_not_matter(tmp_path: Path) -> None:
    cache = VolumeCache(tmp_path)
    forward, back = {"a": 1, "b": (2, 3)}, {"b": [2, 3], "a": 1}
    cache.volume(some_key()._replace(recipe=forward), some_volume)
    assert cache.volume(some_key()._replace(recipe=back), must_not_be_called).grid == some_volume().grid


def test_entries_of_another_version_are_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = VolumeCache(tmp_path)
    cache.volume(some_key(), some_volume)
    monkeypatch.setattr(cache_module, "__version__", "99.0.0")
    assert cache.volume(some_key(), lambda: some_volume(1)).grid == some_volume(1).grid
    assert cache.size().volumes == 2


def truncate(data: bytes) -> bytes:
    return data[: len(data) // 2]


def flip_bit(data: bytes) -> bytes:
    return data[:200] + bytes([data[200] ^ 1]) + data[201:]


def empty(data: bytes) -> bytes:
    return b""


def short(data: bytes) -> bytes:
    return data[-3:]


def random_bytes(data: bytes) -> bytes:
    return np.random.default_rng(0).bytes(len(data))


@pytest.mark.parametrize("damage", [truncate, flip_bit, empty, short, random_bytes], ids=lambda f: f.__name__)
def test_a_damaged_entry_is_made_again(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    cache = VolumeCache(tmp_path)
    cache.volume(some_key(), some_volume)
    path = cache.path(some_key())
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert cache.volume(some_key(), some_volume).grid == some_volume().grid
    assert path.read_bytes() == whole


@given(at=st.integers(-40, 10_000), bit=st.integers(0, 7))  # from -40: the lengths and the checksum at the end
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
def test_every_flipped_bit_is_detected(tmp_path: Path, at: int, bit: int) -> None:
    cache = VolumeCache(tmp_path)
    cache.volume(some_key(), some_volume)
    path = cache.path(some_key())
    whole = path.read_bytes()
    data = bytearray(whole)
    data[at % len(data)] ^= 1 << bit
    path.write_bytes(data)
    cache.volume(some_key(), some_volume)
    assert path.read_bytes() == whole


def test_an_entry_under_another_name_is_made_again(tmp_path: Path) -> None:
    cache, other = VolumeCache(tmp_path), some_key("other")
    cache.volume(some_key(), some_volume)
    os.replace(cache.path(some_key()), cache.path(other))
    assert cache.volume(other, lambda: some_volume(1)).grid == some_volume(1).grid


def test_codes_are_memory_mapped_and_writing_to_them_does_not_change_the_file(tmp_path: Path) -> None:
    cache = VolumeCache(tmp_path)
    entry = cache.entry(some_key(), some_volume)
    assert isinstance(entry, Entry)
    assert np.array_equal(entry.codes, to_uint8(some_volume()))
    assert _maps(entry.codes)
    before = cache.path(some_key()).read_bytes()
    entry.codes[:] = 7
    assert cache.path(some_key()).read_bytes() == before
    assert np.array_equal(cache.entry(some_key(), must_not_be_called).codes, to_uint8(some_volume()))


def _maps(array: np.ndarray) -> bool:
    """Whether an array is memory-mapped."""
    owner = array
    while isinstance(owner.base, np.ndarray):
        owner = owner.base
    return isinstance(owner, np.memmap)


def test_a_volume_in_use_outlives_its_file(tmp_path: Path) -> None:
    cache = VolumeCache(tmp_path)
    entry = cache.entry(some_key(), some_volume)
    cache.clear()
    assert np.array_equal(entry.codes, to_uint8(some_volume()))


def test_the_size_is_that_of_the_files(tmp_path: Path) -> None:
    cache = VolumeCache(tmp_path / "cache")
    assert cache.size() == (0, 0)
    for item in "abc":
        cache.volume(some_key(item), some_volume)
    assert cache.size() == (3, sum(path.stat().st_size for path in tmp_path.rglob("*.npy")))
    assert str(CacheSize(1200, 314_600_000)) == "1,200 volumes, 314.6 MB"


def test_clearing_deletes_volumes_and_nothing_else(tmp_path: Path) -> None:
    cache = VolumeCache(tmp_path)
    cache.volume(some_key(), some_volume)
    others = [tmp_path / "notes.npy", tmp_path / "abc123/notes.txt", tmp_path / "a/b/c/d.npy"]
    for path in others:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    cache.clear()
    assert cache.size() == (0, 0)
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(others)
    assert not (tmp_path / "abc123/test-s0007").exists()


def test_a_volume_that_cannot_be_made_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="made again"):
        VolumeCache(tmp_path).volume(some_key(), must_not_be_called)
    assert list(tmp_path.iterdir()) == []


def _fill(root: Path) -> list[bytes]:
    """Thirty volumes as read by a process while others may write them."""
    cache = VolumeCache(root)
    keys = [some_key(f"item-{i % 10}") for i in range(30)]
    found = [cache.volume(key, lambda: some_volume(int(key.item[5:]))) for key in keys]  # noqa: B023
    return [volume.values.tobytes() for volume in found]


def test_processes_share_a_folder(tmp_path: Path) -> None:
    with get_context("spawn").Pool(2) as pool:
        first, second = pool.map(_fill, [tmp_path] * 2, chunksize=1)
    assert first == second
    assert VolumeCache(tmp_path).size().volumes == 10
    assert not list(tmp_path.rglob("*.partial"))


def test_a_cache_can_be_sent_to_another_process(tmp_path: Path) -> None:
    cache = pickle.loads(pickle.dumps(VolumeCache(tmp_path, "float16")))
    assert (cache.root, cache.encoding) == (tmp_path, "float16")


def test_invalid_arguments_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="encoding 'int4': expected one of uint8, float16"):
        VolumeCache(tmp_path, "int4")
    with pytest.raises(InputError, match="memory-mapped, so it needs a folder of this machine"):
        VolumeCache("memory://cache")
    for name in WRONG_NAME:
        with pytest.raises(InputError, match="not usable in a file name"):
            VolumeCache(tmp_path).path(some_key(name))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cannot (read|write)"):
        VolumeCache(tmp_path / "file").volume(some_key(), some_volume)
