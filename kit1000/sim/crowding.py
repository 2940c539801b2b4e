"""Crowded scenes: parts at rest, pushed together along the table until they nearly or just touch.

A rest pose on a plane stays one wherever it is pushed to, and no part leans on another. Each part in turn slides
towards one that is in place already; it stops at a drawn gap from that part, or earlier if it touches another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kit1000.errors import Redraw
from kit1000.numerics.trigonometry import cosine, sine
from kit1000.sim.footprints import centroid, footprint_distance

TOUCHING = 1e-4  # [m] between footprints that touch: well over the micrometre to which poses are rounded
GAPS = (-2.5e-3, 10e-3)  # [m] uniform; smaller ones become TOUCHING: a fifth of the parts touch
MAX_ANGLE = np.pi / 4  # [rad] from the x axis, on which side the cameras are, to the direction from part to part
MAX_SHIFT = 0.05  # [m] along x and along y, of the group of parts from the middle of their half
STOP = 1e-5  # [m] from the place at which a sliding part would stop exactly
MAX_SLIDES = 500  # each at least STOP long, and nearly always as long as the way that is left


@dataclass(frozen=True, eq=False)
class Crowding:
    """The random numbers of a group of parts."""

    neighbours: np.ndarray
    """(n,) in 0..1: share of the parts already in place; the one there is slid to."""
    directions: np.ndarray
    """(n,) [rad] from the middle of that neighbour to the part."""
    gaps: np.ndarray
    """(n,) [m] between their footprints."""
    shift: np.ndarray
    """(2,) in -1..1: fraction of the largest shift that keeps the group within MAX_SHIFT and in its region."""


def draw_crowding(rng: np.random.Generator, n: int) -> Crowding:
    """The random numbers of a group of n parts."""
    neighbours, sides = rng.random(n), np.pi * rng.integers(2, size=n)
    directions = sides + rng.uniform(-MAX_ANGLE, MAX_ANGLE, n)
    return Crowding(neighbours, directions, np.maximum(rng.uniform(*GAPS, n), TOUCHING), rng.uniform(-1, 1, 2))


def pushed_together(outlines: Sequence[np.ndarray], crowding: Crowding, region: np.ndarray) -> np.ndarray:
    """(n, 2) [m] by which parts with these footprints (k, 2) move to form a group within a region.

    region: (2, 2) [m] lowest and highest corner. Raises Redraw when the group is larger than that.
    """
    placed: list[np.ndarray] = []
    for i, outline in enumerate(outlines):
        centred = outline - centroid(outline)
        if placed:
            neighbour = int(crowding.neighbours[i] * len(placed))
            centred = centred + _slide(placed, neighbour, centred, crowding.directions[i], crowding.gaps[i])
        placed.append(centred)
    group = np.concatenate(placed)
    low, high = group.min(0), group.max(0)
    room = (np.ptp(region, axis=0) - (high - low)) / 2
    if (room < 0).any():
        raise Redraw("no room for the parts together")
    middle = region.mean(0) + np.minimum(room, MAX_SHIFT) * crowding.shift - (low + high) / 2
    return np.array([there[0] + middle - outline[0] for there, outline in zip(placed, outlines, strict=True)])


def _slide(placed: list[np.ndarray], neighbour: int, outline: np.ndarray, direction: float, gap: float) -> np.ndarray:
    """The place at which an outline about the origin stops that slides towards the middle of a placed one, (2,) [m].

    A slide as long as the distance that is left never passes an obstacle.
    """
    gaps = [gap if k == neighbour else TOUCHING for k in range(len(placed))]
    middle, away = centroid(placed[neighbour]), np.array([cosine(direction), sine(direction)])
    reach = _radius(outline) + max(_radius(other - middle) for other in placed) + max(gaps)
    for _ in range(MAX_SLIDES):
        at = middle + reach * away
        left = min(footprint_distance(other, outline + at) - g for other, g in zip(placed, gaps, strict=True))
        if left < STOP:
            return at
        reach -= left
    raise Redraw("parts do not come together")


def _radius(outline: np.ndarray) -> float:
    """[m] the largest distance of an outline from the origin."""
    return float(np.sqrt((outline**2).sum(1).max()))
