"""Faults of a submission, one printed line each, and the report that lists them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

LONGEST_VALUE = 60  # characters of a value in a message; longer values are shortened
LISTED = 3  # ids in a message; the others are counted
MOST_KEPT = 1000  # errors, and warnings, in a report; the others are counted, so that no file makes a report large
MOST_PRINTED = 20  # faults of a report as text


@dataclass(frozen=True)
class Fault:
    """One fault in one place. As text: `file:line: actual: expected EXPECTED; repair`."""

    file: str
    """manifest.toml, predictions.csv, or the given path."""
    line: int | None
    """Counted from 1; None if the fault concerns the whole file."""
    code: str
    """Kind of fault, such as quaternion-norm: stable, for programs."""
    actual: str
    """What the file contains, such as `qw = "abc"`."""
    expected: str
    repair: str
    """What to do."""
    severity: Literal["error", "warning"] = "error"

    def __str__(self) -> str:
        location = self.file if self.line is None else f"{self.file}:{self.line}"
        prefix = "" if self.severity == "error" else "warning: "
        return f"{location}: {prefix}{self.actual}: expected {self.expected}; {self.repair}"


def file_error(file: str, code: str, actual: str, expected: str, repair: str) -> Fault:
    """An error that concerns a whole file."""
    return Fault(file, None, code, actual, expected, repair)


def file_warning(file: str, code: str, actual: str, expected: str, repair: str) -> Fault:
    """A warning that concerns a whole file."""
    return Fault(file, None, code, actual, expected, repair, "warning")


@dataclass
class FaultList:
    """Faults in any order. All are counted; a caller that finds thousands adds only the first MOST_KEPT."""

    kept: list[Fault] = field(default_factory=list)
    errors: int = 0
    warnings: int = 0

    def add(self, faults: Iterable[Fault], errors: int | None = None) -> None:
        """Add faults.

        Args:
            faults: errors and warnings.
            errors: number of all errors, if `faults` holds only the first of them.
        """
        added = list(faults)
        warnings = sum(fault.severity == "warning" for fault in added)
        self.kept += added
        self.warnings += warnings
        self.errors += len(added) - warnings if errors is None else errors

    def add_all(self, other: FaultList) -> None:
        """Add the faults of another list."""
        self.kept += other.kept
        self.errors += other.errors
        self.warnings += other.warnings

    def first(self, severity: Literal["error", "warning"]) -> tuple[Fault, ...]:
        """The first MOST_KEPT errors or warnings, by file and line."""
        return tuple(in_order(fault for fault in self.kept if fault.severity == severity)[:MOST_KEPT])

    @property
    def first_error(self) -> Fault | None:
        """The first error by file and line; None if there is none."""
        return next(iter(self.first("error")), None)


@dataclass(frozen=True)
class Report:
    """The result of a check."""

    path: str
    errors: tuple[Fault, ...]
    """Faults that make a submission invalid, by file and line; if there are more, the first MOST_KEPT."""
    warnings: tuple[Fault, ...]
    """Allowed, but probably not intended; limited in the same way."""
    rows: int
    """Number of rows with all their fields."""
    against_data: bool
    """Whether ids and motions were checked against a dataset, or only the format."""
    error_count: int
    """Number of all errors."""
    warning_count: int
    form_errors: tuple[Fault, ...]
    """Errors of the manifest, of the header, of ids, or of all rows together: not those of single predictions."""

    @classmethod
    def of(cls, path: object, form: FaultList, of_rows: FaultList, rows: int, against_data: bool) -> Report:
        """The report about a path, from the faults of form and of single rows."""
        found = FaultList()
        found.add_all(form)
        found.add_all(of_rows)
        counts = found.errors, found.warnings
        shown = found.first("error"), found.first("warning")
        return cls(printable(path), *shown, rows, against_data, *counts, form.first("error"))

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Errors and warnings by file and line."""
        return tuple(in_order([*self.errors, *self.warnings]))

    @property
    def good(self) -> bool:
        """Whether there are no errors; there may be warnings."""
        return not self.error_count

    def __str__(self) -> str:
        printed = in_order([*self.errors, *self.warnings][:MOST_PRINTED])
        return "\n".join([*map(str, printed), self.summary])

    @property
    def summary(self) -> str:
        """The last line of the report."""
        basis = (
            "against the dataset" if self.against_data else "for format only (--data DIR checks ids and motions too)"
        )
        counts = f"{_count_of(self.error_count, 'error')}, {_count_of(self.warning_count, 'warning')}"
        if self.error_count + self.warning_count > MOST_PRINTED:
            counts += f"; the first {MOST_PRINTED} are listed"
        return f"{self.path}: {_count_of(self.rows, 'row')} checked {basis}: {counts if self.faults else 'no faults'}"

    def as_json(self) -> dict[str, Any]:
        """The report as values for JSON."""
        return {
            "path": self.path,
            "good": self.good,
            "rows": self.rows,
            "against_data": self.against_data,
            "errors": self.error_count,
            "warnings": self.warning_count,
            "faults": [asdict(fault) for fault in self.faults],
        }


def in_order(faults: Iterable[Fault]) -> list[Fault]:
    """Faults by file and line; faults of a whole file come first."""
    return sorted(faults, key=lambda fault: (fault.file, fault.line or 0, fault.severity, fault.code))


def quote(value: object) -> str:
    """A value for a message: in quotes, shortened, in ASCII."""
    text = str(value)
    short = text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."
    return json.dumps(short).replace("\x7f", "\\u007f")


def printable(name: object) -> str:
    """A path or a name for a message, in ASCII without quotes."""
    return "".join(c if " " <= c <= "~" else ascii(c)[1:-1] for c in str(name))


def listed(values: Iterable[str], count: int) -> str:
    """The first values of `count`: `a, b, c and 17 more`."""
    first = [value for value, _ in zip(values, range(LISTED), strict=False)]
    more = f" and {count - len(first)} more" if count > len(first) else ""
    return f"{', '.join(first)}{more}"


def _count_of(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
