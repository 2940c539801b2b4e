"""The bounded minimum against that of scipy, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, exp, sin

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from kit1000.numerics.bounded_minimum import bounded_minimum

FUNCTIONS: dict[str, Callable[[float], float]] = {
    "parabola": lambda x: (x - 0.3) ** 2,
    "steps": lambda x: round(abs(x - 0.12), 3),
    "corner": lambda x: abs(x + 0.77) + 0.1 * x,
    "waves": lambda x: sin(9 * x) + 0.3 * cos(40 * x),
    "flat": lambda x: 1.0,
    "falling": lambda x: exp(-x),
    "rising": lambda x: x**3,
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-7])
def test_the_place_is_that_of_scipy(name: str, tolerance: float) -> None:
    for low, high in np.sort(np.random.default_rng(1).uniform(-2, 2, (40, 2)), axis=1):
        asked: list[float] = []

        def function(x: float, asked: list[float] = asked) -> float:
            asked.append(float(x))
            return FUNCTIONS[name](x)

        found = bounded_minimum(function, float(low), float(high), tolerance)
        own, asked[:] = list(asked), []
        options = {"xatol": tolerance}
        assert found == minimize_scalar(function, bounds=(low, high), method="bounded", options=options).x
        assert own == asked
