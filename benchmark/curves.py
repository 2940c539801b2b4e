"""Robustness curves: what a method leaves of a person's error, level by level.

The same queries are asked at every level of one kind of error while the other kind stays: position is read against the
position error that was put in, rotation against the rotation error. The table of both curves stands in scores.json; the
figure is drawn from there, for one method or several, without the dataset.
"""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmark.charts import HUES, Axis, Line, line_chart, rounded_up, standalone
from kit1000.errors import InputError, ShapeError
from kit1000.files import read_json, write_bytes
from kit1000.guesses import LEVELS, level_angle, level_offset
from kit1000.tracks import curve_levels

BAND = (20, 80)  # percentiles about each line, as in the paper
LINE_HUES = (0, 3, 1)  # of the errors that stay: the largest is red and dotted, as in the paper
BANDS = 4  # of one chart, beyond which nobody tells them apart: then lines stand without
STATISTICS = ("n", "mean", "median", "p20", "p80")
COLUMNS = ("method", "curve", "user", "user_unit", "fixed", "fixed_unit", "level", *STATISTICS)

Row = dict[str, Any]
Table = Mapping[str, Sequence[Mapping[str, Any]]]


@dataclass(frozen=True)
class Unit:
    """How a kind of error is measured."""

    name: str
    """As keys end with it."""
    sign: str
    """As a number is followed by it, and `label` on an axis."""
    label: str
    lengths: tuple[float, ...]
    """Of the levels."""


@dataclass(frozen=True)
class Curve:
    """One of the two figures: which error runs, and which one stays."""

    name: str
    """Its key in the table."""
    other: str
    runs: str
    """As query ids write it."""
    unit: Unit
    fixed_unit: Unit

    def user(self, row: Mapping[str, Any]) -> float:
        """The error that was put in, of the kind that runs."""
        return row[f"user_{self.unit.name}"]

    def fixed(self, row: Mapping[str, Any]) -> float:
        """The error that was put in, of the kind that stays."""
        return row[f"fixed_{self.fixed_unit.name}"]

    def fixed_errors(self, *tables: Table) -> list[float]:
        """The errors that stay, of all lines of some tables, smallest first."""
        return sorted({self.fixed(row) for table in tables for row in table[self.name]})


MM = Unit("mm", " mm", "mm", tuple(1000 * level_offset(level) for level in range(LEVELS)))
DEG = Unit("deg", "°", "degrees", tuple(float(np.degrees(level_angle(level))) for level in range(LEVELS)))
CURVES = (Curve("position", "rotation", "pos", MM, DEG), Curve("rotation", "position", "rot", DEG, MM))


def curve_table(query_ids: Sequence[str], position_mm: ArrayLike, rotation_deg: ArrayLike) -> dict[str, list[Row]]:
    """Both curves from the errors of single queries.

    Args:
        query_ids: n ids of the curves, such as curves-s0007-p2-pos3-rot1, in any order; the set may be thinned.
        position_mm: (n,) position errors [mm]; NaN where a method answers with a rotation alone.
        rotation_deg: (n,) rotation errors [degrees].

    Returns:
        Under "position" and "rotation" a row for every fixed error and level that was asked, in this order: the fixed
        error and that of the level in mm and degrees, n, and of what is left mean, median, 20th and 80th percentile,
        null where it is not known.
    """
    left = {
        "pos": _errors("position_mm", position_mm, query_ids),
        "rot": _errors("rotation_deg", rotation_deg, query_ids),
    }
    groups: dict[tuple[str, int, int], list[float]] = defaultdict(list)
    for i, query_id in enumerate(query_ids):
        runs, level, fixed = curve_levels(query_id)
        groups[runs, fixed, level].append(left[runs][i])
    return {
        curve.name: [
            _row(curve, fixed, level, groups[runs, fixed, level])
            for runs, fixed, level in sorted(groups)
            if runs == curve.runs
        ]
        for curve in CURVES
    }


def write_curves(submissions: Sequence[Path], out: Path) -> tuple[Path, Path]:
    """Draw the curves of one method or several and write their numbers beside: curves.svg and curves.csv in a folder.

    Args:
        submissions: folders that hold a scores.json, or such files.
        out: the folder; made where it is missing.
    """
    curves = dict(map(_scored, submissions))
    if len(curves) < len(submissions):
        raise InputError(f"curves: expected methods of different names, got {', '.join(map(str, submissions))}")
    picture, numbers = out / "curves.svg", out / "curves.csv"
    write_bytes(picture, figure(curves).encode())
    write_bytes(numbers, curve_csv(curves).encode())
    return picture, numbers


def figure(curves: Mapping[str, Table]) -> str:
    """An SVG file of curves by name of method: one as in the paper, several in a row for each error that stays."""
    if not curves:
        raise InputError("curves: expected at least one method")
    if len(curves) == 1:
        return standalone([[panel(curve, table) for curve in CURVES] for table in curves.values()])
    return standalone([list(filter(None, row)) for row in zip_longest(*(compared(curve, curves) for curve in CURVES))])


