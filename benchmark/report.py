"""Scores as text: the table for a terminal, and scores.json."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from benchmark import quantities
from benchmark.quantities import Quantity

WIDTH = 150  # of a line of JSON that holds a whole object or list
DIGITS = 6  # significant ones of a number
DECIMALS = 9  # of a number, so that rounding noise of the last bits reads as 0
NO_VALUE = "-"  # in a table, where nothing was measured


def json_text(value: Any) -> str:
    """A JSON value as text: keys sorted, numbers to six digits, short values on one line; always the same bytes."""
    return _laid_out(rounded(value), "") + "\n"


def rounded(value: Any) -> Any:
    """A JSON value with every number to six significant digits, and no finer than 1e-9."""
    if isinstance(value, float):
        return round(float(f"{value:.{DIGITS}g}"), DECIMALS) + 0.0  # the sum makes -0.0 a 0.0
    if isinstance(value, Mapping):
        return {key: rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(inner) for inner in value]
    return value


def _laid_out(value: Any, indent: str) -> str:
    line = json.dumps(value, sort_keys=True, allow_nan=False, ensure_ascii=False)
    if len(indent) + len(line) <= WIDTH or not value or not isinstance(value, dict | list):
        return line
    deeper = indent + " "
    if isinstance(value, list):
        rows, ends = [_laid_out(inner, deeper) for inner in value], "[]"
    else:
        named = ((json.dumps(key, ensure_ascii=False), value[key]) for key in sorted(value))
        rows, ends = [f"{name}: {_laid_out(inner, deeper)}" for name, inner in named], "{}"
    return ends[0] + "\n" + ",\n".join(deeper + row for row in rows) + "\n" + indent + ends[1]


def score_text(summary: Mapping[str, Any], with_breakdown: bool = False) -> str:
    """The table of a score, below its method, dataset and protocol; on request with its breakdown."""
    versions = ", ".join(f"{name}@v{version}" for name, version in sorted(summary["metric_versions"].items()))
    lines = [
        f"{summary['method']}  on {summary['dataset_id']}, split {summary['split']}",
        f"protocol {summary['protocol']} ({summary['status']}), commit {summary['commit'][:12]}"
        f"{'-dirty' if summary['commit'].endswith('-dirty') else ''}; {versions}",
        "",
    ]
    if summary["tracks"]:
        shown = quantities.shown_in("text")
        headings = ["track", "n", "cover %", *(quantity.heading for quantity in shown)]
        lines += table(headings, [_track_cells(name, row, shown) for name, row in summary["tracks"].items()])
        lines += [
            "",
            "mean [95 % interval]; per cent with Wilson's interval; a missing prediction counts as no motion",
        ]
    if summary["curves"] is not None:
        n = sum(row["n"] for rows in summary["curves"].values() for row in rows)
        scenes = f"about the first {summary['curve_scenes']} scenes"
        lines += ["", f"curves: {n} queries {scenes}, see scores.json and `python -m benchmark curves`"]
    for track, groups in summary["breakdown"].items() if with_breakdown else ():
        shown = quantities.shown_in("breakdown")
        headings = ["", "", "n", *(quantity.heading for quantity in shown)]
        lines += ["", track, *table(headings, list(_group_cells(groups, shown)))]
    return "\n".join(lines)


def _track_cells(name: str, row: Mapping[str, Any], shown: Sequence[Quantity]) -> list[str]:
    return [name, str(row["n"]), f"{100 * row['coverage']:.1f}", *(_cell(quantity, row) for quantity in shown)]


def _group_cells(groups: Mapping[str, Any], shown: Sequence[Quantity]) -> Iterable[list[str]]:
    for key, named in groups.items():
        for i, (name, row) in enumerate(named.items()):
            yield ["" if i else key, name, str(row["n"]), *(_cell(quantity, row) for quantity in shown)]


def _cell(quantity: Quantity, row: Mapping[str, Any]) -> str:
    """A mean or a rate with its interval; of a quantity that submissions report, the mean alone."""
    value, interval = quantity.estimate(row)
    if value is None or interval is None:
        return NO_VALUE
    if quantity.metric is None:
        return f"{value:.3g}"
    low, high = interval
    return f"{quantity.text(value)} [{quantity.text(low)}, {quantity.text(high)}]"


def table(headings: Sequence[str], rows: Sequence[Sequence[str]], text: Collection[str] = ("track", "")) -> list[str]:
    """Lines of a table: columns with the headings `text` aligned left, others right; two spaces between columns."""
    cells = [list(headings), *map(list, rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(headings))]
    left = [heading in text for heading in headings]
    return ["  ".join(map(_padded, row, widths, left)).rstrip() for row in cells]


def _padded(text: str, width: int, left: bool) -> str:
    return text.ljust(width) if left else text.rjust(width)
