"""Poses and quaternions: group axioms, round trips, batches, closed forms."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
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
from tests.samples.strategies import (
    angles,
    directions,
    numbers,
    pose_batches,
    poses,
    quaternions,
    small_angles,
    vectors,
)

# Rounding of a few products of numbers of size 1 to 4: about fifty units in the last place of 1.
ROUNDING = 1e-14


def assert_same(a: Pose, b: Pose, tolerance: float = ROUNDING) -> None:
    """The poses map every point to the same point, within `tolerance` [rad and m]."""
    assert np.all(quaternion_angle(a.wxyz, b.wxyz) <= tolerance)
    assert np.all(np.abs(a.xyz - b.xyz) <= tolerance)


def scipy_rotation(pose: Pose) -> Rotation:
    """The same rotation in scipy, whose quaternions have the scalar last."""
    return Rotation.from_quat(np.roll(pose.wxyz, -1, axis=-1))


# --- construction ---


def test_arrays_are_copied_and_read_only() -> None:
    wxyz, xyz = np.array([1.0, 0, 0, 0]), np.zeros(3)
    pose = Pose(wxyz, xyz)
    wxyz[:], xyz[:] = 5, 5
    assert pose.wxyz.tolist() == [1, 0, 0, 0]
    assert pose.xyz.tolist() == [0, 0, 0]
    for array in (pose.wxyz, pose.xyz, pose[None].wxyz, (pose @ pose).xyz):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1


@pytest.mark.parametrize("again", [lambda p: pickle.loads(pickle.dumps(p)), copy.copy, copy.deepcopy])
def test_copies_keep_every_bit_and_stay_read_only(again: Callable[[Pose], Pose]) -> None:
    pose = Pose(random_quaternions(stream(0), 5), stream(1).normal(size=(5, 3)))
    twin = again(pose)
    assert np.array_equal(twin.wxyz, pose.wxyz)
    assert np.array_equal(twin.xyz, pose.xyz)
    assert not twin.wxyz.flags.writeable
    assert not twin.xyz.flags.writeable


@pytest.mark.parametrize(
    ("wxyz", "xyz", "message"),
    [
        (np.ones(3), np.zeros(3), r"wxyz: expected float64 of shape \(\.\.\., 4\), got shape \(3,\)"),
        (np.ones(4), np.zeros((2, 2)), r"xyz: expected float64 of shape \(\.\.\., 3\), got shape \(2, 2\)"),
        (np.ones((2, 4)), np.zeros((3, 3)), r"xyz: expected leading axes that broadcast with those of wxyz"),
        (np.array([np.nan, 0, 0, 1]), np.zeros(3), r"wxyz: .* not finite"),
        (np.ones(4), np.array([0, np.inf, 0]), r"xyz: .* not finite"),
    ],
)
def test_bad_arrays_are_rejected_by_name(wxyz: np.ndarray, xyz: np.ndarray, message: str) -> None:
    with pytest.raises(ShapeError, match=message):
        Pose(wxyz, xyz)


@pytest.mark.parametrize("q", [[0.0, 0, 0, 0], [1e-200, 0, 0, 0], [1e200, 1e200, 0, 0]])
def test_a_quaternion_without_direction_is_rejected(q: list[float]) -> None:
    with pytest.raises(InputError, match="wxyz: expected unit quaternions"):
        Pose(np.array(q), np.zeros(3))


def test_leading_axes_of_rotation_and_position_broadcast() -> None:
    assert Pose(random_quaternions(stream(0), 4), np.zeros(3)).xyz.shape == (4, 3)
    assert Pose(np.array([1.0, 0, 0, 0]), np.zeros((2, 5, 3))).wxyz.shape == (2, 5, 4)
    assert Pose.identity((2, 3)).batch_shape == (2, 3)
    assert Pose.from_translation(np.ones((6, 3))).batch_shape == (6,)


# --- the group ---


@given(poses(), poses(), poses())
def test_composition_is_associative(a: Pose, b: Pose, c: Pose) -> None:
    assert_same((a @ b) @ c, a @ (b @ c), 4 * ROUNDING)


@given(poses())
def test_laws_of_identity_and_inverse(pose: Pose) -> None:
    one = Pose.identity()
    assert_same(one @ pose, pose)
    assert_same(pose @ one, pose)
    assert_same(pose @ pose.inverse(), one)
    assert_same(pose.inverse() @ pose, one)


@given(poses(), poses(), vectors(2.0))
def test_composition_applies_one_pose_after_the_other(a: Pose, b: Pose, point: np.ndarray) -> None:
    assert np.allclose((a @ b).apply(point), a.apply(b.apply(point)), rtol=0, atol=4 * ROUNDING)


@given(poses(), poses(), vectors(2.0))
def test_homogeneous_matrices_multiply_like_poses(a: Pose, b: Pose, point: np.ndarray) -> None:
    assert np.allclose((a @ b).matrix(), a.matrix() @ b.matrix(), rtol=0, atol=4 * ROUNDING)
    assert np.allclose((a.matrix() @ [*point, 1.0])[:3], a.apply(point), rtol=0, atol=ROUNDING)


@given(poses(), vectors(2.0), vectors(2.0))
def test_rotation_keeps_lengths_and_handedness(pose: Pose, u: np.ndarray, v: np.ndarray) -> None:
    turned_u, turned_v = pose.rotate(u), pose.rotate(v)
    assert turned_u @ turned_v == pytest.approx(u @ v, abs=4 * ROUNDING)
    assert np.allclose(np.cross(turned_u, turned_v), pose.rotate(np.cross(u, v)), rtol=0, atol=4 * ROUNDING)


def test_90_degrees_about_z_map_x_to_y() -> None:
    pose = Pose.from_rotvec([0, 0, np.pi / 2], [1, 2, 3])
    assert np.allclose(pose.apply([1, 0, 0]), [1, 3, 3], rtol=0, atol=ROUNDING)
    assert np.allclose(pose.wxyz, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], rtol=0, atol=ROUNDING)


# --- another implementation ---


@given(poses())
def test_matrices_and_rotation_vectors_agree_with_scipy(pose: Pose) -> None:
    other = scipy_rotation(pose)
    assert np.allclose(pose.rotation_matrix(), other.as_matrix(), rtol=0, atol=ROUNDING)
    assert quaternion_angle(pose.wxyz, np.roll(other.as_quat(), 1)) <= ROUNDING
    assert pose.angle() == pytest.approx(np.linalg.norm(other.as_rotvec()), abs=ROUNDING)


# --- round trips ---


@given(poses())
def test_round_trip_through_matrix_and_rotation_vector(pose: Pose) -> None:
    assert_same(Pose.from_matrix(pose.matrix()), pose)
    assert_same(Pose.from_rotation_matrix(pose.rotation_matrix(), pose.xyz), pose)
    assert_same(Pose.from_rotvec(pose.rotvec(), pose.xyz), pose)


@given(directions(), small_angles())
def test_small_angles_keep_their_relative_precision(axis: np.ndarray, angle: float) -> None:
    pose = Pose.from_rotvec(axis * angle)
    assert pose.angle() == pytest.approx(angle, rel=1e-14)
    assert np.allclose(pose.rotvec(), axis * angle, rtol=0, atol=1e-14 * angle)
    assert Pose.from_matrix(pose.matrix()).angle() == pytest.approx(angle, rel=1e-13)


@given(directions(), small_angles())
def test_angles_near_180_degrees_keep_their_difference_from_it(axis: np.ndarray, gap: float) -> None:
    pose = Pose.from_rotvec(axis * (np.pi - gap))
    assert np.pi - pose.angle() == pytest.approx(gap, abs=ROUNDING)
    assert np.linalg.norm(pose.rotvec()) <= np.pi
    over = Pose.from_rotvec(axis * (np.pi + gap))  # the shortest rotation is about the opposite axis
    assert np.allclose(over.rotvec(), -axis * (np.pi - gap), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-200, 1e-160])
def test_vanishing_rotation_vectors_give_the_identity_without_a_warning(size: float) -> None:
    pose = Pose.from_rotvec([size, 0, size])
    assert np.allclose(pose.rotvec(), [size, 0, size], rtol=1e-9, atol=0)


@given(quaternions())
def test_minus_q_is_the_same_rotation(q: np.ndarray) -> None:
    plus, minus = Pose(q, np.zeros(3)), Pose(-q, np.zeros(3))
    assert np.array_equal(plus.rotation_matrix(), minus.rotation_matrix())
    assert plus.angle() == minus.angle()
    # At exactly 180 degrees the axis may have either sign.
    assert np.allclose(plus.rotvec(), minus.rotvec()) or plus.angle() == pytest.approx(np.pi)
    assert quaternion_angle(q, -q) <= ROUNDING


@pytest.mark.parametrize(
    "matrix",
    [
        2 * np.eye(3),
        np.diag([1.0, 1.0, -1.0]),
        np.array([[1, 0.01, 0], [0, 1, 0], [0, 0, 1]]),
        np.zeros((3, 3)),
    ],
)
def test_matrices_that_are_no_rotation_are_rejected(matrix: np.ndarray) -> None:
    with pytest.raises(InputError, match="expected a rotation, got one that scales, shears or reflects"):
        Pose.from_rotation_matrix(matrix)


def test_a_transposed_homogeneous_matrix_is_rejected() -> None:
    with pytest.raises(InputError, match="last row 0 0 0 1"):
        Pose.from_matrix(Pose.from_translation([1, 2, 3]).matrix().T)


@given(poses())
def test_float32_matrices_are_accepted(pose: Pose) -> None:
    assert_same(Pose.from_matrix(pose.matrix().astype(np.float32)), pose, 1e-6)


# --- batches ---


@given(pose_batches(3), pose_batches(3), st.lists(vectors(2.0), min_size=3, max_size=3).map(np.array))
def test_a_batch_gives_bit_for_bit_the_results_of_its_members(a: Pose, b: Pose, points: np.ndarray) -> None:
    product, back, moved = a @ b, a.inverse(), a.apply(points)
    for i in range(3):
        assert np.array_equal(product[i].wxyz, (a[i] @ b[i]).wxyz)
        assert np.array_equal(product[i].xyz, (a[i] @ b[i]).xyz)
        assert np.array_equal(back[i].xyz, a[i].inverse().xyz)
        assert np.array_equal(moved[i], a[i].apply(points[i]))
        assert np.array_equal(a.angle()[i], a[i].angle())
        assert np.array_equal(Pose.from_matrix(a.matrix())[i].wxyz, Pose.from_matrix(a[i].matrix()).wxyz)
        u, v = points - 3, a.xyz + 3  # neither is ever zero
        assert np.array_equal(quaternion_between(u, v)[i], quaternion_between(u[i], v[i]))


@given(poses())
def test_many_points_give_bit_for_bit_the_results_of_each_alone(pose: Pose) -> None:
    points = np.random.default_rng(0).normal(size=(100, 3))
    assert np.array_equal(pose.apply(points), [pose.apply(point) for point in points])
    assert np.array_equal(pose.apply(points[::2]), pose.apply(points)[::2])


@pytest.mark.parametrize(
    ("batch", "points", "result"),
    [
        ((), (3,), (3,)),
        ((), (7, 2, 3), (7, 2, 3)),
        ((5,), (3,), (5, 3)),
        ((5,), (5, 3), (5, 3)),
        ((5, 1), (9, 3), (5, 9, 3)),
        ((2, 1), (1, 4, 3), (2, 4, 3)),
        ((0,), (3,), (0, 3)),
        ((), (0, 3), (0, 3)),
    ],
)
def test_apply_broadcasts(batch: tuple, points: tuple, result: tuple) -> None:
    pose = Pose.identity(batch)
    assert pose.apply(np.zeros(points)).shape == result
    assert pose.rotate(np.zeros(points)).shape == result


def test_points_that_fit_no_pose_are_rejected_by_name() -> None:
    with pytest.raises(ShapeError, match=r"points: expected shape \(\.\.\., 3\), got \(4, 2\)"):
        Pose.identity().apply(np.zeros((4, 2)))
    with pytest.raises(ShapeError, match=r"points: expected .* \(5, 4\), got shape \(7, 3\)"):
        Pose.identity((5,)).apply(np.zeros((7, 3)))


@pytest.mark.parametrize("batch", [(), (4,), (2, 3), (0,)])
def test_every_accessor_keeps_the_batch_shape(batch: tuple[int, ...]) -> None:
    pose = Pose.identity(batch)
    assert pose.matrix().shape == (*batch, 4, 4)
    assert pose.rotation_matrix().shape == (*batch, 3, 3)
    assert pose.rotvec().shape == (*batch, 3)
    assert pose.angle().shape == batch
    assert Pose.from_matrix(pose.matrix()).batch_shape == batch
    assert (pose @ Pose.identity()).batch_shape == (pose.inverse()).batch_shape == batch


def test_indexing_follows_numpy_on_the_batch_axes_only() -> None:
    pose = Pose(random_quaternions(stream(2), 6).reshape(2, 3, 4), stream(3).normal(size=(2, 3, 3)))
    for index in (0, -1, slice(1), (1, 2), (slice(None), 0), None, [0, 0, 1], np.array([True, False])):
        assert np.array_equal(pose[index].xyz, pose.xyz[index])
    assert np.array_equal(pose[..., 0].xyz, pose.xyz[:, 0])
    assert pose[1, 2].batch_shape == ()
    assert Pose.identity()[None].batch_shape == (1,)
    with pytest.raises(IndexError):
        _ = pose[0, 0, 0]
    with pytest.raises(IndexError):
        _ = pose[2]


def test_a_batch_iterates_and_a_single_pose_does_not() -> None:
    batch = Pose.from_translation(np.arange(6.0).reshape(2, 3))
    assert len(batch) == 2
    assert [pose.xyz.tolist() for pose in batch] == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(TypeError, match="no length"):
        len(Pose.identity())
    with pytest.raises(TypeError, match="no length"):
        iter(Pose.identity())
    with pytest.raises(IndexError, match="no batch axis"):
        Pose.identity()[0]


@pytest.mark.parametrize("pose", [Pose.identity(), Pose.identity((0,)), Pose.identity((2,))])
def test_a_pose_has_no_truth_value(pose: Pose) -> None:
    with pytest.raises(TypeError, match="has no truth value; test for a missing one with `is None`"):
        bool(pose)


def test_stacking_is_the_inverse_of_iterating() -> None:
    batch = Pose(random_quaternions(stream(4), 3), stream(5).normal(size=(3, 3)))
    again = Pose.stack(list(batch))
    assert np.array_equal(again.wxyz, batch.wxyz)
    assert np.array_equal(again.xyz, batch.xyz)
    assert Pose.stack([]).batch_shape == (0,)
    with pytest.raises(ShapeError, match="one batch shape to stack"):
        Pose.stack([Pose.identity(), Pose.identity((2,))])


def test_composing_with_anything_but_a_pose_is_rejected() -> None:
    with pytest.raises(TypeError, match=r"not with ndarray; use apply\(\) for points"):
        _ = Pose.identity() @ np.eye(4)  # pyright: ignore[reportOperatorIssue]
    with pytest.raises(TypeError):
        _ = np.eye(4) @ Pose.identity((4,))  # pyright: ignore[reportOperatorIssue]


# Rounding of a few products of numbers of size 1: about fifty units in the last place.


@given(st.lists(numbers(1e6), min_size=4, max_size=4).map(np.array).filter(lambda q: np.abs(q).max() > 1e-9))
def test_quaternions_are_normalised_and_keep_their_sign(q: np.ndarray) -> None:
    unit = normalized_quaternion(q)
    assert abs(np.linalg.norm(unit) - 1) < 1e-15
    assert unit @ q > 0


@given(st.lists(numbers(3.0), min_size=4, max_size=4).map(np.array).filter(lambda q: np.abs(q).max() > 1e-9))
def test_normalising_twice_changes_no_bit(q: np.ndarray) -> None:
    once = normalized_quaternion(q)
    assert np.array_equal(normalized_quaternion(once), once)


@given(quaternions(), quaternions())
def test_products_agree_with_scipy(a: np.ndarray, b: np.ndarray) -> None:
    # Scipy has the scalar last.
    other = Rotation.from_quat(np.roll(a, -1)) * Rotation.from_quat(np.roll(b, -1))
    assert quaternion_angle(quaternion_multiply(a, b), np.roll(other.as_quat(), 1)) <= ROUNDING


@given(quaternions(), directions(), angles())
def test_quaternion_angle_is_the_geodesic_angle(q: np.ndarray, axis: np.ndarray, angle: float) -> None:
    turned = quaternion_multiply(q, quaternion_from_rotvec(axis * angle))
    assert quaternion_angle(q, turned) == pytest.approx(angle, abs=ROUNDING)
    assert quaternion_angle(-turned, q) == pytest.approx(angle, abs=ROUNDING)


@given(quaternions(), quaternions(), quaternions())
def test_quaternion_angle_is_a_metric_invariant_to_common_rotations(
    a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> None:
    ab, bc, ac = quaternion_angle(a, b), quaternion_angle(b, c), quaternion_angle(a, c)
    assert 0 <= ac <= ab + bc + ROUNDING
    assert ac <= np.pi
    moved = quaternion_angle(quaternion_multiply(c, a), quaternion_multiply(c, b))
    assert moved == pytest.approx(ab, abs=2 * ROUNDING)


@given(directions(), directions())
def test_quaternion_between_maps_u_to_v_by_the_shortest_rotation(u: np.ndarray, v: np.ndarray) -> None:
    turn = Pose(quaternion_between(3 * u, 0.1 * v), np.zeros(3))
    assert np.allclose(turn.rotate(u), v, rtol=0, atol=ROUNDING)
    straight = 2 * np.arctan2(np.linalg.norm(u - v), np.linalg.norm(u + v))
    assert turn.angle() == pytest.approx(straight, abs=ROUNDING)


@given(directions(), directions(), st.one_of(st.just(0.0), st.floats(-17, -3).map(lambda x: 10.0**x)))
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
def test_conjugate_is_the_inverse_rotation(q: np.ndarray) -> None:
    assert quaternion_angle(quaternion_multiply(q, quaternion_conjugate(q)), [1, 0, 0, 0]) <= ROUNDING
