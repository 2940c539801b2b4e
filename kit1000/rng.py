"""Random streams: one generator per key, independent of each other and of the order in which they are used.

A stream is addressed by the root seed of a dataset and a key such as `("part", 17)`. Adding or omitting a stream, or
using streams in another order, changes no other stream.
"""

from __future__ import annotations

import hashlib
import zlib
from operator import index

import numpy as np

from kit1000.errors import InputError

# numpy pads the root to four 32-bit words and gives each key one word: larger numbers would extend into the next word
# and could collide with another key.
ROOT_LIMIT = 2**128
KEY_LIMIT = 2**32
HASHED_ROOT = 2**64
"""From here on no draw reveals the root."""
MIN_SECRET_ROOT = 2**127
"""The smallest root that may be secret: a number of 128 bits. Smaller ones could be found by trial."""


def stream(root: int, *key: int | str) -> np.random.Generator:
    """The generator at this address; the same address gives the same numbers on every machine.

    Args:
        root: seed of the whole dataset, 0 <= root < 2**128; at least MIN_SECRET_ROOT if it is secret.
        key: path of the stream, each entry an int in 0 .. 2**32 - 1 or a string, which is replaced by its CRC-32.

    Returns:
        A PCG64 generator at its start. Each call returns a new generator with the same numbers.
    """
    words = tuple(_word(entry) for entry in key)
    number = _number("root seed", root, ROOT_LIMIT)
    if number < HASHED_ROOT:
        seed = np.random.SeedSequence(number, spawn_key=words)
    else:  # neither SeedSequence nor PCG64 is one-way: enough published draws could reveal the root
        address = b"".join(word.to_bytes(4, "little") for word in words)
        digest = hashlib.sha256(number.to_bytes(16, "little") + address).digest()
        seed = np.random.SeedSequence(int.from_bytes(digest[:16], "little"))
    # PCG64 is explicit, because numpy may change the generator of default_rng().
    return np.random.Generator(np.random.PCG64(seed))


def _word(entry: int | str) -> int:
    """One entry of a key as a 32-bit number; CRC-32 because Python's own hash differs between runs."""
    if isinstance(entry, str):
        return zlib.crc32(entry.encode("utf-8"))
    return _number("stream key", entry, KEY_LIMIT)


def _number(name: str, value: int, limit: int) -> int:
    """The value as an int, checked to be in 0 .. limit - 1."""
    try:
        number = index(value)
    except TypeError:
        raise InputError(f"{name}: expected a whole number, got {value!r}") from None
    if not 0 <= number < limit:
        raise InputError(f"{name}: expected 0 <= number < 2**{limit.bit_length() - 1}, got {number}")
    return number
