"""Parts pushed together: never into each other, each within the largest gap of another, all in their region."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from kit1000.errors import Redraw
from kit1000.rng import stream
from kit1000.sim.crowding import GAPS, STOP, TOUCHING, draw_crowding, pushed_together
from kit1000.sim.footprints import footprint_distance

REGION = np.array([[-0.19, -0.345], [0.19, -0.005]])


def outlines(seed: int, n: int) -> list[np.ndarray]:
    """Footprints of parts of 10 to 60 mm anywhere: round and square ones, slim ones, triangles."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(n):
        points = rng.standard_normal((rng.integers(3, 40), 2)) * rng.uniform(3e-3, 12e-3, 2)
        found.append(points[ConvexHull(points).vertices] + rng.uniform(-0.3, 0.3, 2))
    return found


@given(seed=st.integers(0, 100_000), n=st.integers(2, 5))
@settings(max_examples=60)
def test_parts_come_close_and_never_into_each_other(seed: int, n: int) -> None:
    apart, crowding = outlines(seed, n), draw_crowding(stream(seed), n)
    together = [o + shift for o, shift in zip(apart, pushed_together(apart, crowding, REGION), strict=True)]
    gaps = np.full((n, n), np.inf)
    for i, j in combinations(range(n), 2):
        gaps[i, j] = gaps[j, i] = footprint_distance(together[i], together[j])
    assert gaps.min() >= TOUCHING - 1e-9
    assert (gaps.min(0) <= GAPS[1] + STOP).all()
    for outline in together:
        assert ((outline >= REGION[0] - 1e-12) & (outline <= REGION[1] + 1e-12)).all()


@given(seed=st.integers(0, 100_000))
@settings(max_examples=40)
def test_of_two_parts_the_second_lies_at_its_gap_in_its_direction(seed: int) -> None:
    apart, crowding = outlines(seed, 2), draw_crowding(stream(seed), 2)
    a, b = (o + shift for o, shift in zip(apart, pushed_together(apart, crowding, REGION), strict=True))
    assert crowding.gaps[1] <= footprint_distance(a, b) <= crowding.gaps[1] + STOP
    back = b - 1e-3 * np.array([np.cos(crowding.directions[1]), np.sin(crowding.directions[1])])
    assert footprint_distance(a, back) < footprint_distance(a, b)


def test_where_the_parts_came_to_rest_does_not_matter() -> None:
    apart, crowding = outlines(1, 4), draw_crowding(stream(1), 4)
    moved = [o + (0.05 * k, -0.03 * k) for k, o in enumerate(apart)]
    for a, b, one, other in zip(
        apart, moved, pushed_together(apart, crowding, REGION), pushed_together(moved, crowding, REGION), strict=True
    ):
        assert a + one == pytest.approx(b + other, abs=1e-6)


def test_gaps_are_drawn_from_touching_to_the_largest() -> None:
    gaps = draw_crowding(stream(0), 20_000).gaps
    assert gaps.min() == TOUCHING
    assert gaps.max() == pytest.approx(GAPS[1], rel=1e-3)
    assert (gaps == TOUCHING).mean() == pytest.approx((TOUCHING - GAPS[0]) / (GAPS[1] - GAPS[0]), abs=0.01)


def test_a_group_larger_than_its_region_is_redrawn() -> None:
    with pytest.raises(Redraw, match=r"^no room for the parts together$"):
        pushed_together(outlines(0, 5), draw_crowding(stream(0), 5), REGION / 10)
