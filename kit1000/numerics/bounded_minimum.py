"""The minimum of a function of one number between bounds, by golden sections and parabolas (Brent 1973, chapter 5).

The same steps as those of `scipy.optimize.minimize_scalar` with its method "bounded", to the last bit, without the
import of that package.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

MOST_CALLS = 500
SQUARE_ROOT_OF_PRECISION = sqrt(2.2e-16)
GOLDEN = 0.5 * (3.0 - sqrt(5.0))


def bounded_minimum(function: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Where a function with one minimum between bounds is least, within a tolerance."""
    x = second = third = low + GOLDEN * (high - low)  # the best place so far and the two after it
    fx = f_second = f_third = function(x)
    step = before = 0.0
    for _ in range(1, MOST_CALLS):
        middle, least = 0.5 * (low + high), SQUARE_ROOT_OF_PRECISION * abs(x) + tolerance / 3.0
        if abs(x - middle) <= 2.0 * least - 0.5 * (high - low):
            break
        parabola = None
        if abs(before) > least:
            parabola = _parabola_step(x - second, x - third, fx - f_second, fx - f_third, before, (low - x, high - x))
            before = step
        if parabola is None:
            before = low - x if x >= middle else high - x
            step = GOLDEN * before
        else:
            step = parabola
            if (x + step) - low < 2.0 * least or high - (x + step) < 2.0 * least:
                step = least if middle >= x else -least
        place = x + (1.0 if step >= 0 else -1.0) * max(abs(step), least)
        value = function(place)
        if value <= fx:
            low, high = (x, high) if place >= x else (low, x)
            third, f_third, second, f_second, x, fx = second, f_second, x, fx, place, value
            continue
        low, high = (place, high) if place < x else (low, place)
        if value <= f_second or second == x:
            third, f_third, second, f_second = second, f_second, place, value
        elif value <= f_third or third in (x, second):
            third, f_third = place, value
    return x


def _parabola_step(
    second: float, third: float, f_second: float, f_third: float, before: float, room: tuple[float, float]
) -> float | None:
    """The step to the bottom of the parabola through three places, given from the best; None where it is no good."""
    r, q = second * f_third, third * f_second
    p = third * q - second * r
    q = 2.0 * (q - r)
    p, q = (-p if q > 0.0 else p), abs(q)
    return p / q if abs(p) < abs(0.5 * q * before) and q * room[0] < p < q * room[1] else None
