"""The rows of a predictions file as arrays, and the faults of the rows that cannot be read."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from kit1000.submission.faults import MOST_KEPT, Fault, FaultList, quote
from kit1000.submission.header import COMMA_NUMBER, HEADER, NUMBER, SEPARATORS, Layout, read_layout, split_fields
from kit1000.submission.numbers import number_fault
from kit1000.submission.reading import UNPRINTABLE

COLUMNS = len(HEADER)
LONGEST_LINE = 2000  # characters; a row of ten fields has about 200
INVALID = float("nan")
PRINTABLE_BYTES = bytes([*b"\t\n", *range(0x20, 0x7F)])  # all bytes of a file that kit1000 writes


@dataclass(frozen=True, eq=False)
class Rows:
    """The n rows that have all their fields, with the lines of the file, to locate faults."""

    file: str
    text: Sequence[str]
    """All lines of the file."""
    layout: Layout
    lines: np.ndarray
    """(n,) int: the line number of each row, from 1."""
    query_ids: tuple[str, ...]
    numbers: np.ndarray
    """(n, 9) float64: qw qx qy qz, x y z [m], confidence, seconds [s]; NaN where a field is not a number."""
    unreadable: int = 0
    """Number of lines that are no complete rows."""

    def __len__(self) -> int:
        return len(self.query_ids)

    def fault(
        self,
        row: int,
        field: str,
        code: str,
        expected: str,
        repair: str,
        severity: Literal["error", "warning"] = "error",
    ) -> Fault:
        """A fault of a field of a row."""
        column, text = self.cell(row, field)
        actual, line = f"{field} = {quote(text)}", int(self.lines[row])
        return Fault(self.file, line, column, actual, expected, repair, severity, code)

    def cell(self, row: int, field: str) -> tuple[int, str]:
        """The position in the line, from 1, and the text of a field."""
        index = self.layout.columns[HEADER.index(field)]
        fields = split_fields(self.text[int(self.lines[row]) - 1], self.layout.separator)
        start, text = fields[index] if index is not None else (0, "")
        return start + 1, text.strip()


def read_rows(text: str, file: str) -> tuple[Rows | None, list[Fault], FaultList]:
    """All rows of a predictions file, the faults of its header, and those of its lines; None when it has no rows."""
    lines = text.split("\n")
    layout, faults = read_layout(lines, file)
    if layout is None:
        return None, faults, FaultList()
    faults += _unprintable_faults(lines[: layout.first], 1, file)
    printable = not text.encode("utf-8", "surrogatepass").translate(None, delete=PRINTABLE_BYTES)
    below = sum(len(line) + 1 for line in lines[: layout.first])
    exact = printable and not layout.decimal_comma and text.find("_", below) < 0
    of_lines = FaultList()
    row_lines: list[int] = []
    query_ids: list[str] = []
    numbers = array("d")  # a quarter of a list
    for line_number, fields in _split_rows(lines, layout, file, of_lines, printable):
        row_lines.append(line_number)
        query_ids.append(fields[0].strip())
        numbers.extend(_parse_numbers(fields[1:], exact, layout.decimal_comma))
    values = np.array(numbers, dtype=np.float64).reshape(-1, COLUMNS - 1)
    rows = Rows(file, lines, layout, np.array(row_lines, dtype=np.int64), tuple(query_ids), values, of_lines.errors)
    of_lines.add(_number_faults(rows))
    return rows, faults, of_lines


def _split_rows(
    lines: list[str], layout: Layout, file: str, faults: FaultList, printable: bool
) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields, in the order of HEADER, of all complete rows; the faults of others go to `faults`."""
    separator, width, blank = layout.separator, layout.width, []
    simple = printable and layout.in_order
    for number, line in enumerate(lines[layout.first :], layout.first + 1):
        fields = line.split(separator)
        if len(fields) != width or not simple or not fields[0] or '"' in line or len(line) > LONGEST_LINE:
            if not line.strip(' "' + separator):
                blank.append(number)
                continue
            fault = _line_fault(line, number, len(lines), layout, file)
            if fault:
                faults.append(fault)
                continue
            texts = [text for _, text in split_fields(line, separator)]
            fields = ["" if index is None else texts[index] for index in layout.columns]
        if fields[0] == HEADER[0] or fields[0][:1] == "#":
            faults.append(_not_a_row(line, number, file))
            continue
        yield number, fields
    faults.add(_blank_line_faults(lines, blank, file))


def _line_fault(line: str, number: int, count: int, layout: Layout, file: str) -> Fault | None:
    """Why a line cannot be split into the fields of a row."""
    if len(line) > LONGEST_LINE:
        actual = f"a line of {len(line)} characters, which begins with {quote(line[:40])}"
        repair = "write one row per query, each on its own line"
        return _error(file, number, 1, "long-line", actual, f"at most {LONGEST_LINE} characters", repair)
    unprintable = _unprintable_faults([line], number, file)
    if unprintable:
        return unprintable[0]
    if line.lstrip().startswith("#"):
        return _not_a_row(line, number, file)
    fields = split_fields(line, layout.separator)
    opened = next((start for start, text in fields if text.count('"') % 2), None)
    if opened is not None:
        actual = f"a quote that is not closed in {quote(line[opened:])}"
        return _error(file, number, opened + 1, "open-quote", actual, "pairs of quotes or none", "delete the quote")
    if len(fields) < layout.width:
        return _too_few(line, number, count, layout, file, fields)
    return _too_many(number, layout, file, fields) if len(fields) > layout.width else None


