"""Random streams: one generator for each named place that draws, independent of the order of the draws.

A stream is addressed by the root seed of a dataset and a key such as `("part", 17)`. Adding a place,
leaving one out, or visiting them in another order changes no other stream.
"""

from __future__ import annotations

import hashlib
import zlib
from operator import index

import numpy as np

from kit1000.errors import InputError

# numpy pads the root to four 32-bit words and gives each key one word: larger numbers would spill
# into the next word and could meet another key.
ROOT_LIMIT = 2**128
KEY_LIMIT = 2**32
MIN_SECRET_ROOT = 2**64
"""A root below can be found by trying; from here on it may be a secret, and no draw tells it."""


def stream(root: int, *key: int | str) -> np.random.Generator:
    """Return the generator at this address; the same address gives the same numbers everywhere.

    Args:
        root: seed of the whole dataset, 0 <= root < 2**128; a secret one from GUESSABLE up.
        key: path of the stream, each entry an int in 0 .. 2**32 - 1 or a string, which enters by its CRC-32.

    Returns:
        A PCG64 generator at its start. Two calls return two generators with equal numbers to come.
    """
    words = tuple(_word(entry) for entry in key)
    number = _number("root seed", root, ROOT_LIMIT)
    if number < MIN_SECRET_ROOT:
        seed = np.random.SeedSequence(number, spawn_key=words)
    else:  # neither SeedSequence nor PCG64 is one-way: from enough published draws a root could be worked out
        address = b"".join(word.to_bytes(4, "little") for word in words)
        digest = hashlib.sha256(number.to_bytes(16, "little") + address).digest()
        seed = np.random.SeedSequence(int.from_bytes(digest[:16], "little"))
    # Named outright, because numpy reserves the right to change what default_rng() makes.
    return np.random.Generator(np.random.PCG64(seed))


def _word(entry: int | str) -> int:
    """One entry of a key as a 32-bit number; CRC-32 because Python's own hash differs between runs."""
    if isinstance(entry, str):
        return zlib.crc32(entry.encode("utf-8"))
    return _number("stream key", entry, KEY_LIMIT)


def _number(name: str, value: int, limit: int) -> int:
    """Return the value as an int in 0 .. limit - 1."""
    try:
        number = index(value)
    except TypeError:
        raise InputError(f"{name}: expected a whole number, got {value!r}") from None
    if not 0 <= number < limit:
        raise InputError(f"{name}: expected 0 <= number < 2**{limit.bit_length() - 1}, got {number}")
    return number
