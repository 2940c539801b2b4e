"""Scores as people and other programs read them: the table of a terminal, and the text of scores.json."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

WIDTH = 150  # of a line of JSON that holds a whole object or list
DIGITS = 6  # significant ones of a number
DECIMALS = 9  # of a number, so that rounding noise of the last bits reads as 0
NOTHING = "-"  # in a table, where nothing was measured

HEADINGS = (
    "track", "n", "cover %", "position mm", "rotation deg", "MSSD mm", "seated %", "strict %", "seconds",
)  # fmt: skip
GROUP_HEADINGS = ("", "", "n", "position mm", "rotation deg", "MSSD mm", "seated %")


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


def score_text(summary: Mapping[str, Any], groups: bool = False) -> str:
    """The table of a score, with the lines that say what was scored; `groups`: its breakdown too."""
    versions = ", ".join(f"{name}@v{version}" for name, version in sorted(summary["metric_versions"].items()))
    lines = [
        f"{summary['method']}  on {summary['dataset_id']}, split {summary['split']}",
        f"protocol {summary['protocol']} ({summary['status']}), commit {summary['commit'][:12]}"
        f"{'-dirty' if summary['commit'].endswith('-dirty') else ''}; {versions}",
        "",
    ]
    if summary["tracks"]:
        lines += table(HEADINGS, [_track_line(name, row) for name, row in summary["tracks"].items()])
        lines += [
            "",
            "mean [95 % interval]; per cent with Wilson's interval; a query without an answer counts as no motion",
        ]
    if summary["curves"] is not None:
        asked = sum(row["n"] for rows in summary["curves"].values() for row in rows)
        lines += ["", f"curves: {asked} queries, see scores.json and `python -m benchmark curves`"]
    for track, things in summary["breakdown"].items() if groups else ():
        lines += ["", track, *table(GROUP_HEADINGS, list(_group_lines(things)))]
    return "\n".join(lines)


def _track_line(name: str, row: Mapping[str, Any]) -> list[str]:
    means = [_mean(row[key]) for key in ("position_mm", "rotation_deg", "mssd_mm")]
    rates = [_rate(row[key]) for key in ("seated", "seated_strict")]
    seconds = row["seconds"]
    quick = NOTHING if seconds is None else f"{seconds['mean']:.3g}"
    return [name, str(row["n"]), f"{100 * row['coverage']:.1f}", *means, *rates, quick]


def _group_lines(things: Mapping[str, Any]) -> Iterable[list[str]]:
    for thing, named in things.items():
        for i, (name, row) in enumerate(named.items()):
            means = [_mean(row[key]) for key in ("position_mm", "rotation_deg", "mssd_mm")]
            yield ["" if i else thing, name, str(row["n"]), *means, _rate(row["seated"])]


def _mean(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return NOTHING
    low, high = row["ci95"]
    return f"{row['mean']:.2f} [{low:.2f}, {high:.2f}]"


def _rate(row: Mapping[str, Any] | None) -> str:
    if row is None:
        return NOTHING
    low, high = row["ci95"]
    return f"{100 * row['rate']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table: words to the left, numbers to the right, columns two spaces apart."""
    cells = [list(headings), *map(list, rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(headings))]
    words = [i for i, heading in enumerate(headings) if heading in ("track", "")]
    return ["  ".join(_padded(row[i], widths[i], i in words) for i in range(len(row))).rstrip() for row in cells]


def _padded(text: str, width: int, left: bool) -> str:
    return text.ljust(width) if left else text.rjust(width)