def panel(curve: Curve, table: Table) -> str:
    """One curve of one method: a line with its band for every error that stays."""
    lines = []
    for i, fixed in enumerate(curve.fixed_errors(table)):
        rows = [row for row in table[curve.name] if curve.fixed(row) == fixed]
        lines.append(_line(curve, rows, f"{fixed:.3g}{curve.fixed_unit.sign}", hue=LINE_HUES[i % 3], dash=i))
    return _drawn(curve, lines, table[curve.name], f"{curve.name.capitalize()}, by {curve.other} error")


def compared(curve: Curve, curves: Mapping[str, Table]) -> list[str]:
    """One curve of several methods, a chart for each error that stays."""
    charts = []
    for fixed in curve.fixed_errors(*curves.values()):
        rows = {name: [r for r in table[curve.name] if curve.fixed(r) == fixed] for name, table in curves.items()}
        lines = [_line(curve, own, name, hue=i, dash=i // HUES) for i, (name, own) in enumerate(rows.items())]
        if len(lines) > BANDS:
            lines = [replace(line, low=(), high=()) for line in lines]
        title = f"{curve.name.capitalize()}, at {fixed:.3g}{curve.fixed_unit.sign} {curve.other} error"
        charts.append(_drawn(curve, lines, [row for own in rows.values() for row in own], title))
    return charts


def counts(of_rows: Sequence[int]) -> str:
    """How many queries stand behind each number of some rows: n = 40, or n = 12 to 40 where the set is thinned."""
    fewest, most = min(of_rows, default=0), max(of_rows, default=0)
    return f"n = {most}" if fewest == most else f"n = {fewest} to {most}"


def curve_csv(curves: Mapping[str, Table]) -> str:
    """The numbers behind a figure: a line for each method, curve, fixed error and level."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for method, table in curves.items():
        for curve in CURVES:
            for row in table[curve.name]:
                errors = (curve.user(row), curve.unit.name, curve.fixed(row), curve.fixed_unit.name, row["level"])
                writer.writerow([method, curve.name, *errors, *(row[name] for name in STATISTICS)])
    return text.getvalue()


def _errors(name: str, values: ArrayLike, query_ids: Sequence[str]) -> np.ndarray:
    """(n,) float64, one for each id; NaN is allowed."""
    errors = np.asarray(values, np.float64)
    if errors.shape != (len(query_ids),):
        raise ShapeError(f"{name}: expected shape ({len(query_ids)},), one for each query, got {errors.shape}")
    return errors


def _row(curve: Curve, fixed: int, level: int, errors: Sequence[float]) -> Row:
    asked = {
        f"fixed_{curve.fixed_unit.name}": curve.fixed_unit.lengths[fixed],
        f"user_{curve.unit.name}": curve.unit.lengths[level],
        "level": level,
        "n": len(errors),
    }
    low, high = np.percentile(errors, BAND)
    left = {"mean": np.mean(errors), "median": np.median(errors), "p20": low, "p80": high}
    return asked | {name: float(value) if np.isfinite(value) else None for name, value in left.items()}


def _scored(submission: Path) -> tuple[str, Table]:
    """The name of a scored method and its curves."""
    path = submission / "scores.json" if submission.is_dir() else submission
    scores = read_json(path)
    if not isinstance(scores, dict) or "method" not in scores or "curves" not in scores:
        raise InputError(f"{path}: no scores of a method; `python -m benchmark score` writes them")
    if not scores["curves"]:
        raise InputError(
            f"{path}: {scores['method']} was scored without curves; predict the split `curves` and score again"
        )
    return scores["method"], scores["curves"]


def _line(curve: Curve, rows: Sequence[Mapping[str, Any]], name: str, hue: int, dash: int) -> Line:
    """The means of some rows as a line with their band, by the error that was put in."""
    known = [row for row in rows if row["mean"] is not None]
    means, low, high = ([row[key] for row in known] for key in ("mean", "p20", "p80"))
    return Line(name, [curve.user(row) for row in known], means, low, high, hue, dash)


def _drawn(curve: Curve, lines: Sequence[Line], rows: Sequence[Mapping[str, Any]], title: str) -> str:
    n = counts([row["n"] for row in rows])
    most = rounded_up(max([curve.unit.lengths[-1], *(value for line in lines for value in (*line.y, *line.high))]))
    x = Axis(f"{curve.name} error of the guess [{curve.unit.label}]", curve.unit.lengths[-1])
    y = Axis(f"{curve.name} error left [{curve.unit.label}]", most)
    said = f"Mean, and the band from the 20th to the 80th percentile; {n} at each level. Straight: the guess unchanged."
    return line_chart(title, said, lines, x, y, given=True, note=n)
