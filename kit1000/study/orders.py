"""Who meets which condition when, and on which tasks: exactly balanced, and fixed by the participant's number.

The rows of a square after Williams (1949) are the orders of the conditions: over its rows each condition stands once at
each position, and once right after each other one. All participants of a block (one a row) have the same set of tasks
at a position, so each condition meets each set once; over as many blocks as there are sets, each set stands equally
often at each position.
"""

from __future__ import annotations

from typing import NamedTuple

from kit1000.errors import InputError
from kit1000.rng import stream

MULTIPLE = 4  # of the number of participants


class Place(NamedTuple):
    """What one participant meets at one position."""

    condition: int
    """Index among the conditions."""
    task_set: int
    """Index among the sets of tasks; as many as conditions."""


def williams_square(n: int) -> list[list[int]]:
    """The n orders of an even number n of conditions."""
    if n < 2 or n % 2:
        raise InputError(f"expected an even number of conditions, got {n}")
    first = [0]
    for step in range(1, n):
        first.append((first[-1] + (step if step % 2 else -step)) % n)
    return [[(entry + row) % n for entry in first] for row in range(n)]


def orders(conditions: int, people: int, seed: int) -> list[tuple[Place, ...]]:
    """The places of each participant, the first participant first.

    Which number has which row is drawn within each block, so that nobody can guess it; later participants never change
    earlier ones.
    """
    if people < MULTIPLE or people % MULTIPLE:
        raise InputError(f"--people: expected a multiple of {MULTIPLE}, so that all orders are balanced, got {people}")
    square = williams_square(conditions)
    return [_places(square, seed, i) for i in range(people)]


def _places(square: list[list[int]], seed: int, index: int) -> tuple[Place, ...]:
    n = len(square)
    block, inside = divmod(index, n)
    cycle, turn = divmod(block, n)
    rows = stream(seed, "study-orders", block).permutation(n)
    shifts = stream(seed, "study-sets", cycle).permutation(n)
    row, shift = square[int(rows[inside])], int(shifts[turn])
    return tuple(Place(condition, (position + shift) % n) for position, condition in enumerate(row))
