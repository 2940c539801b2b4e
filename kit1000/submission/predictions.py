"""Predictions of a method as arrays and as the file predictions.csv; writing and reading back changes no bit."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.errors import InputError, ShapeError, checked
from kit1000.files import write_bytes
from kit1000.pose import Pose
from kit1000.submission.faults import MOST_KEPT, Fault, in_order, printable, quote
from kit1000.submission.reading import read_text

if TYPE_CHECKING:
    from kit1000.values import Prediction

FILE = "predictions.csv"
HEADER = ("query_id", "qw", "qx", "qy", "qz", "x", "y", "z", "confidence", "seconds")
LONGEST_LINE = 2000  # characters; a row has about 200
ID_PATTERN = re.compile(r"(?!#|query_id\Z)[!#-+\--~]+\Z")  # printable ASCII without spaces, quotes and commas
DIGITS = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
NUMBER = re.compile(rf"\s*{DIGITS}\s*\Z", re.ASCII)
PLAIN_ROW = re.compile(rf'[^",\s]+(?:,{DIGITS}){{9}}\Z', re.ASCII)  # as kit1000 writes it, read faster
NORM_ERROR = 1e-2  # largest difference of a quaternion's norm from 1
NOT_MEASURED = -1.0  # seconds


@dataclass(frozen=True)
class Range:
    """The values that a column may have."""

    low: float
    high: float
    expected: str
    repair: str
    sentinel: float = np.nan
    """A value out of the range that is valid too."""

    def outside(self, values: np.ndarray) -> np.ndarray:
        """(n,) bool: which of (n,) values are invalid; NaN is not."""
        return ((values < self.low) | (values > self.high)) & (values != self.sentinel)


METRES = Range(-1e6, 1e6, "metres, at most 1e+06", "divide millimetres by 1000")
RANGES = {
    **dict.fromkeys("xyz", METRES),
    "confidence": Range(0, 1, "0 to 1", "divide percent by 100, or write 1 if the method has none"),
    "seconds": Range(0, np.inf, "0 or more", "write -1 if they were not measured", NOT_MEASURED),
}


@dataclass(frozen=True, eq=False)
class Predictions:
    """The predictions of a method, one per query, in any order."""

    query_ids: tuple[str, ...]
    motions: Pose
    """(n,) goal_from_now: the motion of each part in the world, from its current pose to the goal."""
    confidence: np.ndarray
    """(n,) 0 .. 1"""
    seconds: np.ndarray
    """(n,) [s], -1 if not measured."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "query_ids", tuple(self.query_ids))
        n = len(self.query_ids)
        object.__setattr__(self, "confidence", checked("confidence", self.confidence, (n,)))
        object.__setattr__(self, "seconds", checked("seconds", self.seconds, (n,)))
        if self.motions.batch_shape != (n,):
            raise ShapeError(f"motions: expected {n}, one per query, got batch shape {self.motions.batch_shape}")
        if len(self._rows) < n:
            twice = next(query_id for i, query_id in enumerate(self.query_ids) if self._rows[query_id] != i)
            raise InputError(f"predictions: expected one per query, got {quote(twice)} more than once")
        invalid = next((query_id for query_id in self.query_ids if not ID_PATTERN.match(query_id)), None)
        if invalid is not None:
            raise InputError(f"predictions: expected ids of letters, digits and hyphens, got {quote(invalid)}")
        for name, values in zip(HEADER[5:], self._numbers.T[4:], strict=True):
            for i in np.flatnonzero(RANGES[name].outside(values))[:1]:
                raise InputError(f"{name} of {self.query_ids[i]}: expected {RANGES[name].expected}, got {values[i]:g}")

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {query_id: i for i, query_id in enumerate(self.query_ids)}

    @property
    def _numbers(self) -> np.ndarray:
        """(n, 9) the columns after the id."""
        return np.column_stack([self.motions.wxyz, self.motions.xyz, self.confidence, self.seconds])

    @classmethod
    def of(cls, predictions: Iterable[Prediction]) -> Predictions:
        """Single predictions as one value, in their order."""
        rows = list(predictions)
        return cls(
            tuple(row.query_id for row in rows),
            Pose.stack([row.goal_from_now for row in rows]),
            np.array([row.confidence for row in rows], dtype=np.float64),
            np.array([row.seconds for row in rows], dtype=np.float64),
        )

    def __len__(self) -> int:
        return len(self.query_ids)

    def row(self, query_id: str) -> int | None:
        """The index of the prediction for a query; None if there is none."""
        return self._rows.get(query_id)

    def to_bytes(self) -> bytes:
        """The content of a predictions file."""
        rows = zip(self.query_ids, self._numbers.tolist(), strict=True)
        lines = [",".join([query_id, *map(repr, row)]) for query_id, row in rows]
        return "\n".join([",".join(HEADER), *lines, ""]).encode("ascii")


