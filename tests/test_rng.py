"""Random streams: addresses, independence, and golden numbers that published data depends on."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.errors import InputError
from kit1000.rng import stream

TEXTS = st.text(min_size=1, max_size=8)  # the CRC-32 of an empty text is 0
KEYS = st.lists(st.one_of(st.integers(0, 2**32 - 1), TEXTS), max_size=4).map(tuple)
ROOTS = st.integers(0, 2**128 - 1)


def first(root: int, *key: int | str) -> list[int]:
    """The first four words of a stream."""
    return stream(root, *key).integers(0, 2**64, 4, dtype=np.uint64).tolist()


@given(ROOTS, KEYS, ROOTS, KEYS)
def test_other_addresses_give_other_streams(root: int, key: tuple, other_root: int, other_key: tuple) -> None:
    if (root, key) != (other_root, other_key):
        assert first(root, *key) != first(other_root, *other_key)


def test_addresses_that_could_be_confused_differ() -> None:
    # A prefix, a longer path of zeros, another grouping, another order, a number and its text.
    keys = [(), (0,), (0, 0), (1,), (1, 0), (0, 1), (1, 2), (12,), ("1",), ("1", "2"), ("12",), ("part", 1)]
    assert len({tuple(first(7, *key)) for key in keys}) == len(keys)


def test_a_root_of_several_words_does_not_overlap_the_key() -> None:
    assert first(1 + 5 * 2**32) != first(1, 5)
    assert first(2**127) != first(0)


@pytest.mark.parametrize("root", [2**64, 2**100 + 5, 2**127, 2**128 - 1])
def test_a_long_root_is_hashed_with_its_key(root: int) -> None:
    digest = hashlib.sha256(root.to_bytes(16, "little") + (17).to_bytes(4, "little")).digest()
    generator = np.random.PCG64(np.random.SeedSequence(int.from_bytes(digest[:16], "little")))
    assert first(root, 17) == np.random.Generator(generator).integers(0, 2**64, 4, dtype=np.uint64).tolist()


@pytest.mark.parametrize("root", [0, 7, 2**64 - 1])
def test_a_short_root_is_used_as_it_is(root: int) -> None:
    generator = np.random.PCG64(np.random.SeedSequence(root, spawn_key=(17,)))
    assert first(root, 17) == np.random.Generator(generator).integers(0, 2**64, 4, dtype=np.uint64).tolist()


def test_streams_do_not_depend_on_the_order_or_number_of_calls() -> None:
    forward = {i: first(3, "part", i) for i in range(20)}
    backward = {i: first(3, "part", i) for i in reversed(range(20))}
    alone = first(3, "part", 13)
    assert forward == backward
    assert alone == forward[13]


def test_drawing_from_one_stream_changes_no_other() -> None:
    busy, quiet = stream(3, "a"), stream(3, "b")
    busy.random(1000)
    assert quiet.integers(0, 2**64, 4, dtype=np.uint64).tolist() == first(3, "b")


def test_sibling_streams_are_uncorrelated() -> None:
    draws = np.stack([stream(0, "part", i).standard_normal(4000) for i in range(12)])
    correlation = np.corrcoef(draws) - np.eye(12)
    assert np.abs(correlation).max() < 5 / np.sqrt(4000)  # five standard deviations over 66 pairs


def test_strings_give_the_same_stream_in_another_process() -> None:
    # Python's own hash of a string changes from run to run; the stream must not.
    code = "from kit1000.rng import stream; print(stream(5, 'scene', 3, 'Schlüssel').integers(0, 2**63))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert int(shown) == stream(5, "scene", 3, "Schlüssel").integers(0, 2**63)


@pytest.mark.parametrize("root", [-1, 2**128, 1.0, "7", None])
def test_a_bad_root_is_rejected_by_name(root: object) -> None:
    with pytest.raises(InputError, match="root seed: expected"):
        stream(root)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("entry", [-1, 2**32, 0.5, None, b"part"])
def test_a_bad_key_is_rejected_by_name(entry: object) -> None:
    with pytest.raises(InputError, match="stream key: expected"):
        stream(0, "part", entry)  # pyright: ignore[reportArgumentType]


def test_numpy_integers_are_valid_keys() -> None:
    assert first(int(np.int64(4)), np.uint8(7)) == first(4, 7)  # pyright: ignore[reportArgumentType]


# Golden numbers: every draw of a plan comes from these four distributions, and numpy does not promise
# them across versions. A change here means other datasets from the same seed.
# History: 2026-11-20 first values, PCG64, numpy 2.4.


def test_golden_draws() -> None:
    def draws() -> np.random.Generator:
        return stream(1000, "golden", 1)

    uniform = [0.03609893144775437, 0.046695882812459275, 0.043699688062390066, 0.035680362380992224]
    assert draws().uniform(0.035, 0.05, 4).tolist() == uniform
    assert draws().integers(0, 1000, 8).tolist() == [576, 73, 824, 779, 224, 579, 52, 45]
    assert draws().permutation(10).tolist() == [8, 6, 1, 0, 2, 9, 7, 3, 4, 5]
    normal = [-0.9852759747389681, 0.07983978096822668, 0.2613011037887008, -0.41895135179537846]
    assert draws().normal(0.0, 1.0, 4).tolist() == normal
