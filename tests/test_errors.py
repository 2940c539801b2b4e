"""The exceptions of the package, and the check of array arguments."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.errors import InputError, Kit1000Error, MeshRefused, Redraw, ShapeError, checked


def test_invalid_arrays_and_meshes_are_input_errors_but_a_redraw_is_not() -> None:
    assert all(issubclass(kind, Kit1000Error) for kind in (InputError, Redraw))
    assert all(issubclass(kind, InputError) for kind in (ShapeError, MeshRefused))
    assert issubclass(ShapeError, ValueError)
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


def test_the_message_is_one_line_with_name_expected_and_actual_shape() -> None:
    with pytest.raises(ShapeError) as caught:
        checked("kit_vertices", np.zeros((5, 2)), (..., "n", 3))
    assert str(caught.value) == "kit_vertices: expected float64 of shape (..., n, 3), got shape (5, 2)"


INEXACT = [0.5, 2**31, -(2**31) - 1, np.nan, np.inf, 1e300]
REFUSED: list[tuple[object, tuple, type, str]] = [  # an array, the expected shape and dtype, a fact of the message
    (np.zeros(3), (..., "n", 3), float, "shape"),  # fewer axes than expected
    (np.zeros((2, 3)), (3,), float, "shape"),  # more axes than expected
    (np.zeros((2, 3)), ("n", "n"), float, "shape"),  # one name, two sizes
    (np.zeros(()), (3,), float, "shape"),
    ([], ("n", 3), float, "shape"),
    *(
        ([[0, 0], [0, value]], ("h", "w"), np.float32, r"a: .* at \(1, 1\), which is not finite")
        for value in INEXACT[3:5]
    ),
    ([1e39], (1,), np.float32, "not finite"),  # too large for the dtype
    *(([value], (1,), np.int32, "which is no int32") for value in INEXACT),  # a cast must be exact
    ([0, 2], (2,), bool, "which is no bool"),
    *((array, (..., 1), float, "a: expected float64") for array in (["1.0"], [1j], [None], {"x": 1.0}, "abc")),
    ([[1.0], [1.0, 2.0]], ("n", 2), float, "unequal length"),
]


@pytest.mark.parametrize(("array", "shape", "dtype", "fact"), REFUSED)
def test_other_shapes_and_values_are_refused(array: object, shape: tuple, dtype: type, fact: str) -> None:
    with pytest.raises(ShapeError, match=fact):
        checked("a", array, shape, dtype)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("array", "shape", "dtype"),
    [
        (np.zeros((4, 4)), ("n", "n"), np.float64),
        (np.zeros((0, 3)), ("n", 3), np.float64),
        ([1, 2], (2,), np.float64),
        ([1.0, 2.0], (2,), np.int32),
        ([0, 1], (2,), bool),
    ],
)
def test_values_that_a_dtype_holds_are_converted(array: list, shape: tuple, dtype: type) -> None:
    found = checked("a", array, shape, dtype)
    assert found.dtype == dtype
    assert np.array_equal(found, array)
