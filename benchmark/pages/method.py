"""The page of a method: its scores in all tracks, and for each track its errors, groups of queries and single cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from benchmark import quantities
from benchmark.curve_charts import panel
from benchmark.curves import CURVES
from benchmark.entries import Entry
from benchmark.pages.board import NO_VALUE, Cell, mean_cell, median_cell, percent, scale_end
from benchmark.quantities import Quantity
from benchmark.summary import TITLES, group_order
from kit1000.pictures.charts import Axis, Dot, Line, dot_plot, histogram, line_chart, rounded_up
from kit1000.queries.tracks import TRACKS

BINNED = ("tilt", "visible")  # properties whose groups are bins
CASE_TITLES = {"worst": "Largest errors", "middle": "Errors nearest to the median"}


@dataclass(frozen=True, eq=False)
class CaseRow:
    """A single query with the prediction for it."""

    query_id: str
    cells: Sequence[str]
    """Its quantities, in the order of `quantities.shown_in("cases")`."""
    caption: str
    """Caption of its picture."""
    picture: str | None
    """Its file, relative to the page."""


@dataclass(frozen=True, eq=False)
class Group:
    """A row of a breakdown."""

    name: str
    n: int
    cells: Sequence[Cell]


@dataclass(frozen=True, eq=False)
class TrackSection:
    """The section of a page about one track."""

    name: str
    n: int
    charts: Sequence[Markup]
    groups: Mapping[str, Sequence[Group]]
    """Groups by title of their property."""
    cases: Mapping[str, Sequence[CaseRow]]
    """Cases by title of the list."""


def tracks_of(entry: Entry) -> list[str]:
    """The tracks that a method was scored on, in the order of the board."""
    scored = entry.scores["tracks"]
    return [*(track for track in TRACKS if track in scored), *sorted(set(scored) - set(TRACKS))]


def summary_rows(entry: Entry) -> list[dict[str, Any]]:
    """The rows of the table of all tracks: every quantity, some with their median."""
    rows = []
    for track in tracks_of(entry):
        scored = entry.scores["tracks"][track]
        cells = []
        for quantity in quantities.QUANTITIES:
            cells.append(mean_cell(quantity, scored))
            cells += [median_cell(quantity, scored)] if "median" in quantity.outputs else []
        rows.append({"track": track, "n": scored["n"], "coverage": percent(scored["coverage"]), "cells": cells})
    return rows


def overview_charts(entry: Entry) -> list[Markup]:
    """The main error and the seated rate in all tracks: means with their intervals."""
    charts = []
    error = quantities.ROTATION if entry.manifest.predicts == "rotation" else quantities.MSSD
    rows = {track: entry.scores["tracks"][track] for track in tracks_of(entry)}
    for quantity in (error, quantities.SEATED):
        dots = [_dot(quantity, track, row) for track, row in rows.items() if row.get(quantity.key) is not None]
        if dots:
            axis = Axis(f"{quantity.name} [{quantity.unit.symbol}]", scale_end(quantity, list(rows.values())))
            description = "Mean and 95 % interval in each track."
            charts.append(Markup(dot_plot(f"{quantity.name} by track", description, dots, axis)))
    return charts


def curve_charts(entry: Entry) -> list[Markup]:
    """Both robustness curves; none where they were not scored."""
    table = entry.scores["curves"]
    return [Markup(panel(curve, table)) for curve in CURVES] if table else []


def track_section(entry: Entry, track: str, pictures: Mapping[str, str]) -> TrackSection:
    """The section about a track; `pictures`: files by query id."""
    scored = entry.scores["tracks"][track]
    cases = {title: [_case(row, pictures) for row in scored[key]] for key, title in CASE_TITLES.items()}
    charts = [*_histograms(scored), *_risk_coverage(scored)]
    return TrackSection(track, scored["n"], charts, _groups(entry.scores["breakdown"].get(track, {})), cases)


def _dot(quantity: Quantity, name: str, row: Mapping[str, Any]) -> Dot:
    value, interval = quantity.estimate(row)
    low, high = interval or (None, None)
    return Dot(name, value, low, high, "" if value is None else quantity.text(value))


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


def _groups(breakdown: Mapping[str, Any]) -> dict[str, list[Group]]:
    """The groups of a track by title of their property."""
    shown = quantities.shown_in("breakdown")
    rows = [row for named in breakdown.values() for row in named.values()]
    ends = {quantity: scale_end(quantity, rows) for quantity in shown}
    known = [*(key for key in TITLES if key in breakdown), *sorted(set(breakdown) - set(TITLES))]
    return {
        TITLES.get(key, key): [
            Group(_group_name(key, name), row["n"], [mean_cell(quantity, row, ends[quantity]) for quantity in shown])
            for name, row in sorted(breakdown[key].items(), key=lambda item: group_order(item[0]))
        ]
        for key in known
    }


def _group_name(key: str, name: str) -> str:
    if name.endswith("+"):
        return f"{name[:-1]} and more"
    return name.replace("-", " to ") if key in BINNED else name


def _case(row: Mapping[str, Any], pictures: Mapping[str, str]) -> CaseRow:
    cells = [_case_cell(quantity, row[quantity.key]) for quantity in quantities.shown_in("cases")]
    pose = (quantities.POSITION, quantities.ROTATION)
    errors = [f"{each.text(row[each.key])}{each.unit.suffix}" for each in pose if row[each.key] is not None]
    seated = {None: [], True: ["seated"], False: ["not seated"]}[row[quantities.SEATED.key]]
    return CaseRow(row["query_id"], cells, " · ".join([*errors, *seated]), pictures.get(row["query_id"]))


def _case_cell(quantity: Quantity, value: float | bool | None) -> str:
    if value is None:
        return NO_VALUE
    return ("yes" if value else "no") if quantity.rate else quantity.text(value)
