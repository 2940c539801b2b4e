"""The quantities of a score, each defined once: its key, name, unit, decimals, metric, and the outputs that show it.

Every quantity is in scores.json and on the page of a method; those measured query by query are in the CSV file too. The
outputs read QUANTITIES when they are made, so a quantity added here, and measured in `benchmark.evaluate`, reaches all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Output = Literal["text", "breakdown", "comparison", "board", "interval", "median", "cases"]
"""The table of the terminal; groups of queries; `benchmark compare`; a column of the board, there with its interval
drawn, or with a column of medians; the lists of single queries."""
HEADLINE: frozenset[Output] = frozenset({"text", "breakdown", "comparison", "board", "interval", "cases"})
MEDIAN: frozenset[Output] = frozenset({"median"})
SHORT: frozenset[Output] = frozenset({"text", "board"})


@dataclass(frozen=True)
class Unit:
    """A unit in its three spellings."""

    text: str
    """In keys and in a terminal."""
    symbol: str
    """In tables."""
    label: str
    """On the axis of a chart."""

    @property
    def suffix(self) -> str:
        """As it follows a number."""
        return self.symbol if self.symbol in ("°", "%") else f" {self.symbol}"


MILLIMETRE = Unit("mm", "mm", "mm")
DEGREE = Unit("deg", "°", "degrees")
PERCENT = Unit("%", "%", "%")
SECOND = Unit("s", "s", "s")


@dataclass(frozen=True)
class Quantity:
    """One number of a score."""

    key: str
    """In scores.json, and of its column in a row per query."""
    name: str
    """In tables and charts."""
    unit: Unit
    description: str
    """For a tooltip."""
    metric: str | None
    """The metric that gives it, by its name in METRIC_VERSIONS; None: the submission reports it."""
    outputs: frozenset[Output] = frozenset()
    """The outputs that show it, beside those that show all."""
    decimals: int = 2
    rate: bool = False
    """Whether it is a share of queries, shown in percent with Wilson's interval, and not a mean."""
    higher_is_better: bool = False
    needs_position: bool = True
    """Whether it is null for a method that predicts rotations alone."""
    per_query: bool = True
    """Whether it is measured query by query; else it is derived from other quantities and the protocol."""

    @property
    def scale(self) -> float:
        """Factor from stored to shown numbers."""
        return 100.0 if self.rate else 1.0

    @property
    def heading(self) -> str:
        """Heading of a column of plain text, such as `position mm`."""
        return f"{self.name if self.name.isupper() else self.name.lower()} {self.unit.text}"

    def text(self, value: float) -> str:
        """A shown number with the decimals of its column; never minus zero."""
        return f"{round(value, self.decimals) + 0.0:.{self.decimals}f}"

    def estimate(self, row: Mapping[str, Any]) -> tuple[float | None, tuple[float, float] | None]:
        """The mean or rate of a row of scores.json and its 95 % interval, as shown; None if it was not measured."""
        stored = row.get(self.key) or {}
        value = stored.get("rate" if self.rate else "mean")
        if value is None:
            return None, None
        low, high = stored["ci95"]
        return self.scale * value, (self.scale * low, self.scale * high)

    def median(self, row: Mapping[str, Any]) -> float | None:
        """The median of a row of scores.json; None if it was not measured."""
        return (row.get(self.key) or {}).get("median")


POSITION = Quantity(
    "position_mm",
    "Position",
    MILLIMETRE,
    "Distance of the part’s centroid from its nearest goal",
    "position",
    HEADLINE | MEDIAN,
)
ROTATION = Quantity(
    "rotation_deg",
    "Rotation",
    DEGREE,
    "Angle between the predicted rotation and that of the nearest goal",
    "rotation",
    HEADLINE | MEDIAN,
    needs_position=False,
)
MSSD = Quantity(
    "mssd_mm",
    "MSSD",
    MILLIMETRE,
    "Largest distance of any point of the part from its place at the nearest goal, symmetry-aware",
    "mssd",
    HEADLINE,
)
SEATED = Quantity(
    "seated",
    "Seated",
    PERCENT,
    "Share of predictions that pass the seating test: the part goes into its slot, within 10° of its goal",
    "seated",
    HEADLINE,
    decimals=1,
    rate=True,
    higher_is_better=True,
)
STRICT = Quantity(
    "seated_strict",
    "Strict",
    PERCENT,
    "Share of predictions that pass the seating test with 1 mm in place of 3 mm",
    "seated",
    SHORT,
    decimals=1,
    rate=True,
    higher_is_better=True,
)
BEYOND = Quantity(
    "beyond",
    "Far off",
    PERCENT,
    "Share of predictions more than 5 mm or 10° from the nearest goal",
    "position",
    decimals=1,
    rate=True,
    per_query=False,
)
PENETRATION = Quantity(
    "penetration_mm", "Penetration", MILLIMETRE, "Depth of the prediction below first contact", "penetration"
)
POSITION_PLAIN = Quantity(
    "position_plain_mm",
    "Position, plain",
    MILLIMETRE,
    "Position error to one fixed goal, the one that the guess was drawn around",
    "position",
)
ROTATION_PLAIN = Quantity(
    "rotation_plain_deg",
    "Rotation, plain",
    DEGREE,
    "Rotation error to one fixed goal, the one that the guess was drawn around",
    "rotation",
    needs_position=False,
)
SECONDS = Quantity(
    "seconds", "Time", SECOND, "Mean time of a query, as its authors measured it", None, SHORT, needs_position=False
)

QUANTITIES = (
    POSITION, ROTATION, MSSD, SEATED, STRICT, BEYOND, PENETRATION, POSITION_PLAIN, ROTATION_PLAIN, SECONDS,
)  # fmt: skip
"""All of them, in the order of every table."""


def shown_in(output: Output) -> tuple[Quantity, ...]:
    """The quantities of an output, in order."""
    return tuple(quantity for quantity in QUANTITIES if output in quantity.outputs)


def per_query() -> tuple[Quantity, ...]:
    """The quantities measured query by query, in order."""
    return tuple(quantity for quantity in QUANTITIES if quantity.per_query)
