"""The rows of a predictions file as arrays, and what is wrong with those that cannot be read."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from kit1000.submission.faults import Fault, quoted
from kit1000.submission.header import HEADER, LOCAL_NUMBER, NUMBER, SEPARATORS, Layout, cut, layout_of
from kit1000.submission.numbers import number_fault
from kit1000.submission.reading import STRAY

FIELDS = len(HEADER)
LONGEST_LINE = 2000  # characters; a row of ten fields has some 200
NOT_A_NUMBER = float("nan")
PLAIN = bytes([*b"\t\n", *range(0x20, 0x7F)])  # what a file of ours may hold


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows that have all their fields, n of them; the lines stay at hand to say where a fault stands."""

    file: str
    text: Sequence[str]
    """All lines of the file."""
    layout: Layout
    lines: np.ndarray
    """(n,) int: the line of each row, counted from 1."""
    query_ids: tuple[str, ...]
    numbers: np.ndarray
    """(n, 9) float64: qw qx qy qz, x y z [m], confidence, seconds [s]; NaN where a field is at fault."""

    def __len__(self) -> int:
        return len(self.query_ids)

    def fault(
        self, row: int, field: str, name: str, wanted: str, repair: str, kind: Literal["error", "warning"] = "error"
    ) -> Fault:
        """A fault of a field of a row."""
        column, text = self.cell(row, field)
        return Fault(self.file, int(self.lines[row]), column, f"{field} = {quoted(text)}", wanted, repair, kind, name)

    def cell(self, row: int, field: str) -> tuple[int, str]:
        """Column, counted from 1, and text of a field."""
        place = self.layout.columns[HEADER.index(field)]
        fields = cut(self.text[int(self.lines[row]) - 1], self.layout.separator)
        start, text = fields[place] if place is not None else (0, "")
        return start + 1, text.strip()


def read_rows(text: str, file: str) -> tuple[Rows | None, list[Fault]]:
    """Every row of a predictions file, and every fault of its form; None when the file is not of rows at all."""
    lines = text.split("\n")
    layout, faults = layout_of(lines, file)
    if layout is None:
        return None, faults
    faults += _stray(lines[: layout.first], 1, file)
    plain = not text.encode("utf-8", "surrogatepass").translate(None, delete=PLAIN)
    exact = plain and not layout.decimal_comma and "_" not in "".join(lines[layout.first :])
    taken: list[int] = []
    query_ids: list[str] = []
    numbers: list[float] = []
    for number, fields in _fields(lines, layout, file, faults, plain):
        taken.append(number)
        query_ids.append(fields[0].strip())
        numbers += _floats(fields[1:], exact, layout.decimal_comma)
    values = np.array(numbers, dtype=np.float64).reshape(-1, FIELDS - 1)
    rows = Rows(file, lines, layout, np.array(taken, dtype=np.int64), tuple(query_ids), values)
    return rows, faults + _number_faults(rows)


