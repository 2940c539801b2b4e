"""Crowding and footprints: parts slide together to the drawn gaps and never overlap."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import CrossSection, FillRule
from scipy.spatial import ConvexHull

from kit1000.errors import Redraw
from kit1000.rng import stream
from kit1000.sim.crowding import GAPS, STOP, TOUCHING, draw_crowding, pushed_together
from kit1000.sim.footprints import centroid, footprint_distance

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


def square(side: float, at: tuple[float, float], yaw: float = 0.0) -> np.ndarray:
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * side / 2
    rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return corners @ rotation.T + at


def test_distances_of_squares_are_those_in_closed_form() -> None:
    a = square(2, (0, 0))
    assert footprint_distance(a, square(2, (5, 0.5))) == pytest.approx(3)  # edge to edge
    assert footprint_distance(a, square(2, (5, 6))) == pytest.approx(5)  # corner to corner: 3, 4, 5
    assert footprint_distance(a, square(2, (4, 0), np.pi / 4)) == pytest.approx(3 - 2**0.5)  # corner to edge
    assert footprint_distance(a, square(2, (1.5, 1.5))) == 0
    assert footprint_distance(a, square(0.5, (0, 0))) == 0  # one within the other


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20)
def test_distances_agree_with_dense_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    outlines = []
    for k in range(2):
        points = rng.uniform(-1, 1, (8, 2)) + (rng.uniform(0, 4) * k, rng.uniform(-1, 1) * k)
        outlines.append(points[ConvexHull(points).vertices])
    a, b = outlines
    share = np.linspace(0, 1, 100)[:, None, None]
    dense = [(o + share * (np.roll(o, -1, axis=0) - o)).reshape(-1, 2) for o in (a, b)]
    nearest = min(np.linalg.norm(dense[1] - point, axis=1).min() for point in dense[0])
    overlap = (CrossSection([a], FillRule.NonZero) ^ CrossSection([b], FillRule.NonZero)).area()
    expected = 0.0 if overlap > 1e-9 else nearest
    assert footprint_distance(a, b) == pytest.approx(expected, abs=0.03)
    assert footprint_distance(a, b) == pytest.approx(footprint_distance(b, a), abs=1e-12)


@given(width=st.floats(0.1, 10), at=st.tuples(st.floats(-5, 5), st.floats(-5, 5)), yaw=st.floats(0, 6))
def test_the_centre_of_a_square_is_its_middle(width: float, at: tuple[float, float], yaw: float) -> None:
    assert centroid(square(width, at, yaw)) == pytest.approx(at, abs=1e-9)


@given(seed=st.integers(0, 1000), share=st.floats(0.01, 0.99))
def test_a_vertex_on_a_straight_edge_moves_no_centre(seed: int, share: float) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (8, 2))
    outline = points[ConvexHull(points).vertices]
    for k in range(len(outline)):
        between = outline[k - 1] + share * (outline[k] - outline[k - 1])
        assert centroid(np.insert(outline, k, between, axis=0)) == pytest.approx(centroid(outline), abs=1e-9)
    assert (ConvexHull(outline).equations @ [*centroid(outline), 1] < 0).all()  # within
