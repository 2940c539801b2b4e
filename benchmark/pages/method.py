"""The page of a method: its scores in all tracks, and behind each track its errors, groups of queries and cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from benchmark.charts import Axis, Dot, Line, dot_plot, histogram, line_chart, rounded_up
from benchmark.curves import CURVES, panel
from benchmark.pages import numbers
from benchmark.pages.entries import Entry
from benchmark.pages.numbers import Cell, Quantity, mean_cell, mean_of, median_cell, most_of
from kit1000.tracks import TRACKS

THINGS = {
    "rest_mode": "How the part lies",
    "tilt": "Tilt of the slot, °",
    "kits": "Kits in the assembly",
    "family": "Family of the part in training",
    "visible": "Share of the part that is seen",
    "symmetry": "Goals of the slot",
    "loose": "Another pose fits too",
}
"""What the breakdown splits by, in the order of the page."""
SUMMED = (
    numbers.POSITION,
    numbers.ROTATION,
    numbers.MSSD,
    numbers.SEATED,
    numbers.STRICT,
    numbers.BEYOND,
    numbers.PENETRATION,
    numbers.POSITION_PLAIN,
    numbers.ROTATION_PLAIN,
    numbers.SECONDS,
)
WITH_MEDIAN = (numbers.POSITION, numbers.ROTATION)
GROUPED = (numbers.POSITION, numbers.ROTATION, numbers.MSSD, numbers.SEATED)
KINDS = {"worst": "The worst answers", "middle": "Answers nearest to the median"}


@dataclass(frozen=True, eq=False)
class Case:
    """An answer to a single query."""

    query_id: str
    position: str
    rotation: str
    mssd: str
    seated: bool | None
    picture: str | None
    """Its file, beside the page."""


@dataclass(frozen=True, eq=False)
class Group:
    """A row of a breakdown."""

    name: str
    n: int
    cells: Sequence[Cell]


@dataclass(frozen=True, eq=False)
class TrackPart:
    """What a page says of a track."""

    name: str
    n: int
    charts: Sequence[Markup]
    groups: Mapping[str, Sequence[Group]]
    """By what they are split by, as a reader knows it."""
    cases: Mapping[str, Sequence[Case]]
    """By kind, as a reader knows it."""


def tracks_of(entry: Entry) -> list[str]:
    """The tracks that a method was scored on, in the order of the board."""
    scored = entry.scores["tracks"]
    return [*(track for track in TRACKS if track in scored), *sorted(set(scored) - set(TRACKS))]


def summary_rows(entry: Entry) -> list[dict[str, Any]]:
    """The rows of the table of all tracks."""
    rows = []
    for track in tracks_of(entry):
        scored = entry.scores["tracks"][track]
        cells = []
        for quantity in SUMMED:
            cells.append(mean_cell(quantity, scored))
            cells += [median_cell(quantity, scored)] if quantity in WITH_MEDIAN else []
        rows.append({"track": track, "n": scored["n"], "coverage": numbers.percent(scored["coverage"]), "cells": cells})
    return rows


def overview_charts(entry: Entry) -> list[Markup]:
    """The leading number of all tracks, and the share seated: means with their intervals."""
    charts = []
    for quantity in (numbers.ROTATION if entry.manifest.predicts == "rotation" else numbers.MSSD, numbers.SEATED):
        rows = {track: entry.scores["tracks"][track] for track in tracks_of(entry)}
        dots = [_dot(quantity, track, row) for track, row in rows.items() if row.get(quantity.key) is not None]
        if dots:
            axis = Axis(f"{quantity.name} [{quantity.unit}]", most_of(quantity, list(rows.values())))
            said = "Mean and 95 % interval in each track."
            charts.append(Markup(dot_plot(f"{quantity.name} by track", said, dots, axis)))
    return charts


def curve_charts(entry: Entry) -> list[Markup]:
    """Both robustness curves; none where the method was not asked."""
    table = entry.scores["curves"]
    return [Markup(panel(curve, table)) for curve in CURVES] if table else []


def track_part(entry: Entry, track: str, pictures: Mapping[str, str]) -> TrackPart:
    """Everything about a track; `pictures` are files by query id."""
    scored = entry.scores["tracks"][track]
    cases = {title: [_case(row, pictures) for row in scored[kind]] for kind, title in KINDS.items()}
    charts = [*_histograms(scored), *_risk_coverage(scored)]
    return TrackPart(track, scored["n"], charts, _groups(entry.scores["breakdown"].get(track, {})), cases)


def _dot(quantity: Quantity, name: str, row: Mapping[str, Any]) -> Dot:
    value, interval = mean_of(quantity, row)
    low, high = interval or (None, None)
    return Dot(name, value, low, high, "" if value is None else numbers.written(value, quantity))


def _histograms(scored: Mapping[str, Any]) -> list[Markup]:
    titles = {"position_mm": ("Position errors", "mm"), "rotation_deg": ("Rotation errors", "degrees")}
    charts = []
    for key, (title, unit) in titles.items():
        bins = scored["histograms"].get(key)
        if bins is not None:
            said = "How many answers have an error in each bin; bins grow wider towards large errors."
            label = f"{title.lower().removesuffix('s')} [{unit}], bins of unequal width"
            charts.append(Markup(histogram(title, said, bins["edges"], bins["counts"], label)))
    return charts


def _risk_coverage(scored: Mapping[str, Any]) -> list[Markup]:
    """What the most confident answers are worth, by how many of them are taken."""
    points = scored["risk_coverage"]
    across = Axis("most confident answers [%]", 100.0)
    share = [100 * value for value in points["coverage"]]
    charts = []
    for quantity in (numbers.MSSD, numbers.SEATED):
        if points[quantity.key] is None:
            continue
        values = [quantity.scale * value for value in points[quantity.key]]
        most = 100.0 if quantity.rate else rounded_up(max(values))
        unit = f"mean {quantity.name} [{quantity.unit}]" if not quantity.rate else f"seated [{quantity.unit}]"
        said = "Of the most confident answers, from a few up to all."
        line = Line(quantity.name, share, values, hue=0)
        title = f"{quantity.name} by confidence"
        charts.append(Markup(line_chart(title, said, [line], across, Axis(unit, most))))
    return charts


def _groups(breakdown: Mapping[str, Any]) -> dict[str, list[Group]]:
    rows = [row for named in breakdown.values() for row in named.values()]
    most = {quantity: most_of(quantity, rows) for quantity in GROUPED}
    known = [*(thing for thing in THINGS if thing in breakdown), *sorted(set(breakdown) - set(THINGS))]
    return {
        THINGS.get(thing, thing): [
            Group(
                _group_name(thing, name), row["n"], [mean_cell(quantity, row, most[quantity]) for quantity in GROUPED]
            )
            for name, row in sorted(breakdown[thing].items(), key=lambda item: _order(item[0]))
        ]
        for thing in known
    }


def _order(name: str) -> tuple[float, str]:
    """Groups named by numbers, such as 5-15 or 30+, in their order; the others by name."""
    start = name.split("-")[0].removesuffix("+")
    try:
        return float(start), name
    except ValueError:
        return 0.0, name


def _group_name(thing: str, name: str) -> str:
    if name.endswith("+"):
        return f"{name[:-1]} and more"
    return name.replace("-", " to ") if thing in ("tilt", "visible") else name


def _case(row: Mapping[str, Any], pictures: Mapping[str, str]) -> Case:
    shown = {}
    for quantity in (numbers.POSITION, numbers.ROTATION, numbers.MSSD):
        value = row[quantity.key]
        shown[quantity.key] = numbers.NONE if value is None else numbers.written(value, quantity)
    errors = (shown["position_mm"], shown["rotation_deg"], shown["mssd_mm"])
    return Case(row["query_id"], *errors, row["seated"], pictures.get(row["query_id"]))
