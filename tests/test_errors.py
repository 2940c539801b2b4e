"""The exceptions of the package, and the check of array arguments."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.errors import InputError, Kit1000Error, MeshRefused, Redraw, ShapeError, checked


@pytest.mark.parametrize("kind", [InputError, ShapeError, MeshRefused, Redraw])
def test_every_exception_derives_from_that_of_the_package(kind: type[Exception]) -> None:
    assert issubclass(kind, Kit1000Error)


def test_invalid_arrays_and_meshes_are_input_errors_but_a_redraw_is_not() -> None:
    assert issubclass(ShapeError, InputError)
    assert issubclass(ShapeError, ValueError)
    assert issubclass(MeshRefused, InputError)
    assert not issubclass(Redraw, InputError)


@pytest.mark.parametrize("kind", [MeshRefused, Redraw])
def test_reason_is_the_message_and_survives_pickling(kind: type[MeshRefused | Redraw]) -> None:
    error = pickle.loads(pickle.dumps(kind("not closed: 14 open edges")))
    assert error.reason == str(error) == "not closed: 14 open edges"


def test_checked_returns_a_contiguous_copy_that_cannot_be_written() -> None:
    source = np.arange(12.0).reshape(3, 4).T
    copy = checked("points", source, ("n", 3))
    source[:] = -1
    assert copy.flags.c_contiguous
    assert copy[3, 2] == 11.0
    with pytest.raises(ValueError, match="read-only"):
        copy[0, 0] = 1.0


def test_a_read_only_array_is_also_copied() -> None:
    # Its owner may hold a writable view of the same memory.
    source = np.zeros((2, 3))
    frozen = source.view()
    frozen.setflags(write=False)
    copy = checked("points", frozen, ("n", 3))
    source[:] = 7
    assert np.all(copy == 0)


@given(st.lists(st.integers(0, 3), max_size=4), st.integers(0, 3), st.integers(0, 3))
@settings(max_examples=50)
def test_leading_axes_are_free_and_trailing_ones_exact(leading: list[int], size: int, wanted: int) -> None:
    array = np.zeros((*leading, size))
    if size == wanted:
        assert checked("a", array, (..., wanted)).shape == array.shape
    else:
        with pytest.raises(ShapeError):
            checked("a", array, (..., wanted))


@pytest.mark.parametrize(
    ("array", "shape"),
    [
        (np.zeros(3), (..., "n", 3)),  # fewer axes than expected
        (np.zeros((2, 3)), (3,)),  # more axes than expected
        (np.zeros((2, 3)), ("n", "n")),  # one name, two sizes
        (np.zeros(()), (3,)),
        ([], ("n", 3)),
    ],
)
def test_wrong_shapes_are_rejected(array: np.ndarray, shape: tuple) -> None:
    with pytest.raises(ShapeError):
        checked("a", array, shape)


def test_equal_names_mean_equal_sizes() -> None:
    assert checked("square", np.zeros((4, 4)), ("n", "n")).shape == (4, 4)


def test_the_message_is_one_line_with_name_expected_and_actual_shape() -> None:
    with pytest.raises(ShapeError) as caught:
        checked("kit_vertices", np.zeros((5, 2)), (..., "n", 3))
    assert str(caught.value) == "kit_vertices: expected float64 of shape (..., n, 3), got shape (5, 2)"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_non_finite_value_is_rejected_with_its_index(value: float) -> None:
    array = np.zeros((2, 3))
    array[1, 2] = value
    with pytest.raises(ShapeError, match=r"depth: .* at \(1, 2\), which is not finite"):
        checked("depth", array, ("h", "w"), np.float32)


def test_a_float_too_large_for_the_dtype_is_rejected() -> None:
    with pytest.raises(ShapeError, match="not finite"):
        checked("depth", [1e39], (1,), np.float32)


@pytest.mark.parametrize("value", [0.5, 2**31, -(2**31) - 1, np.nan, np.inf, 1e300])
def test_a_cast_to_integers_must_be_exact(value: float) -> None:
    with pytest.raises(ShapeError, match="which is no int32"):
        checked("faces", [value], (1,), np.int32)


def test_whole_floats_become_integers_and_integers_become_floats() -> None:
    assert checked("faces", [1.0, 2.0], (2,), np.int32).dtype == np.int32
    assert checked("points", [1, 2], (2,)).dtype == np.float64


def test_a_bool_array_accepts_zeros_and_ones_only() -> None:
    assert checked("mask", [0, 1], (2,), bool).tolist() == [False, True]
    with pytest.raises(ShapeError, match="which is no bool"):
        checked("mask", [0, 2], (2,), bool)


@pytest.mark.parametrize("array", [["1.0"], [1j], [None], {"x": 1.0}, "abc"])
def test_values_other_than_real_numbers_are_rejected(array: object) -> None:
    with pytest.raises(ShapeError, match="a: expected float64"):
        checked("a", array, (..., 1))  # pyright: ignore[reportArgumentType]


def test_rows_of_unequal_length_are_rejected() -> None:
    with pytest.raises(ShapeError, match="unequal length"):
        checked("a", [[1.0], [1.0, 2.0]], ("n", 2))


def test_an_empty_array_of_the_right_shape_passes() -> None:
    assert checked("points", np.zeros((0, 3)), ("n", 3)).shape == (0, 3)
