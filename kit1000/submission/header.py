"""The header of a predictions file: the separator, and the position of each column."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache

from kit1000.submission.faults import Fault, quote

HEADER = ("query_id", "qw", "qx", "qy", "qz", "x", "y", "z", "confidence", "seconds")
SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*\Z", re.ASCII)
COMMA_NUMBER = re.compile(r"\s*[+-]?\d+,\d+([eE][+-]?\d+)?\s*\Z", re.ASCII)  # with a decimal comma
SEPARATOR_LINE = re.compile(
    r"""\s*["']?sep=(.|\\t)["']?[\s,;]*\Z""", re.IGNORECASE
)  # for spreadsheets, before the header
COLUMN_ALIASES = {
    **dict.fromkeys(("id", "query", "queryid", "image_id"), "query_id"),
    "w": "qw",
    **{f"{prefix}{axis}": axis for prefix in ("t", "t_", "p", "pos_", "position_") for axis in "xyz"},
    **{f"{prefix}{axis}": f"q{axis}" for prefix in ("q_", "quat_", "rot_") for axis in "wxyz"},
    **dict.fromkeys(("score", "conf", "probability"), "confidence"),
    **dict.fromkeys(("time", "sec", "secs", "runtime", "duration"), "seconds"),
}


@dataclass(frozen=True)
class Layout:
    """The format of the rows of a predictions file."""

    separator: str
    decimal_comma: bool
    """Whether numbers are written as 0,5."""
    columns: tuple[int | None, ...]
    """Index in a row of each column of HEADER; None for a missing column."""
    width: int
    """Number of fields of a row."""
    first: int
    """Index of the first line after the header."""

    @property
    def in_order(self) -> bool:
        """Whether rows can be split at the separator and read without reordering."""
        order = self.columns == tuple(range(self.width))
        return order and not self.decimal_comma and self.separator != " "


def split_fields(line: str, separator: str) -> list[tuple[int, str]]:
    """The fields of a line, each with the index where it begins. A field may be quoted, with doubled quotes inside.

    A quote that is not closed is kept in its field.
    """
    if separator == " ":
        return [(match.start(), match[0]) for match in re.finditer(r"\S+", line)]
    fields, position, pattern = [], 0, _field_pattern(separator)
    while position <= len(line):
        match = pattern.match(line, position)
        assert match is not None  # the last alternative matches any text
        quoted = match["quoted"]
        fields.append((match.start("field"), match["field"] if quoted is None else quoted.replace('""', '"')))
        position = match.end() if match["end"] else len(line) + 1
    return fields


@lru_cache
def _field_pattern(separator: str) -> re.Pattern[str]:
    """A field and the separator after it."""
    s = re.escape(separator)
    return re.compile(rf'(?P<field> *"(?P<quoted>(?:[^"]|"")*)" *(?=\Z|{s})|[^{s}]*)(?P<end>{s}|)')


def read_layout(lines: Sequence[str], file: str) -> tuple[Layout | None, list[Fault]]:
    """The layout that a header describes, and all faults of the header; None when no row can be read."""
    filled = (i for i, line in enumerate(lines) if line.strip())
    first, notes = next(filled, 0), []
    if SEPARATOR_LINE.match(lines[first]):
        actual, repair = f"a line {quote(lines[first].strip())} of a spreadsheet", "delete the line; it is skipped"
        notes = [Fault(file, first + 1, 1, actual, "the header", repair, "warning", "separator-line")]
        first = next(filled, first)
    layout, faults = _layout_from(lines, first, file)
    return layout, [*notes, *faults]


def _layout_from(lines: Sequence[str], first: int, file: str) -> tuple[Layout | None, list[Fault]]:
    """The layout that a line, counted from 0, describes as the header; all faults of it."""
    line = lines[first]
    separator = max(SEPARATORS, key=lambda s: _count_names(line, s))
    if _count_names(line, separator) == 0:
        return _missing_header(lines, first, file)
    names = [text for _, text in split_fields(line, separator)]
    starts = [start for start, _ in split_fields(line, separator)]
    columns, faults = _read_columns(names, starts, first + 1, file)
    below = [line for line in lines[first + 1 :] if line.strip()][:20]
    layout = Layout(separator, _has_decimal_commas(below, separator), columns, len(names), first + 1)
    return layout, _separator_faults(layout, file, first + 1) + faults


def _count_names(line: str, separator: str) -> int:
    """The number of fields of a line that are column names."""
    if separator not in line:
        return 0
    return sum(_column_name(text) is not None for _, text in split_fields(line[:2000], separator))


def _column_name(name: str) -> str | None:
    """The column that a name means, in any case; None for an unknown name."""
    plain = name.strip().lower()
    return plain if plain in HEADER else COLUMN_ALIASES.get(plain)