def _too_few(line: str, number: int, count: int, layout: Layout, file: str, fields: list[tuple[int, str]]) -> Fault:
    expected = f"{layout.width} fields"
    actual = f"{len(fields)} field{'' if len(fields) == 1 else 's'} in {quote(line)}"
    if number == count:  # the last line, without a line ending
        actual = f"the file ends after {len(fields)} fields, in {quote(line)}"
        return _error(file, number, len(line) + 1, "truncated", actual, expected, "write or copy the file again")
    for other, name in SEPARATORS.items():
        if other != layout.separator and len(split_fields(line, other)) == layout.width:
            actual = f"fields separated by {name}"
            return _error(file, number, 1, "separator", actual, "commas", "replace them by commas")
    repair = f"add the missing fields of {','.join(HEADER)}"
    return _error(file, number, len(line) + 1, "too-few-fields", actual, expected, repair)


def _too_many(number: int, layout: Layout, file: str, fields: list[tuple[int, str]]) -> Fault:
    start, texts = fields[layout.width][0], [text for _, text in fields]
    actual, expected = f"{len(fields)} fields", f"{layout.width} fields"
    if not any(text.strip() for text in texts[layout.width :]):
        return _error(file, number, start + 1, "empty-columns", actual, expected, "delete the separators at the end")
    pairs = list(pairwise(texts[1:]))
    if layout.separator == "," and any(
        re.fullmatch(r"-?\d", a) and re.fullmatch(r"\d{2,}(e-?\d+)?", b) for a, b in pairs
    ):
        actual, repair = f"{actual}, numbers written as 0,5", "write a decimal point instead of the comma"
        return _error(file, number, fields[1][0] + 1, "decimal-comma", actual, expected, repair)
    repair = f"delete all but {','.join(HEADER)}"
    return _error(file, number, start + 1, "too-many-fields", actual, expected, repair)


def _not_a_row(line: str, number: int, file: str) -> Fault:
    """A comment or a second header."""
    if line.lstrip(' "').startswith("#"):
        actual = f"a comment, {quote(line)}"
        return _error(file, number, 1, "comment", actual, "a prediction", "delete the line")
    return _error(file, number, 1, "second-header", "a second header", "one header", "delete the line")


def _unprintable_faults(lines: Sequence[str], first: int, file: str) -> list[Fault]:
    """Faults of lines with control characters or bytes that are not UTF-8."""
    faults = []
    for number, line in enumerate(lines, first):
        match = UNPRINTABLE.search(line)
        if match:
            code = ord(match[0])
            actual = f"byte 0x{code & 0xFF:02X}" + (", which is not UTF-8" if code > 0xFF else "")
            repair = "write the file again as UTF-8 text"
            faults.append(_error(file, number, match.start() + 1, "invalid-byte", actual, "printable text", repair))
    return faults


def _blank_line_faults(lines: list[str], blank: list[int], file: str) -> list[Fault]:
    """Warnings of empty lines, and of a last line without a line ending."""
    faults = []
    inner = [number for number in blank if number < len(lines) or lines[-1]]
    if inner:
        actual = f"{len(inner)} empty line{'' if len(inner) == 1 else 's'}, the first here"
        expected, repair = "a row in every line", "no change needed: empty lines are skipped"
        faults.append(Fault(file, inner[0], 1, actual, expected, repair, "warning", "empty-line"))
    if lines[-1].strip():
        actual, expected = "the last line has no line ending", "a line ending after every row"
        repair = "check that its last number is complete"
        faults.append(Fault(file, len(lines), None, actual, expected, repair, "warning", "missing-line-ending"))
    return faults


def _parse_numbers(texts: list[str], exact: bool, decimal_comma: bool) -> list[float]:
    """The numbers of a row; NaN for fields that are not numbers."""
    if exact:  # printable ASCII without underscores: float() accepts what NUMBER matches, NaN and infinity
        try:
            return list(map(float, texts))
        except ValueError:
            pass
    return [_parse_number(text, decimal_comma) for text in texts]


def _parse_number(text: str, decimal_comma: bool) -> float:
    if decimal_comma and COMMA_NUMBER.match(text):
        text = text.replace(",", ".")
    return float(text) if NUMBER.match(text) else INVALID


def _number_faults(rows: Rows) -> FaultList:
    """Faults of fields that are not finite numbers, which become NaN."""
    wrong = ~np.isfinite(rows.numbers)
    rows.numbers[wrong] = INVALID
    rows.numbers.setflags(write=False)
    wrong &= [index is not None for index in rows.layout.columns[1:]]
    first = np.flatnonzero(wrong.any(axis=1))[:MOST_KEPT]
    cells = [(int(first[i]), HEADER[j + 1]) for i, j in np.argwhere(wrong[first]).tolist()]

    def fault(row: int, field: str) -> Fault:
        code, repair = number_fault(rows.cell(row, field)[1])
        return rows.fault(row, field, code, "a number", repair)

    return FaultList([fault(*cell) for cell in cells[:MOST_KEPT]], errors=int(wrong.sum()))


def _error(file: str, line: int, column: int, code: str, actual: str, expected: str, repair: str) -> Fault:
    return Fault(file, line, column, actual, expected, repair, "error", code)
