"""Cells of the pages: numbers with equal decimals in a column, perhaps with their interval drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from benchmark.quantities import Quantity
from kit1000.pictures.charts import Dot, interval_mark, rounded_up

NO_VALUE = "–"  # where nothing was measured


@dataclass(frozen=True)
class Cell:
    """A number in a table."""

    text: str
    value: float | None
    """The key it is sorted by; None comes last."""
    mark: Markup | None = None
    """The interval, drawn."""


def mean_cell(quantity: Quantity, row: Mapping[str, Any], scale_end: float | None = None) -> Cell:
    """The mean or rate, its interval drawn from 0 to `scale_end` where that is given."""
    value, interval = quantity.estimate(row)
    if value is None or interval is None:
        return Cell(NO_VALUE, None)
    text = quantity.text(value)
    if scale_end is None:
        return Cell(text, value)
    (low, high), unit = interval, quantity.unit.suffix
    tooltip = f"{text}{unit}, 95 % interval {quantity.text(low)} to {quantity.text(high)}{unit}"
    return Cell(text, value, Markup(interval_mark(Dot(tooltip, value, low, high), scale_end)))


def median_cell(quantity: Quantity, row: Mapping[str, Any]) -> Cell:
    """The median."""
    value = quantity.median(row)
    return Cell(NO_VALUE, None) if value is None else Cell(quantity.text(value), value)


def scale_end(quantity: Quantity, rows: Sequence[Mapping[str, Any]]) -> float:
    """The end of a common scale of some rows: 100 for rates, else a round number above all intervals."""
    if quantity.rate:
        return 100.0
    highs = [interval[1] for row in rows if (interval := quantity.estimate(row)[1]) is not None]
    return rounded_up(max(highs, default=1.0))


def percent(share: float) -> str:
    """A share as a percentage, without decimals where it is whole."""
    return f"{100 * share:.1f}".removesuffix(".0") + " %"