@dataclass(frozen=True)
class InvalidRows:
    """The rows of a file that are no valid predictions."""

    count: int = 0
    first: Fault | None = None
    """The first of their faults; None if there is none."""


NO_INVALID = InvalidRows()


def write_predictions(path: str | Path, predictions: Predictions | Iterable[Prediction]) -> None:
    """Write a predictions file, completely or not at all, with all digits of every number."""
    if not isinstance(predictions, Predictions):
        predictions = Predictions.of(predictions)
    write_bytes(Path(path), predictions.to_bytes())


def read_predictions(path: str | Path) -> Predictions:
    """Read a predictions file. Raises InputError with its first error, if it has any."""
    predictions, invalid = read_valid_predictions(path)
    if invalid.first is not None:
        raise InputError(f"{invalid.first} (`kit1000 check` lists all faults)")
    return predictions


def read_valid_predictions(path: str | Path, inside: Path | None = None) -> tuple[Predictions, InvalidRows]:
    """Read the valid rows of a predictions file, and count the others; a link must not lead out of `inside`.

    Raises InputError with the first error of the file itself: one without the right header, or with an id twice.
    """
    file = printable(path)
    text = read_text(Path(path), file, inside)
    rows = text if isinstance(text, Fault) else read_rows(text, file)
    errors = [rows] if isinstance(rows, Fault) else rows.duplicates()
    if isinstance(rows, Fault) or errors:
        raise InputError(f"{errors[0]} (`kit1000 check` lists all faults)")
    valid = rows.valid
    wxyz, xyz, confidence, seconds = np.split(rows.numbers[valid], (4, 7, 8), axis=1)
    ids = tuple(compress(rows.query_ids, valid.tolist()))
    first = next(iter(in_order(rows.faults())), None)
    invalid = InvalidRows(rows.broken_count + int((~valid).sum()), first)
    return Predictions(ids, Pose(wxyz, xyz), confidence[:, 0], seconds[:, 0]), invalid


