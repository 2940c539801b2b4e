"""Bounds of the work of a query, counted and not timed: the same query gives the same answer on any machine.

The unit is a search for a part of up to 50 mm; that for a larger one takes more with the volume about it. No bound is
reached by parts of up to 80 mm among five: images of a user may show dozens of bodies, some of them half a metre long.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kit1000.perception.observed.parts import HALF_WIDTH

LARGEST = 0.1  # [m] from the middle of a part to its sides; larger ones are not searched
TRIES = 160.0  # units of all candidates of a part that are refined
OTHERS = 16.0  # units of the searches for other parts of an image


def work_of(half_width: float) -> float:
    """The units that a search for a part takes. half_width: [m] from its middle to its sides."""
    return max(half_width / HALF_WIDTH, 1.0) ** 3


def tries_of(half_width: float, least: int, most: int) -> int:
    """How many candidates of a part are refined: TRIES units, and no fewer than the least, no more than the most."""
    return max(least, min(most, int(TRIES / work_of(half_width))))


def affordable(half_widths: Mapping[int, float], like: float) -> list[int]:
    """The parts that OTHERS units are spent on, in their order; where these are not all, those most like a size.

    Args:
        half_widths: [m] of each part, by index.
        like: [m] that of the part that is asked about: a part of its size is a rival for its cavity.
    """
    chosen: list[int] = []
    left = OTHERS
    for part in sorted(half_widths, key=lambda part: (round(abs(np.log(half_widths[part] / like)), 9), part)):
        work = work_of(half_widths[part])
        if half_widths[part] <= LARGEST and work <= left:
            chosen.append(part)
            left -= work
    return sorted(chosen)
