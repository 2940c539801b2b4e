"""The figure of the robustness curves and its numbers, from scores.json of one method or several, without a dataset."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

from benchmark.curves import CURVES, Curve, Table
from kit1000.errors import InputError
from kit1000.files import read_json, write_own
from kit1000.pictures.charts import HUES, Axis, Line, line_chart, rounded_up, standalone

LINE_HUES = (0, 3, 1)  # of the fixed errors: the largest is red and dotted, as in the paper
MAX_BANDS = 4  # of one chart: more overlap beyond recognition, then lines are drawn without
STATISTICS = ("n", "mean", "median", "p20", "p80")
COLUMNS = ("method", "curve", "user", "user_unit", "fixed", "fixed_unit", "level", *STATISTICS)


def write_curves(submissions: Sequence[Path], out: Path) -> tuple[Path, Path]:
    """Write the curves of one method or several to a folder: the figure curves.svg and its numbers, curves.csv.

    Args:
        submissions: folders that hold a scores.json, or such files.
        out: the folder; made if it is missing.
    """
    curves = dict(map(_read_curves, submissions))
    if len(curves) < len(submissions):
        raise InputError(f"curves: expected methods of different names, got {', '.join(map(str, submissions))}")
    picture, numbers = out / "curves.svg", out / "curves.csv"
    write_own(picture, figure(curves).encode())
    write_own(numbers, curve_csv(curves).encode())
    return picture, numbers


def figure(curves: Mapping[str, Table]) -> str:
    """An SVG file of curves by name of method: one as in the paper, several with a chart for each fixed error."""
    if not curves:
        raise InputError("curves: expected at least one method")
    if len(curves) == 1:
        return standalone([[panel(curve, table) for curve in CURVES] for table in curves.values()])
    return standalone([list(filter(None, row)) for row in zip_longest(*(compared(curve, curves) for curve in CURVES))])


def panel(curve: Curve, table: Table) -> str:
    """One curve of one method: a line with its band for every fixed error."""
    lines = []
    for i, fixed in enumerate(curve.fixed_errors(table)):
        rows = [row for row in table[curve.name] if curve.fixed(row) == fixed]
        lines.append(_line(curve, rows, f"{fixed:.3g}{curve.fixed_unit.suffix}", hue=LINE_HUES[i % 3], dash=i))
    return _chart(curve, lines, table[curve.name], f"{curve.name.capitalize()}, by {curve.fixed_name} error")


def compared(curve: Curve, curves: Mapping[str, Table]) -> list[str]:
    """One curve of several methods, a chart for each fixed error."""
    charts = []
    for fixed in curve.fixed_errors(*curves.values()):
        rows = {name: [r for r in table[curve.name] if curve.fixed(r) == fixed] for name, table in curves.items()}
        lines = [_line(curve, own, name, hue=i, dash=i // HUES) for i, (name, own) in enumerate(rows.items())]
        if len(lines) > MAX_BANDS:
            lines = [replace(line, low=(), high=()) for line in lines]
        title = f"{curve.name.capitalize()}, at {fixed:.3g}{curve.fixed_unit.suffix} {curve.fixed_name} error"
        charts.append(_chart(curve, lines, [row for own in rows.values() for row in own], title))
    return charts


def counts(of_rows: Sequence[int]) -> str:
    """The number of queries behind each point: n = 40, or n = 12 to 40 if it varies."""
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
                errors = (curve.user(row), curve.unit.text, curve.fixed(row), curve.fixed_unit.text, row["level"])
                writer.writerow([method, curve.name, *errors, *(row[name] for name in STATISTICS)])
    return text.getvalue()


def _read_curves(submission: Path) -> tuple[str, Table]:
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
    """The means of some rows as a line with their band, over the guess's error."""
    known = [row for row in rows if row["mean"] is not None]
    means, low, high = ([row[key] for row in known] for key in ("mean", "p20", "p80"))
    return Line(name, [curve.user(row) for row in known], means, low, high, hue, dash)


def _chart(curve: Curve, lines: Sequence[Line], rows: Sequence[Mapping[str, Any]], title: str) -> str:
    n = counts([row["n"] for row in rows])
    end = rounded_up(max([curve.levels[-1], *(value for line in lines for value in (*line.y, *line.high))]))
    x = Axis(f"{curve.name} error of the guess [{curve.unit.label}]", curve.levels[-1])
    y = Axis(f"{curve.name} error left [{curve.unit.label}]", end)
    description = (
        f"Mean, and the band from the 20th to the 80th percentile; {n} at each level. "
        "Dotted straight line: the initial guess, unchanged."
    )
    return line_chart(title, description, lines, x, y, identity=True, note=n)