@dataclass(frozen=True, eq=False)
class Rows:
    """The n lines of a predictions file that have all their fields, valid or not."""

    file: str
    text: Sequence[str]
    """All lines of the file."""
    lines: np.ndarray
    """(n,) int: the line number of each row, from 1."""
    query_ids: tuple[str, ...]
    numbers: np.ndarray
    """(n, 9) float64: qw qx qy qz, x y z [m], confidence, seconds [s]; NaN if a field is not a finite number."""
    broken: list[Fault]
    """One error for each of the first MOST_KEPT lines without the fields of a row."""
    broken_count: int
    """Number of all of them."""

    def __len__(self) -> int:
        return len(self.query_ids)

    @cached_property
    def _norms(self) -> np.ndarray:
        """(n,) the norm of each quaternion; NaN if one of its numbers is invalid."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.linalg.norm(self.numbers[:, :4], axis=1)

    @cached_property
    def wrong(self) -> np.ndarray:
        """(n, 10) bool: the invalid fields, by row and column of HEADER. A wrong norm belongs to qw."""
        wrong_ids = [not ID_PATTERN.match(query_id) for query_id in self.query_ids]
        wrong = np.column_stack([np.array(wrong_ids, bool), np.isnan(self.numbers)])
        wrong[:, 1] |= np.abs(self._norms - 1) > NORM_ERROR
        for name, allowed in RANGES.items():
            column = HEADER.index(name)
            wrong[:, column] |= allowed.outside(self.numbers[:, column - 1])
        return wrong

    @property
    def valid(self) -> np.ndarray:
        """(n,) bool: the rows that are valid predictions."""
        return np.logical_not(self.wrong.any(axis=1))

    def faults(self) -> list[Fault]:
        """The faults of single lines: broken ones, and those with invalid fields; the first MOST_KEPT of each."""
        cells = np.argwhere(self.wrong)[:MOST_KEPT].tolist()
        return [*self.broken, *(self._value_fault(row, column) for row, column in cells)]

    def duplicates(self) -> list[Fault]:
        """One error for each further row with the same id: no row says which of them is meant."""
        first: dict[str, int] = {}
        again = [i for i, query_id in enumerate(self.query_ids) if first.setdefault(query_id, i) != i and query_id]

        def fault(i: int) -> Fault:
            line, before = self.lines[i], self.lines[first[self.query_ids[i]]]
            expected = f"one row per query, but line {before} has the same id"
            return self.fault(i, "query_id", "duplicate-id", expected, f"delete line {line} or line {before}")

        return list(map(fault, again[:MOST_KEPT]))

    def _value_fault(self, row: int, column: int) -> Fault:
        name = HEADER[column]
        if column == 0:
            expected, repair = "a query id such as test-s0007-p2-snap", "copy the id from the dataset"
            return self.fault(row, name, "invalid-id", expected, repair)
        if np.isnan(self.numbers[row, column - 1]):
            repair = "write digits with a decimal point, or omit the row if there is no prediction"
            return self.fault(row, name, "not-a-number", "a finite number such as 0.25 or 1e-05", repair)
        if name == "qw":
            expected = f"qw, qx, qy, qz of norm 1, got {self._norms[row]:.6g}"
            repair = "write a unit quaternion (1,0,0,0 for no rotation), not angles"
            return self.fault(row, name, "quaternion-norm", expected, repair)
        allowed = RANGES[name]
        code = f"{'position' if allowed is METRES else name}-range"
        return self.fault(row, name, code, allowed.expected, allowed.repair)

    def fault(self, row: int, field: str, code: str, expected: str, repair: str) -> Fault:
        """An error of a field of a row."""
        line = int(self.lines[row])
        value = _fields(self.text[line - 1])[HEADER.index(field)].strip()
        return Fault(self.file, line, code, f"{field} = {quote(value)}", expected, repair)


def read_rows(text: str, file: str) -> Rows | Fault:
    """The rows of a predictions file; the fault of its header if that is not the right one."""
    lines = text.split("\n")
    head = next(i for i, line in enumerate(lines) if line.strip())
    if len(lines[head]) > LONGEST_LINE or tuple(_fields(lines[head].strip())) != HEADER:
        repair = "write it above the rows, with commas between the columns and decimal points in the numbers"
        if lines[head].startswith("sep="):
            repair = "delete this line, which a spreadsheet wrote"
        actual = f"the first line is {quote(lines[head])}"
        return Fault(file, head + 1, "header", actual, f"the header {','.join(HEADER)}", repair)
    broken, count = list[Fault](), 0
    row_lines, query_ids, numbers = list[int](), list[str](), array("d")
    for number, line in enumerate(lines[head + 1 :], head + 2):
        if not line.strip(" ,"):
            continue
        fields = _fields(line) if len(line) <= LONGEST_LINE else []
        if len(fields) == len(HEADER):
            row_lines.append(number)
            query_ids.append(fields[0].strip())
            numbers.extend(map(float if PLAIN_ROW.match(line) else _number, fields[1:]))
            continue
        count += 1
        if count <= MOST_KEPT:
            broken.append(_line_fault(line, number, number == len(lines), file))
    values = np.array(numbers, dtype=np.float64).reshape(-1, len(HEADER) - 1)
    values[np.isinf(values)] = np.nan
    values.setflags(write=False)
    return Rows(file, lines, np.array(row_lines, np.int64), tuple(query_ids), values, broken, count)


def _number(field: str) -> float:
    return float(field) if NUMBER.match(field) else np.nan


def _fields(line: str) -> list[str]:
    """The fields of a line, which may be quoted; none if a quote is not closed."""
    if '"' not in line:
        return line.split(",")
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error:
        return []


def _line_fault(line: str, number: int, is_last: bool, file: str) -> Fault:
    """Why a line is no row."""
    fields = _fields(line) if len(line) <= LONGEST_LINE else []
    many = f"{len(fields)} field{'' if len(fields) == 1 else 's'}"
    actual = many if fields else f"a quote that is not closed, or more than {LONGEST_LINE} characters,"
    repair = "the file was cut off: write or copy it again" if is_last else f"write {','.join(HEADER)}"
    return Fault(
        file, number, "fields", f"{actual} in {quote(line)}", f"{len(HEADER)} fields, separated by commas", repair
    )
