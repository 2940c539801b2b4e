"""Near-duplicates do not depend on size, position and order of the axes, but on the shape."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold

from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.near_duplicates import MIN_DIFFERENCE, near_duplicate_of, power, shape_measures
from tests.samples.mini import l_shape
from tests.samples.strategies import vectors

SIDES = st.floats(0.2, 5)


def box(x: float, y: float, z: float) -> Mesh:
    return mesh_from_solid(Manifold.cube((x, y, z)))


@given(SIDES, SIDES, SIDES)
def test_the_measures_of_a_box_are_known(a: float, b: float, c: float) -> None:
    short, middle, long = sorted((a, b, c))
    area = 2 * (a * b + b * c + c * a) / (a * b * c) ** (2 / 3)
    assert shape_measures(box(a, b, c)) == pytest.approx([1, 1, middle / long, short / long, area], rel=1e-9)


@given(st.floats(1e-3, 1e3), vectors(5.0), st.permutations([0, 1, 2]))
def test_measures_do_not_depend_on_size_position_and_order_of_axes(
    size: float, shift: np.ndarray, axes: list[int]
) -> None:
    mesh = l_shape()
    turned = mesh.vertices[:, axes] * size + shift * size
    even = np.linalg.det(np.eye(3)[axes]) > 0
    moved = Mesh(turned, mesh.faces if even else mesh.faces[:, ::-1])
    assert shape_measures(moved) == pytest.approx(shape_measures(mesh), rel=1e-7)
    assert near_duplicate_of(shape_measures(moved), shape_measures(mesh)[None]) == 0


def test_a_solid_with_a_hollow_fills_less_of_its_hull() -> None:
    assert shape_measures(l_shape())[1] < 0.9
    assert shape_measures(box(1, 2, 3))[1] == pytest.approx(1)


def test_the_first_part_that_agrees_in_all_measures_is_returned() -> None:
    measures = np.array([0.5, 0.6, 0.7, 0.8, 9.0])
    others = measures * (1 + MIN_DIFFERENCE * np.array([[1.2, 0, 0, 0, 0], [0.9] * 5, [0] * 5]))
    assert near_duplicate_of(measures, others) == 1
    assert near_duplicate_of(measures, others[:1]) is None
    assert near_duplicate_of(measures, np.zeros((0, 5))) is None


@given(st.floats(1e-8, 1e3), st.sampled_from([2 / 3, 1 / 3, 0.5, 2.0]))
def test_powers_are_correctly_rounded(base: float, exponent: float) -> None:
    with localcontext() as context:
        context.prec = 60
        exact = (Decimal(exponent) * Decimal(base).ln()).exp()
        rounded = power(base, exponent)
        beside = [float(np.nextafter(rounded, to)) for to in (0.0, np.inf)]
        assert all(abs(Decimal(rounded) - exact) <= abs(Decimal(other) - exact) for other in beside)


def test_powers_of_squares_and_cubes_are_exact() -> None:
    assert [power(49.0, 0.5), power(3.0, 4.0), power(1.0, 2 / 3)] == [7.0, 81.0, 1.0]