def _read_columns(
    names: list[str], starts: list[int], line: int, file: str
) -> tuple[tuple[int | None, ...], list[Fault]]:
    """The index of each column of HEADER, and the faults of the names."""
    header = ",".join(HEADER)
    faults: list[Fault] = []
    columns: dict[str, int | None] = dict.fromkeys(HEADER)

    def add(i: int, code: str, actual: str, expected: str, repair: str) -> None:
        faults.append(Fault(file, line, starts[i] + 1, actual, expected, repair, "error", code))

    for i, name in enumerate(names):
        free = [field for field in HEADER if columns[field] is None and field not in names]
        column = _column_name(name) or _similar_field(name, free)
        if column is None and not name.strip():
            add(i, "empty-column", f"column {i + 1} has no name", f"{len(HEADER)} columns", "delete the column")
        elif column is None:
            add(i, "unknown-column", f"column {quote(name)}", f"one of {', '.join(HEADER)}", "delete the column")
        elif columns[column] is not None:
            add(i, "duplicate-column", f"a second column {quote(name)}", "each column once", "delete one of them")
        else:
            columns[column] = i
            if name != column:
                add(i, "column-name", f"column {quote(name)}", f'"{column}"', f"rename it to {column}")
    missing = [field for field in HEADER if columns[field] is None]
    if missing:
        actual, repair = f"no column {', '.join(missing)}", "add the missing columns"
        faults.append(Fault(file, line, 1, actual, f"the header {header}", repair, "error", "missing-column"))
    present = {i: field for field, i in columns.items() if i is not None}
    if list(present) != sorted(present):
        actual = f"columns in the order {','.join(field for _, field in sorted(present.items()))}"
        expected, repair = f"the order {header}", "reorder the columns"
        faults.append(Fault(file, line, 1, actual, expected, repair, "error", "column-order"))
    return tuple(columns.values()), faults


def _similar_field(name: str, fields: list[str]) -> str | None:
    long_fields = [field for field in fields if len(field) > 2]
    similar = get_close_matches(name.strip().lower()[:40], long_fields, n=1, cutoff=0.7)
    return similar[0] if similar else None


def _separator_faults(layout: Layout, file: str, line: int) -> list[Fault]:
    faults = []
    if layout.separator != ",":
        actual = f"columns are separated by {SEPARATORS[layout.separator]}"
        repair = "save with commas as separators and decimal points"
        faults.append(Fault(file, line, None, actual, "commas", repair, "error", "separator"))
    if layout.decimal_comma:
        actual, repair = "numbers have a decimal comma", "save with decimal points"
        faults.append(Fault(file, None, None, actual, "a decimal point, as in 0.5", repair, "error", "decimal-comma"))
    return faults


def _has_decimal_commas(lines: list[str], separator: str) -> bool:
    """Whether numbers are written as 0,5 in rows with a separator other than the comma."""
    if separator == ",":
        return False
    return any(COMMA_NUMBER.match(text) for line in lines for _, text in split_fields(line[:2000], separator))


def _missing_header(lines: Sequence[str], first: int, file: str) -> tuple[Layout | None, list[Fault]]:
    """The layout of a file whose first line names no column."""
    header, line = ",".join(HEADER), lines[first]
    expected = f"the header {header}"
    separator = max(SEPARATORS, key=lambda s: _count_numbers(line, s))
    if _count_numbers(line, separator) >= len(HEADER) - 2:  # a row of predictions with at most one or two faults
        actual, repair = f"no header; the first line is {quote(line)}", f"insert the line {header}"
        fault = Fault(file, first + 1, 1, actual, expected, repair, "error", "missing-header")
        decimal_comma = _has_decimal_commas([line], separator)
        layout = Layout(separator, decimal_comma, tuple(range(len(HEADER))), len(HEADER), first)
        return layout, [fault, *_separator_faults(layout, file, first + 1)]
    actual, repair = f"the first line is {quote(line)}{_file_kind(line)}", f"replace it by {header}"
    fault = Fault(file, first + 1, 1, actual, expected, repair, "error", "missing-header")
    below = [text for text in lines[first + 1 :] if text.strip()][:1]
    if below and _count_numbers(below[0], ",") >= len(HEADER) - 2:
        return Layout(",", False, tuple(range(len(HEADER))), len(HEADER), first + 1), [fault]
    return None, [fault]


def _count_numbers(line: str, separator: str) -> int:
    """The number of fields of a line that are numbers; 0 for a line with more than 12 fields."""
    texts = [text for _, text in split_fields(line[:2000], separator)]
    if len(texts) > 12:
        return 0
    commas = separator != "," and any(map(COMMA_NUMBER.match, texts))
    return sum(bool(NUMBER.match(text) or (commas and COMMA_NUMBER.match(text))) for text in texts)


def _file_kind(line: str) -> str:
    """The kind of file that begins with such a line, for a message."""
    if line.lstrip()[:1] in ("{", "["):
        return ", as in a JSON file"
    return ", as in a web page" if line.lstrip()[:1] == "<" else ""
