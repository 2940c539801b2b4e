"""Symmetries are groups; the closed-form error equals the minimum over all symmetric orientations."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.errors import InputError, ShapeError
from kit1000.pose import (
    Pose,
    quaternion_angle,
    quaternion_conjugate,
    quaternion_from_rotvec,
    quaternion_multiply,
    random_quaternions,
)
from kit1000.rng import stream
from kit1000.symmetry import Symmetry
from tests.samples.strategies import directions, quaternions

ROUNDING = 2e-14
TILTED = np.array([0.48, 0.6, 0.64])

TETRAHEDRON = Symmetry.generated(quaternion_from_rotvec([[np.pi, 0, 0], np.full(3, 2 * np.pi / 3) / np.sqrt(3)]))
GOLDEN = (1 + np.sqrt(5)) / 2
ICOSAHEDRON = Symmetry.generated(np.array([[0.5, 0.5, 0.5, 0.5], [GOLDEN / 2, 1 / (2 * GOLDEN), 0.5, 0.0]]))
FINITE = [
    Symmetry.none(),
    Symmetry.cyclic(2),
    Symmetry.cyclic(3, TILTED),
    Symmetry.cyclic(12, [0, -1, 0]),
    Symmetry.dihedral(1),
    Symmetry.dihedral(2, TILTED, np.cross(TILTED, [0, 0, 1])),
    Symmetry.dihedral(6),
    TETRAHEDRON,
    Symmetry.cube(),
    ICOSAHEDRON,
]
FREE = [
    Symmetry.free(),
    Symmetry.free(TILTED),
    Symmetry.free_flipped([1, 0, 0]),
    Symmetry.free_flipped(TILTED),
]
ALL = FINITE + FREE
each = pytest.mark.parametrize("sym", ALL, ids=lambda sym: sym.name)


@st.composite
def members(draw: st.DrawFn, sym: Symmetry) -> np.ndarray:
    """Rotations (4,) of the symmetry, of either sign."""
    g = sym.rotations[draw(st.integers(0, sym.order - 1))] * draw(st.sampled_from([1.0, -1.0]))
    if sym.axis is None:
        return g
    return quaternion_multiply(g, quaternion_from_rotvec(sym.axis * draw(st.floats(-7.0, 7.0))))


# --- groups ---


@pytest.mark.parametrize(
    ("sym", "name", "order"),
    [
        (Symmetry.none(), "none", 1),
        (Symmetry.cyclic(1), "none", 1),
        (Symmetry.cyclic(2), "C2", 2),
        (Symmetry.cyclic(12), "C12", 12),
        (Symmetry.dihedral(1), "C2", 2),
        (Symmetry.dihedral(2), "D2", 4),
        (Symmetry.dihedral(3), "D3", 6),
        (Symmetry.dihedral(6), "D6", 12),
        (Symmetry.dihedral(12), "D12", 24),
        (TETRAHEDRON, "T", 12),
        (Symmetry.cube(), "O", 24),
        (ICOSAHEDRON, "I", 60),
        (Symmetry.free(), "free", 1),
        (Symmetry.free_flipped(), "free_flipped", 2),
    ],
)
def test_name_and_order(sym: Symmetry, name: str, order: int) -> None:
    assert (sym.name, sym.order) == (name, order)


@each
def test_products_and_inverses_stay_in_the_group(sym: Symmetry) -> None:
    assert sym.rotations[0].tolist() == [1, 0, 0, 0]
    products = quaternion_multiply(sym.rotations[:, None], sym.rotations)
    assert np.all(sym.error(products, [1, 0, 0, 0]) <= ROUNDING)
    assert np.all(sym.error(quaternion_conjugate(sym.rotations), [1, 0, 0, 0]) <= ROUNDING)
    assert sym.is_group()


@each
def test_elements_differ(sym: Symmetry) -> None:
    apart = quaternion_angle(sym.rotations[:, None], sym.rotations) + np.pi * np.eye(sym.order)
    assert apart.min() >= 2 * np.pi / 12 - ROUNDING


def test_the_cube_group_is_every_signed_permutation_of_the_axes() -> None:
    matrices = Pose(Symmetry.cube().rotations, np.zeros(3)).rotation_matrix()
    rounded = np.round(matrices)
    assert np.allclose(matrices, rounded, rtol=0, atol=ROUNDING)
    assert np.all(np.abs(rounded).sum(axis=1) == 1)
    assert len({m.tobytes() for m in rounded + 0.0}) == 24


def test_dihedral_is_the_whole_symmetry_of_a_prism() -> None:
    corners = [[np.cos(t), np.sin(t), z] for t in np.arange(5) * 2 * np.pi / 5 for z in (-1, 1)]
    prism = np.array(corners)  # one corner on +x: 180 degrees about x map the prism to itself
    turned = Pose(Symmetry.dihedral(5).rotations[:, None], np.zeros(3)).apply(prism)
    gaps = np.linalg.norm(turned[:, :, None] - prism, axis=-1).min(axis=-1)
    assert gaps.max() < ROUNDING
    half_step = Pose.from_rotvec([0, 0, np.pi / 5]).apply(prism)
    assert np.linalg.norm(half_step[:, None] - prism, axis=-1).min() > 0.5


@pytest.mark.parametrize(
    "rotations",
    [
        quaternion_from_rotvec([[0, 0, 0], [0, 0, 0.7]]),  # not closed
        quaternion_from_rotvec([[0, 0, np.pi], [0, 0, 0]]),  # identity not first
        quaternion_from_rotvec([[0, 0, np.pi]]),  # no identity
        quaternion_from_rotvec([[0, 0, 0], [0, 0, np.pi], [0, 0, -np.pi]]),  # the same element twice
        quaternion_from_rotvec([[0, 0, 0], [0, 0, np.pi], [np.pi, 0, 0]]),  # the third half turn is missing
        np.zeros((0, 4)),
    ],
)
def test_rotations_that_form_no_group_are_rejected(rotations: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"expected a group.* identity first"):
        Symmetry(rotations)


@pytest.mark.parametrize(
    "rotations",
    [
        quaternion_from_rotvec([[0, 0, 0], [0, np.pi / 2, 0]]),  # moves the free axis
        quaternion_from_rotvec([[0, 0, 0], [0.6 * np.pi, 0, 0.8 * np.pi]]),  # likewise, and back again
        quaternion_from_rotvec([[0, 0, 0], [0, 0, np.pi]]),  # already among the rotations about the axis
        quaternion_from_rotvec([[0, 0, 0], [np.pi, 0, 0], [0, np.pi, 0]]),  # the same flip twice
    ],
)
def test_rotations_incompatible_with_a_free_axis_are_rejected(rotations: np.ndarray) -> None:
    with pytest.raises(InputError, match="expected a group"):
        Symmetry(rotations, np.array([0.0, 0, 1]))


def test_generated_groups_do_not_depend_on_order_or_repeats_of_generators() -> None:
    x, z = quaternion_from_rotvec([[np.pi / 2, 0, 0], [0, 0, np.pi / 2]])
    for generators in ([x, z], [z, x, z, -x], [quaternion_multiply(x, z), x]):
        group = Symmetry.generated(generators)
        assert np.all(group.error(Symmetry.cube().rotations, [1, 0, 0, 0]) <= ROUNDING)
        assert group.order == 24
    assert Symmetry.generated(np.zeros((0, 4))).name == "none"


def test_generated_rejects_groups_beyond_120() -> None:
    assert Symmetry.generated(quaternion_from_rotvec([[0, 0, 2 * np.pi / 120]])).name == "C120"
    with pytest.raises(InputError, match="up to 120 rotations"):
        Symmetry.generated(quaternion_from_rotvec([[0, 0, 2 * np.pi / 121]]))
    with pytest.raises(InputError, match="up to 120 rotations"):
        Symmetry.generated(quaternion_from_rotvec([[0, 0, 1.0]]))


def test_invalid_arguments_are_rejected_by_name() -> None:
    with pytest.raises(InputError, match="flip: expected a perpendicular of the axis"):
        Symmetry.dihedral(3, [0, 0, 1], [1, 0, 0.1])
    with pytest.raises(InputError, match="axis: expected a direction"):
        Symmetry.free([0, 0, 0])
    with pytest.raises(ShapeError, match=r"axis: expected float64 of shape \(3,\), got shape \(2, 3\)"):
        Symmetry.cyclic(2, np.eye(3)[:2])
    for n in (0, -2, 2.5):
        with pytest.raises(InputError, match="n: expected a whole number"):
            Symmetry.cyclic(n)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("again", [lambda s: pickle.loads(pickle.dumps(s)), copy.deepcopy])
@pytest.mark.parametrize("sym", [Symmetry.cube(), Symmetry.free_flipped(TILTED)])
def test_copies_keep_every_bit_and_stay_read_only(sym: Symmetry, again: Callable) -> None:
    twin = again(sym)
    assert np.array_equal(twin.rotations, sym.rotations)
    assert not twin.rotations.flags.writeable
    assert (twin.axis is None) == (sym.axis is None)
    if sym.axis is not None:
        assert np.array_equal(twin.axis, sym.axis)
        assert not twin.axis.flags.writeable


# --- the error ---


@pytest.mark.parametrize("sym", FINITE, ids=lambda sym: sym.name)
def test_error_of_a_finite_group_is_the_minimum_over_its_orientations(sym: Symmetry) -> None:
    estimate, truth = random_quaternions(stream(1), 200), random_quaternions(stream(2), 200)
    orientations = quaternion_multiply(truth[:, None], sym.rotations)
    brute = quaternion_angle(orientations, estimate[:, None]).min(axis=1)
    assert np.allclose(sym.error(estimate, truth), brute, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("sym", FREE, ids=lambda sym: sym.name)
def test_error_about_a_free_axis_is_the_angle_between_the_axes(sym: Symmetry) -> None:
    # Another closed form: only the direction of the axis can differ, up to its sign with a flip.
    estimate, truth = random_quaternions(stream(5), 200), random_quaternions(stream(6), 200)
    assert sym.axis is not None
    a, b = Pose(estimate, np.zeros(3)).rotate(sym.axis), Pose(truth, np.zeros(3)).rotate(sym.axis)
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))
    expected = np.minimum(angle, np.pi - angle) if sym.order == 2 else angle
    assert np.allclose(sym.error(estimate, truth), expected, rtol=0, atol=ROUNDING)


@each
@given(data=st.data(), truth=quaternions())
def test_error_is_zero_at_every_symmetric_orientation(sym: Symmetry, data: st.DataObject, truth: np.ndarray) -> None:
    estimate = quaternion_multiply(truth, data.draw(members(sym)))
    assert sym.error(estimate, truth) <= ROUNDING


@each
@given(data=st.data(), estimate=quaternions(), truth=quaternions(), world=quaternions())
def test_error_is_invariant_to_the_world_frame_and_to_symmetries(
    sym: Symmetry, data: st.DataObject, estimate: np.ndarray, truth: np.ndarray, world: np.ndarray
) -> None:
    error = sym.error(estimate, truth)
    left = sym.error(quaternion_multiply(world, estimate), quaternion_multiply(world, truth))
    right = sym.error(
        quaternion_multiply(estimate, data.draw(members(sym))),
        quaternion_multiply(truth, data.draw(members(sym))),
    )
    assert left == pytest.approx(error, abs=ROUNDING)
    assert right == pytest.approx(error, abs=ROUNDING)


@each
@given(estimate=quaternions(), truth=quaternions(), third=quaternions())
def test_error_is_a_metric_at_most_the_geodesic_angle(
    sym: Symmetry, estimate: np.ndarray, truth: np.ndarray, third: np.ndarray
) -> None:
    error = sym.error(estimate, truth)
    assert 0 <= error <= quaternion_angle(estimate, truth) + ROUNDING
    assert error == pytest.approx(sym.error(truth, estimate), abs=ROUNDING)
    assert error <= sym.error(estimate, third) + sym.error(third, truth) + ROUNDING


@given(quaternions(), directions(), st.floats(-12, -3).map(lambda x: 10.0**x))
def test_small_errors_across_a_free_axis_are_exact(truth: np.ndarray, axis: np.ndarray, tilt: float) -> None:
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    small = quaternion_from_rotvec(tilt * across / np.linalg.norm(across))
    estimate = quaternion_multiply(quaternion_multiply(truth, quaternion_from_rotvec(1.3 * axis)), small)
    assert Symmetry.free(axis).error(estimate, truth) == pytest.approx(tilt, abs=ROUNDING)
    # The opposite end of the same cylinder is 180 degrees minus the tilt away, for a cone.
    end = quaternion_multiply(estimate, quaternion_from_rotvec(np.pi * across / np.linalg.norm(across)))
    assert np.pi - Symmetry.free(axis).error(end, truth) == pytest.approx(tilt, abs=ROUNDING)
    assert Symmetry.free_flipped(axis).error(end, truth) == pytest.approx(tilt, abs=ROUNDING)


def test_error_broadcasts_and_rejects_wrong_shapes() -> None:
    sym = Symmetry.cube()
    assert sym.error(np.ones((5, 1, 4)), np.ones((3, 4))).shape == (5, 3)
    assert sym.error(np.ones(4), np.ones(4)).shape == ()
    assert sym.error(np.ones((0, 4)), np.ones(4)).shape == (0,)
    with pytest.raises(ShapeError, match=r"expected shape \(\.\.\., 4\), got \(5, 3\)"):
        sym.error(np.ones((5, 3)), np.ones(4))


# --- other forms ---


@each
@given(turn=quaternions(), estimate=quaternions(), truth=quaternions())
@settings(max_examples=10)
def test_conjugated_is_the_symmetry_of_the_rotated_part(
    sym: Symmetry, turn: np.ndarray, estimate: np.ndarray, truth: np.ndarray
) -> None:
    # Rotating the part by q in its own axes and every pose back by q changes nothing in the scene.
    turned = sym.conjugated(turn)
    back = quaternion_conjugate(turn)
    error = turned.error(quaternion_multiply(estimate, back), quaternion_multiply(truth, back))
    assert error == pytest.approx(sym.error(estimate, truth), abs=2 * ROUNDING)
    assert turned.rotations[0].tolist() == [1, 0, 0, 0]
    assert turned.name == sym.name
