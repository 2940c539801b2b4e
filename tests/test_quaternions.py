"""Quaternion algebra: products, angles, shortest rotations and uniform draws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from kit1000.errors import InputError, ShapeError
from kit1000.pose import (
    Pose,
    normalized_quaternion,
    quaternion_angle,
    quaternion_between,
    quaternion_conjugate,
    quaternion_from_rotvec,
    quaternion_multiply,
    random_quaternions,
    unit_vector,
)
from kit1000.rng import stream
from tests.samples.strategies import angles, directions, numbers, quaternions

# Rounding of a few products of numbers of size 1: about fifty units in the last place.
ROUNDING = 1e-14
laws = settings(max_examples=30)


@given(st.lists(numbers(1e6), min_size=4, max_size=4).map(np.array).filter(lambda q: np.abs(q).max() > 1e-9))
@laws
def test_quaternions_are_normalised_and_keep_their_sign(q: np.ndarray) -> None:
    unit = normalized_quaternion(q)
    assert abs(np.linalg.norm(unit) - 1) < 1e-15
    assert unit @ q > 0


@given(st.lists(numbers(3.0), min_size=4, max_size=4).map(np.array).filter(lambda q: np.abs(q).max() > 1e-9))
@laws
def test_normalising_twice_changes_no_bit(q: np.ndarray) -> None:
    once = normalized_quaternion(q)
    assert np.array_equal(normalized_quaternion(once), once)


@given(quaternions(), quaternions())
@laws
def test_products_agree_with_scipy(a: np.ndarray, b: np.ndarray) -> None:
    # Scipy has the scalar last.
    other = Rotation.from_quat(np.roll(a, -1)) * Rotation.from_quat(np.roll(b, -1))
    assert quaternion_angle(quaternion_multiply(a, b), np.roll(other.as_quat(), 1)) <= ROUNDING


@given(quaternions(), directions(), angles())
@laws
def test_quaternion_angle_is_the_geodesic_angle(q: np.ndarray, axis: np.ndarray, angle: float) -> None:
    turned = quaternion_multiply(q, quaternion_from_rotvec(axis * angle))
    assert quaternion_angle(q, turned) == pytest.approx(angle, abs=ROUNDING)
    assert quaternion_angle(-turned, q) == pytest.approx(angle, abs=ROUNDING)


@given(quaternions(), quaternions(), quaternions())
@laws
def test_quaternion_angle_is_a_metric_invariant_to_common_rotations(
    a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> None:
    ab, bc, ac = quaternion_angle(a, b), quaternion_angle(b, c), quaternion_angle(a, c)
    assert 0 <= ac <= ab + bc + ROUNDING
    assert ac <= np.pi
    moved = quaternion_angle(quaternion_multiply(c, a), quaternion_multiply(c, b))
    assert moved == pytest.approx(ab, abs=2 * ROUNDING)


@given(directions(), directions())
@laws
def test_quaternion_between_maps_u_to_v_by_the_shortest_rotation(u: np.ndarray, v: np.ndarray) -> None:
    turn = Pose(quaternion_between(3 * u, 0.1 * v), np.zeros(3))
    assert np.allclose(turn.rotate(u), v, rtol=0, atol=ROUNDING)
    straight = 2 * np.arctan2(np.linalg.norm(u - v), np.linalg.norm(u + v))
    assert turn.angle() == pytest.approx(straight, abs=ROUNDING)


@given(directions(), directions(), st.one_of(st.just(0.0), st.floats(-17, -3).map(lambda x: 10.0**x)))
@laws
def test_quaternion_between_is_accurate_near_equal_and_opposite(u: np.ndarray, side: np.ndarray, gap: float) -> None:
    for sign in (1.0, -1.0):
        v = unit_vector(sign * u + gap * side)
        turn = Pose(quaternion_between(u, v), np.zeros(3))
        assert abs(np.linalg.norm(turn.wxyz) - 1) < 1e-15
        assert np.allclose(turn.rotate(u), v, rtol=0, atol=ROUNDING)
        straight = 2 * np.arctan2(np.linalg.norm(u - v), np.linalg.norm(u + v))
        # Near opposite, the axis, and so the excess over the shortest rotation, depend on rounding alone.
        assert turn.angle() == pytest.approx(straight, abs=1e-11)


def test_quaternion_between_broadcasts_and_rejects_a_zero_vector() -> None:
    assert quaternion_between(np.eye(3), [0, 0, 1]).shape == (3, 4)
    assert quaternion_between(np.eye(3)[:, None], np.eye(3)).shape == (3, 3, 4)
    with pytest.raises(InputError, match="v: expected a direction"):
        quaternion_between([0, 0, 1], [0, 0, 0])
    with pytest.raises(ShapeError, match="u: expected leading axes"):
        quaternion_between(np.ones((2, 3)), np.ones((3, 3)))


def test_random_quaternions_are_uniform_over_rotations() -> None:
    q = random_quaternions(stream(11, "uniform"), 20000)
    # Haar measure: the angle has density (1 - cos t) / pi, and a rotated axis is uniform on the sphere.
    assert kstest(quaternion_angle(q, [1, 0, 0, 0]), lambda t: (t - np.sin(t)) / np.pi).pvalue > 1e-3
    images = Pose(q, np.zeros(3)).rotate([0.6, 0, 0.8])
    for k in range(3):
        assert kstest(images[:, k], lambda z: (1 + z) / 2).pvalue > 1e-3


@given(quaternions())
@laws
def test_conjugate_is_the_inverse_rotation(q: np.ndarray) -> None:
    assert quaternion_angle(quaternion_multiply(q, quaternion_conjugate(q)), [1, 0, 0, 0]) <= ROUNDING
