"""Numbers as the pages write them: equal decimals in a column, and nothing where nothing was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from benchmark.charts import Dot, interval_mark, rounded_up

NONE = "–"


@dataclass(frozen=True)
class Quantity:
    """A number of scores.json, and how a table shows it."""

    key: str
    name: str
    unit: str
    decimals: int
    rate: bool = False
    """Whether it is a share with its interval, shown in percent, and not a mean."""

    @property
    def scale(self) -> float:
        """What stored numbers are multiplied by."""
        return 100.0 if self.rate else 1.0


POSITION = Quantity("position_mm", "Position", "mm", 2)
ROTATION = Quantity("rotation_deg", "Rotation", "°", 2)
MSSD = Quantity("mssd_mm", "MSSD", "mm", 2)
SEATED = Quantity("seated", "Seated", "%", 1, rate=True)
STRICT = Quantity("seated_strict", "Strict", "%", 1, rate=True)
BEYOND = Quantity("beyond", "Beyond", "%", 1, rate=True)
PENETRATION = Quantity("penetration_mm", "Penetration", "mm", 2)
POSITION_PLAIN = Quantity("position_plain_mm", "Position, plain", "mm", 2)
ROTATION_PLAIN = Quantity("rotation_plain_deg", "Rotation, plain", "°", 2)
SECONDS = Quantity("seconds", "Time", "s", 2)


@dataclass(frozen=True)
class Cell:
    """A number in a table."""

    text: str
    value: float | None
    """What it is sorted by; None comes last."""
    mark: Markup | None = None
    """The interval, drawn."""


def mean_cell(quantity: Quantity, row: Mapping[str, Any], most: float | None = None) -> Cell:
    """The mean or the rate, with its interval drawn from 0 to `most` where that is given."""
    value, interval = mean_of(quantity, row)
    if value is None or interval is None:
        return Cell(NONE, None)
    text = written(value, quantity)
    if most is None:
        return Cell(text, value)
    low, high = interval
    unit = quantity.unit if quantity.unit in ("°", "%") else f" {quantity.unit}"
    told = f"{text}{unit}, 95 % interval {written(low, quantity)} to {written(high, quantity)}{unit}"
    return Cell(text, value, Markup(interval_mark(Dot(told, value, low, high), most)))


def median_cell(quantity: Quantity, row: Mapping[str, Any]) -> Cell:
    """The median."""
    value = (row.get(quantity.key) or {}).get("median")
    return Cell(NONE, None) if value is None else Cell(written(value, quantity), value)


def mean_of(quantity: Quantity, row: Mapping[str, Any]) -> tuple[float | None, tuple[float, float] | None]:
    """A mean or a rate with its interval, as shown; None where nothing was measured."""
    stored = row.get(quantity.key) or {}
    value = stored.get("rate" if quantity.rate else "mean")
    if value is None:
        return None, None
    low, high = stored["ci95"]
    return quantity.scale * value, (quantity.scale * low, quantity.scale * high)


def most_of(quantity: Quantity, rows: list[Mapping[str, Any]]) -> float:
    """Where a common scale of some rows ends: 100 for rates, else a round number above all intervals."""
    if quantity.rate:
        return 100.0
    highs = [interval[1] for row in rows if (interval := mean_of(quantity, row)[1]) is not None]
    return rounded_up(max(highs, default=1.0))


def written(value: float, quantity: Quantity) -> str:
    """A number with the decimals of its column; never minus zero."""
    return f"{round(value, quantity.decimals) + 0.0:.{quantity.decimals}f}"


def percent(share: float) -> str:
    """A share as a percentage: whole where it is."""
    return f"{100 * share:.1f}".removesuffix(".0") + " %"
