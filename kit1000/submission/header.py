"""The first line of a predictions file: which columns stand where, and what parts them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache

from kit1000.submission.faults import Fault, quoted

HEADER = ("query_id", "qw", "qx", "qy", "qz", "x", "y", "z", "confidence", "seconds")
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*\Z", re.ASCII)
LOCAL_NUMBER = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*\Z", re.ASCII)  # as much of Europe writes it
ALIASES = {
    **dict.fromkeys(("id", "query", "queryid", "image_id"), "query_id"),
    "w": "qw",
    **{f"{prefix}{axis}": axis for prefix in ("t", "t_", "p", "pos_", "position_") for axis in "xyz"},
    **{f"{prefix}{axis}": f"q{axis}" for prefix in ("q_", "quat_", "rot_") for axis in "wxyz"},
    **dict.fromkeys(("score", "conf", "probability"), "confidence"),
    **dict.fromkeys(("time", "sec", "secs", "runtime", "duration"), "seconds"),
}


@dataclass(frozen=True)
class Layout:
    """How the rows of a predictions file are to be read."""

    separator: str
    decimal_comma: bool
    """Whether numbers are written 0,5."""
    columns: tuple[int | None, ...]
    """Where each field of HEADER stands in a row; None for one that is missing."""
    width: int
    """Fields of a row."""
    first: int
    """Index of the first line after the header."""

    @property
    def in_order(self) -> bool:
        """Whether rows can be read as they are."""
        order = self.columns == tuple(range(self.width))
        return order and not self.decimal_comma and self.separator != " "


def cut(line: str, separator: str) -> list[tuple[int, str]]:
    """Fields of a line with the index at which each begins; a field may stand in quotes, doubled inside.

    A quote that never closes stays in its field.
    """
    if separator == " ":
        return [(match.start(), match[0]) for match in re.finditer(r"\S+", line)]
    fields, position, pattern = [], 0, _field(separator)
    while position <= len(line):
        match = pattern.match(line, position)
        assert match is not None  # the last alternative takes anything
        inside = match["quoted"]
        fields.append((match.start("field"), match["field"] if inside is None else inside.replace('""', '"')))
        position = match.end() if match["end"] else len(line) + 1
    return fields


@lru_cache
def _field(separator: str) -> re.Pattern[str]:
    """A field and the separator behind it."""
    s = re.escape(separator)
    return re.compile(rf'(?P<field> *"(?P<quoted>(?:[^"]|"")*)" *(?=\Z|{s})|[^{s}]*)(?P<end>{s}|)')


def layout_of(lines: Sequence[str], file: str) -> tuple[Layout | None, list[Fault]]:
    """Read the header, and name all that is wrong with it. None when nothing below it can be read either."""
    first = next((i for i, line in enumerate(lines) if line.strip()), 0)
    line = lines[first]
    separator = max(SEPARATORS, key=lambda s: _known(line, s))
    if _known(line, separator) == 0:
        return _without_header(lines, first, file)
    names = [text for _, text in cut(line, separator)]
    starts = [start for start, _ in cut(line, separator)]
    columns, faults = _placed(names, starts, first + 1, file)
    below = [line for line in lines[first + 1 :] if line.strip()][:20]
    layout = Layout(separator, _has_local_numbers(below, separator), columns, len(names), first + 1)
    return layout, _separator_faults(layout, file, first + 1) + faults


def _known(line: str, separator: str) -> int:
    """How many fields of a line are names of columns."""
    return sum(_meant(text) is not None for _, text in cut(line[:2000], separator)) if separator in line else 0


def _meant(name: str) -> str | None:
    """The column that a name stands for, whatever its case."""
    plain = name.strip().lower()
    return plain if plain in HEADER else ALIASES.get(plain)


def _placed(names: list[str], starts: list[int], line: int, file: str) -> tuple[tuple[int | None, ...], list[Fault]]:
    """Where each field stands, and what is wrong with the names."""
    right = ",".join(HEADER)
    faults: list[Fault] = []
    columns: dict[str, int | None] = dict.fromkeys(HEADER)

    def add(i: int, name: str, seen: str, wanted: str, repair: str) -> None:
        faults.append(Fault(file, line, starts[i] + 1, seen, wanted, repair, "error", name))

    for i, name in enumerate(names):
        free = [field for field in HEADER if columns[field] is None and field not in names]
        meant = _meant(name) or _near(name, free)
        if meant is None and not name.strip():
            add(i, "empty-column", f"column {i + 1} has no name", f"{len(HEADER)} columns", "delete the column")
        elif meant is None:
            add(i, "unknown-column", f"column {quoted(name)}", f"one of {', '.join(HEADER)}", "delete the column")
        elif columns[meant] is not None:
            add(i, "double-column", f"column {quoted(name)} once more", "each column once", "delete one of them")
        else:
            columns[meant] = i
            if name != meant:
                add(i, "column-name", f"column {quoted(name)}", f'"{meant}"', f"write {meant}")
    missing = [field for field in HEADER if columns[field] is None]
    if missing:
        seen = f"no column {', '.join(missing)}"
        repair = "add what is missing"
        faults.append(Fault(file, line, 1, seen, f"the header {right}", repair, "error", "missing-column"))
    found = {i: field for field, i in columns.items() if i is not None}
    if list(found) != sorted(found):
        seen = f"columns in the order {','.join(field for _, field in sorted(found.items()))}"
        repair = "move the columns"
        faults.append(Fault(file, line, 1, seen, f"the order {right}", repair, "error", "column-order"))
    return tuple(columns.values()), faults


def _near(name: str, fields: list[str]) -> str | None:
    found = get_close_matches(name.strip().lower()[:40], [field for field in fields if len(field) > 2], n=1, cutoff=0.7)
    return found[0] if found else None


def _separator_faults(layout: Layout, file: str, line: int) -> list[Fault]:
    faults = []
    if layout.separator != ",":
        seen = f"columns are parted by {SEPARATORS[layout.separator]}"
        repair = "save with the comma as separator and the point as decimal mark"
        faults.append(Fault(file, line, None, seen, "commas", repair, "error", "separator"))
    if layout.decimal_comma:
        repair = "save with the point as decimal mark"
        faults.append(Fault(file, None, None, "numbers have a decimal comma", "0.5", repair, "error", "decimal-comma"))
    return faults


def _has_local_numbers(lines: list[str], separator: str) -> bool:
    """Whether numbers are written 0,5 in the rows below a header of another separator."""
    if separator == ",":
        return False
    return any(LOCAL_NUMBER.match(text) for line in lines for _, text in cut(line[:2000], separator))


def _without_header(lines: Sequence[str], first: int, file: str) -> tuple[Layout | None, list[Fault]]:
    """The layout of a file the first line of which names no column."""
    right, line = ",".join(HEADER), lines[first]
    separator = max(SEPARATORS, key=lambda s: _numbers(line, s))
    if _numbers(line, separator) >= len(HEADER) - 2:  # a row of predictions, one or two of its numbers at fault
        seen = f"no header, the first line is {quoted(line)}"
        fault = Fault(file, first + 1, 1, seen, f"the header {right}", f"put {right} before it", "error", "no-header")
        layout = Layout(separator, _has_local_numbers([line], separator), tuple(range(len(HEADER))), len(HEADER), first)
        return layout, [fault, *_separator_faults(layout, file, first + 1)]
    seen = f"the first line is {quoted(line)}{_resembles(line)}"
    fault = Fault(file, first + 1, 1, seen, f"the header {right}", f"write {right}", "error", "no-header")
    below = [text for text in lines[first + 1 :] if text.strip()][:1]
    if below and _numbers(below[0], ",") >= len(HEADER) - 2:
        return Layout(",", False, tuple(range(len(HEADER))), len(HEADER), first + 1), [fault]
    return None, [fault]


def _numbers(line: str, separator: str) -> int:
    """How many fields of a line are numbers, none if there are far too few or too many."""
    texts = [text for _, text in cut(line[:2000], separator)]
    local = separator != "," and any(map(LOCAL_NUMBER.match, texts))
    return sum(bool(NUMBER.match(t) or (local and LOCAL_NUMBER.match(t))) for t in texts) if len(texts) <= 12 else 0


def _resembles(line: str) -> str:
    """What else the file may be."""
    if line.lstrip()[:1] in ("{", "["):
        return " as of a JSON file"
    return " as of a web page" if line.lstrip()[:1] == "<" else ""
