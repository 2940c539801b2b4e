"""Tests of powers: no other float64 is nearer to the exact value."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kit1000.numerics.powers import power


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
