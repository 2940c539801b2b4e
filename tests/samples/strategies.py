"""Hypothesis strategies for directions, rotations and poses, often where formulas break.

Half of the angles lie within 1e-12 .. 1e-3 rad of the identity or of a half turn.
"""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from kit1000.pose import Pose

AXES = list(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 1, 0], [1, 1, 1]], dtype=float))


def numbers(limit: float) -> st.SearchStrategy[float]:
    """Floats in -limit .. limit, none so small that its square vanishes."""
    return st.floats(-limit, limit).map(lambda x: 0.0 if abs(x) < 1e-100 else x)


def vectors(limit: float = 1.0) -> st.SearchStrategy[np.ndarray]:
    """Vectors (3,) with entries in -limit .. limit."""
    return st.lists(numbers(limit), min_size=3, max_size=3).map(np.array)


@st.composite
def directions(draw: st.DrawFn) -> np.ndarray:
    """Unit vectors (3,), the coordinate axes among them."""
    any_way = vectors().filter(lambda v: float(np.linalg.norm(v)) > 1e-3)
    v = draw(st.one_of(st.sampled_from(AXES), any_way))
    return v / np.linalg.norm(v)


@st.composite
def small_angles(draw: st.DrawFn) -> float:
    """Angles of 1e-12 .. 1e-3 rad, evenly over the powers of ten."""
    return 10.0 ** draw(st.floats(-12, -3))


@st.composite
def angles(draw: st.DrawFn) -> float:
    """Angles of 0 .. pi rad, often next to either end."""
    near_pi = small_angles().map(lambda a: np.pi - a)
    return draw(st.one_of(st.floats(0, np.pi), st.sampled_from([0.0, np.pi / 2]), small_angles(), near_pi))


@st.composite
def rotvecs(draw: st.DrawFn) -> np.ndarray:
    """Rotation vectors (3,) [rad] of length up to pi, often near zero or near pi."""
    return draw(directions()) * draw(angles())


def quaternions() -> st.SearchStrategy[np.ndarray]:
    """Unit quaternions (4,) of either sign."""
    signed = st.tuples(rotvecs(), st.sampled_from([1.0, -1.0]))
    return signed.map(lambda pair: pair[1] * Pose.from_rotvec(pair[0]).wxyz)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    """Single poses with positions of up to 2 m an axis."""
    return Pose(draw(quaternions()), draw(vectors(2.0)))


@st.composite
def pose_batches(draw: st.DrawFn, size: int) -> Pose:
    """Batches of `size` poses."""
    return Pose.stack([draw(poses()) for _ in range(size)])
