"""Footprints: distances and centres are those in closed form, and those of dense points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import CrossSection, FillRule
from scipy.spatial import ConvexHull

from kit1000.sim.footprints import centroid, footprint_distance


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
