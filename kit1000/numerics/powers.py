"""Powers whose last bit is the same on every processor: those of numpy and of C differ in it now and then."""

from __future__ import annotations

from decimal import Context, Decimal

DIGITS = 40  # of the intermediate result: twice those of a float64 and some


def power(base: float, exponent: float) -> float:
    """The power of a positive number, correctly rounded."""
    return float(Context(prec=DIGITS).power(Decimal(float(base)), Decimal(exponent)))
