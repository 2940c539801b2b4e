"""Scores as text: tables for a terminal and as Markdown, and the JSON of scores.json."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmark import quantities
from benchmark.protocol import masks_of
from benchmark.quantities import Quantity

WIDTH = 150  # characters in a line of JSON that holds a whole object or list
DIGITS = 6  # significant digits of a number
DECIMALS = 9  # of a number, so that rounding noise of the last bits is 0
NO_VALUE = "-"  # in a table for a terminal, if nothing was measured


@dataclass(frozen=True)
class Grid:
    """A table of text cells. The first `words` columns hold words, the others numbers, which are aligned right."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int | Sequence[bool] = 1
    """The number of leading columns with words; or for each column whether it holds words."""

    @property
    def is_text(self) -> list[bool]:
        """For each column whether it holds words."""
        return [i < self.words for i in range(len(self.header))] if isinstance(self.words, int) else list(self.words)

    def text(self, indent: str = "") -> str:
        """The table for a terminal: two spaces between columns."""
        cells = [self.header, *self.rows]
        widths = [max(len(row[i]) for row in cells) for i in range(len(self.header))]
        lines = []
        for row in cells:
            columns = zip(row, widths, self.is_text, strict=True)
            padded = [cell.ljust(width) if left else cell.rjust(width) for cell, width, left in columns]
            lines.append(indent + "  ".join(padded).rstrip())
        return "\n".join(lines)

    def markdown(self) -> str:
        """The table as Markdown. A cell may hold any character; one that is `code` keeps its backticks."""
        rule = ["---" if left else "---:" for left in self.is_text]
        lines = (self.header, rule, *(map(_markdown_cell, row) for row in self.rows))
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _markdown_cell(text: str) -> str:
    return text if re.fullmatch(r"`[^`]*`", text) else re.sub(r"[\\|<*_`]", r"\\\g<0>", text)


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


def versions_text(setting: Mapping[str, Any]) -> str:
    """The versions of the metrics: `mssd@v1, position@v1`."""
    return ", ".join(f"{name}@v{version}" for name, version in sorted(setting["metric_versions"].items()))


def score_text(summary: Mapping[str, Any], with_breakdown: bool = False) -> str:
    """The table of a score, below its method, dataset and protocol; on request with its breakdown."""
    commit = summary["commit"]
    lines = [
        f"{summary['method']}  on {summary['dataset_id']}, split {summary['split']}",
        f"protocol {summary['protocol']} ({summary['status']}), commit {commit[:12]}"
        f"{'-dirty' if commit.endswith('-dirty') else ''}; {versions_text(summary)}",
        "",
    ]
    if summary["tracks"]:
        shown = quantities.shown_in("text")
        header = ["track", "n", "cover %", *(quantity.heading for quantity in shown)]
        rows = []
        for name, row in summary["tracks"].items():
            masks = masks_of(summary, name)
            first = [f"{name}, masks {masks}" if masks else name, str(row["n"]), f"{100 * row['coverage']:.1f}"]
            rows.append([*first, *(_cell(quantity, row) for quantity in shown)])
        note = "mean [95 % interval]; per cent with Wilson's interval; a missing prediction counts as no motion"
        lines += [Grid(header, rows).text(), "", note]
    if summary["curves"] is not None:
        n = sum(row["n"] for rows in summary["curves"].values() for row in rows)
        scenes = f"about the first {summary['curve_scenes']} scenes"
        lines += ["", f"curves: {n} queries {scenes}, see scores.json and `python -m benchmark curves`"]
    for track, groups in summary["breakdown"].items() if with_breakdown else ():
        shown = quantities.shown_in("breakdown")
        header = ["", "", "n", *(quantity.heading for quantity in shown)]
        rows = [
            ["" if i else key, name, str(row["n"]), *(_cell(quantity, row) for quantity in shown)]
            for key, named in groups.items()
            for i, (name, row) in enumerate(named.items())
        ]
        lines += ["", track, Grid(header, rows, words=2).text()]
    return "\n".join(lines)


def _cell(quantity: Quantity, row: Mapping[str, Any]) -> str:
    """A mean or a rate with its interval; the mean alone if submissions report the quantity."""
    value, interval = quantity.estimate(row)
    if value is None or interval is None:
        return NO_VALUE
    if quantity.metric is None:
        return f"{value:.3g}"
    low, high = interval
    return f"{quantity.text(value)} [{quantity.text(low)}, {quantity.text(high)}]"
