"""Sine, cosine and tangent whose last bit is the same on every x86-64 processor.

The C library and numpy pick other instructions on other processors, and one sine in 1,400 then differs in its last bit.
That is enough to change a mesh, because booleans of solids with parallel faces depend on last bits. Whatever reaches a
file, or decides anything during generation, is therefore computed here, by sums and products of numpy alone. They
are those of fdlibm (Sun Microsystems 1993), within one unit in the last place up to half a turn, and within two beyond.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

LARGEST_ANGLE = 1e5  # [rad] up to which a quarter turn, in three parts, is subtracted without error
_QUARTER_TURN = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
_COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip


def sine(angle: ArrayLike) -> Any:
    """The sine of angles (...,) [rad] up to LARGEST_ANGLE; a number for a number."""
    rest, quarter = _reduced(angle)
    return _quadrant(rest, quarter)


def cosine(angle: ArrayLike) -> Any:
    """The cosine of angles (...,) [rad] up to LARGEST_ANGLE; a number for a number."""
    rest, quarter = _reduced(angle)
    return _quadrant(rest, quarter + 1)


def tangent(angle: ArrayLike) -> Any:
    """The tangent of angles (...,) [rad] up to LARGEST_ANGLE; a number for a number."""
    return sine(angle) / cosine(angle)


def _reduced(angle: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Angles less the nearest multiple of a quarter turn, and that multiple."""
    angle = np.asarray(angle, np.float64)
    quarter = np.rint(angle * (2 / np.pi))
    high, middle, low = _QUARTER_TURN
    return ((angle - quarter * high) - quarter * middle) - quarter * low, quarter


def _quadrant(rest: np.ndarray, quarter: np.ndarray) -> np.ndarray:
    """The sine of `rest` plus a number of quarter turns."""
    square = rest * rest
    odd = rest + square * rest * _series(_SINE, square)
    half = 0.5 * square
    near = 1.0 - half
    even = near + (((1.0 - near) - half) + square * square * _series(_COSINE, square))
    value = np.where(quarter % 2 == 0, odd, even)
    return np.where(quarter % 4 < 2, value, -value)[()]


def _series(coefficients: tuple[float, ...], x: np.ndarray) -> Any:
    total: Any = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = coefficient + x * total
    return total
