"""The page of a method: its scores in all tracks, and for each track its errors, groups of queries and single cases."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from benchmark import quantities
from benchmark.curve_charts import panel
from benchmark.curves import CURVES
from benchmark.entries import Entry
from benchmark.pages.board import NO_VALUE, Cell, mean_cell, scale_end
from benchmark.quantities import Quantity
from benchmark.summary import TITLES, group_order
from kit1000.pictures.charts import Axis, Line, histogram, line_chart, rounded_up
from kit1000.queries.tracks import TRACKS

BINNED = ("tilt", "visible")  # properties whose groups are bins
CASE_TITLES = {"worst": "Largest errors", "middle": "Errors nearest to the median"}


def tracks_of(entry: Entry) -> list[str]:
    """The tracks that a method was scored on, in the order of the board."""
    scored = entry.scores["tracks"]
    return [*(track for track in TRACKS if track in scored), *sorted(set(scored) - set(TRACKS))]


def curve_charts(entry: Entry) -> list[Markup]:
    """Both robustness curves; none if they were not scored."""
    table = entry.scores["curves"]
    return [Markup(panel(curve, table)) for curve in CURVES] if table else []


def track_charts(scored: Mapping[str, Any]) -> list[Markup]:
    """Histograms of the errors in a track, and errors by confidence."""
    return [*_histograms(scored), *_risk_coverage(scored)]


def _histograms(scored: Mapping[str, Any]) -> list[Markup]:
    charts = []
    for quantity in quantities.QUANTITIES:
        bins = scored["histograms"].get(quantity.key)
        if bins is not None:
            description = "Number of predictions with an error in each bin; bins grow wider towards large errors."
            label = f"{quantity.name.lower()} error [{quantity.unit.label}], bins of unequal width"
            title = f"{quantity.name} errors"
            charts.append(Markup(histogram(title, description, bins["edges"], bins["counts"], label)))
    return charts


def _risk_coverage(scored: Mapping[str, Any]) -> list[Markup]:
    """The error and the seated rate of the most confident predictions, over their share of all."""
    points = scored["risk_coverage"]
    x = Axis("most confident predictions [%]", 100.0)
    share = [100 * value for value in points["coverage"]]
    charts = []
    for quantity in (quantities.MSSD, quantities.SEATED):
        if points[quantity.key] is None:
            continue
        values = [quantity.scale * value for value in points[quantity.key]]
        end = 100.0 if quantity.rate else rounded_up(max(values))
        name = quantity.name.lower() if quantity.rate else f"mean {quantity.name}"
        description = "Of the most confident predictions, from a few up to all."
        line, y = Line(quantity.name, share, values, hue=0), Axis(f"{name} [{quantity.unit.symbol}]", end)
        charts.append(Markup(line_chart(f"{quantity.name} by confidence", description, [line], x, y)))
    return charts


def groups(breakdown: Mapping[str, Any]) -> dict[str, list[tuple[str, int, list[Cell]]]]:
    """The groups of queries in a track by title of their property: name, number of queries, and quantities."""
    shown = quantities.shown_in("breakdown")
    rows = [row for named in breakdown.values() for row in named.values()]
    ends = {quantity: scale_end(quantity, rows) for quantity in shown}
    known = [*(key for key in TITLES if key in breakdown), *sorted(set(breakdown) - set(TITLES))]
    return {
        TITLES.get(key, key): [
            (_group_name(key, name), row["n"], [mean_cell(quantity, row, ends[quantity]) for quantity in shown])
            for name, row in sorted(breakdown[key].items(), key=lambda item: group_order(item[0]))
        ]
        for key in known
    }


def _group_name(key: str, name: str) -> str:
    if name.endswith("+"):
        return f"{name[:-1]} and more"
    return name.replace("-", " to ") if key in BINNED else name


def case_text(quantity: Quantity, value: float | bool | None) -> str:
    """A quantity of a single query."""
    if value is None:
        return NO_VALUE
    return ("yes" if value else "no") if quantity.rate else quantity.text(value)