def _fields(
    lines: list[str], layout: Layout, file: str, faults: list[Fault], plain: bool
) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields, in the order of HEADER, of all rows that have theirs; `faults` gets the others."""
    separator, width, blank = layout.separator, layout.width, []
    usual = plain and layout.in_order
    for number, line in enumerate(lines[layout.first :], layout.first + 1):
        fields = line.split(separator)
        if len(fields) != width or not usual or not fields[0] or '"' in line or len(line) > LONGEST_LINE:
            if not line.strip(' "' + separator):
                blank.append(number)
                continue
            fault = _unreadable(line, number, len(lines), layout, file)
            if fault:
                faults.append(fault)
                continue
            found = [text for _, text in cut(line, separator)]
            fields = ["" if place is None else found[place] for place in layout.columns]
        if fields[0] == HEADER[0] or fields[0][:1] == "#":
            faults.append(_no_row(line, number, file))
            continue
        yield number, fields
    faults += _ending(lines, blank, file)


def _unreadable(line: str, number: int, count: int, layout: Layout, file: str) -> Fault | None:
    """Why a line cannot be taken apart into the fields of a row."""
    if len(line) > LONGEST_LINE:
        seen = f"a line of {len(line)} characters, {quoted(line[:40])} and on"
        repair = "write a row a query, each in a line of its own"
        return _fault(file, number, 1, "huge-line", seen, f"at most {LONGEST_LINE}", repair)
    stray = _stray([line], number, file)
    if stray:
        return stray[0]
    if line.lstrip().startswith("#"):
        return _no_row(line, number, file)
    fields = cut(line, layout.separator)
    opened = next((start for start, text in fields if text.count('"') % 2), None)
    if opened is not None:
        seen = f"a quote that is not closed in {quoted(line[opened:])}"
        return _fault(file, number, opened + 1, "open-quote", seen, "no quotes, or pairs of them", "delete the quote")
    if len(fields) < layout.width:
        return _too_few(line, number, count, layout, file, fields)
    return _too_many(number, layout, file, fields) if len(fields) > layout.width else None


def _too_few(line: str, number: int, count: int, layout: Layout, file: str, fields: list[tuple[int, str]]) -> Fault:
    wanted = f"{layout.width} fields"
    seen = f"{len(fields)} field{'' if len(fields) == 1 else 's'} in {quoted(line)}"
    if number == count:  # no line end: the file stops here
        seen = f"the file breaks off after {len(fields)} fields, in {quoted(line)}"
        return _fault(file, number, len(line) + 1, "cut-off", seen, wanted, "write or copy the file anew")
    for other, name in SEPARATORS.items():
        if other != layout.separator and len(cut(line, other)) == layout.width:
            return _fault(file, number, 1, "separator", f"fields parted by {name}", "commas", "part them by commas")
    repair = f"add what is missing of {','.join(HEADER)}"
    return _fault(file, number, len(line) + 1, "too-few-fields", seen, wanted, repair)


def _too_many(number: int, layout: Layout, file: str, fields: list[tuple[int, str]]) -> Fault:
    start, texts = fields[layout.width][0], [text for _, text in fields]
    seen, wanted = f"{len(fields)} fields", f"{layout.width} fields"
    if not any(text.strip() for text in texts[layout.width :]):
        return _fault(file, number, start + 1, "empty-columns", seen, wanted, "delete the separators at the end")
    pairs = list(pairwise(texts[1:]))
    if layout.separator == "," and any(
        re.fullmatch(r"-?\d", a) and re.fullmatch(r"\d{2,}(e-?\d+)?", b) for a, b in pairs
    ):
        repair = "write a decimal point instead of the comma"
        return _fault(file, number, fields[1][0] + 1, "decimal-comma", f"{seen}, numbers as 0,5", wanted, repair)
    repair = f"delete what is not one of {','.join(HEADER)}"
    return _fault(file, number, start + 1, "too-many-fields", seen, wanted, repair)


def _no_row(line: str, number: int, file: str) -> Fault:
    """A comment or a second header."""
    if line.lstrip(' "').startswith("#"):
        seen = f"a comment, {quoted(line)}"
        return _fault(file, number, 1, "comment", seen, "a row of a prediction", "delete the line")
    return _fault(file, number, 1, "second-header", "the header once more", "one header", "delete the line")


def _stray(lines: Sequence[str], first: int, file: str) -> list[Fault]:
    """Lines that hold control characters or bytes that are not UTF-8."""
    faults = []
    for number, line in enumerate(lines, first):
        match = STRAY.search(line)
        if match:
            code = ord(match[0])
            seen = f"byte 0x{code & 0xFF:02X}" + (" that is not UTF-8" if code > 0xFF else "")
            repair = "write the file again: it is damaged, or of another encoding"
            faults.append(_fault(file, number, match.start() + 1, "stray-byte", seen, "printable text", repair))
    return faults


def _ending(lines: list[str], blank: list[int], file: str) -> list[Fault]:
    """Empty lines, and a last line without its end."""
    faults = []
    inner = [number for number in blank if number < len(lines) or lines[-1]]
    if inner:
        seen = f"{len(inner)} empty line{'' if len(inner) == 1 else 's'}, the first here"
        wanted, repair = "a row in every line", "nothing need be done: they are passed over"
        faults.append(Fault(file, inner[0], 1, seen, wanted, repair, "warning", "empty-line"))
    if lines[-1].strip():
        seen, repair = "the last line has no end", "look whether its last number is whole"
        faults.append(
            Fault(file, len(lines), None, seen, "a line end after every row", repair, "warning", "no-line-end")
        )
    return faults


def _floats(texts: list[str], exact: bool, decimal_comma: bool) -> list[float]:
    """The numbers of a row; NaN for those that are none."""
    if exact:  # printable ASCII without underscores: Python reads as numbers what NUMBER matches, NaN and infinity
        try:
            return list(map(float, texts))
        except ValueError:
            pass
    return [_number(text, decimal_comma) for text in texts]


def _number(text: str, decimal_comma: bool) -> float:
    if decimal_comma and LOCAL_NUMBER.match(text):
        text = text.replace(",", ".")
    return float(text) if NUMBER.match(text) else NOT_A_NUMBER


def _number_faults(rows: Rows) -> list[Fault]:
    """The fields that hold no finite number; blanks them out."""
    faults = []
    for row, j in np.argwhere(~np.isfinite(rows.numbers)).tolist():
        field = HEADER[j + 1]
        if rows.layout.columns[j + 1] is not None:
            name, repair = number_fault(rows.cell(row, field)[1])
            faults.append(rows.fault(row, field, name, "a number", repair))
        rows.numbers[row, j] = NOT_A_NUMBER
    rows.numbers.setflags(write=False)
    return faults


def _fault(file: str, line: int, column: int, name: str, seen: str, wanted: str, repair: str) -> Fault:
    return Fault(file, line, column, seen, wanted, repair, "error", name)
