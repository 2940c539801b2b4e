"""Faults of a submission, one printed line each, and the report that lists them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

LONGEST_VALUE = 60  # characters of a value in a message; longer values are shortened
LISTED = 3  # ids in a message; the others are counted
MOST_KEPT = 1000  # errors of a report; no file makes it larger
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


@dataclass(frozen=True)
class Report:
    """The result of a check."""

    path: str
    errors: tuple[Fault, ...]
    """Faults that make a submission invalid, by file and line; if there are more, the first MOST_KEPT."""
    warnings: tuple[Fault, ...]
    """Allowed, but probably not intended."""
    rows: int
    """Number of rows with all their fields."""
    against_data: bool
    """Whether ids and motions were checked against a dataset, or only the format."""
    form_errors: tuple[Fault, ...]
    """Errors of the manifest, of the header, of ids, or of all rows together: not those of single predictions."""

    @classmethod
    def of(cls, path: object, form: list[Fault], of_rows: list[Fault], rows: int, against_data: bool) -> Report:
        """The report about a path, from the faults of form and of single rows."""
        errors, form_errors = (
            tuple(in_order(fault for fault in faults if fault.severity == "error"))
            for faults in ([*form, *of_rows], form)
        )
        warnings = in_order(fault for fault in form if fault.severity == "warning")
        return cls(printable(path), errors[:MOST_KEPT], tuple(warnings), rows, against_data, form_errors)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """Errors and warnings by file and line."""
        return tuple(in_order([*self.errors, *self.warnings]))

    @property
    def good(self) -> bool:
        """Whether there are no errors; there may be warnings."""
        return not self.errors

    def __str__(self) -> str:
        return "\n".join([*map(str, in_order([*self.errors, *self.warnings][:MOST_PRINTED])), self.summary])

    @property
    def summary(self) -> str:
        """The last line of the report."""
        basis = (
            "against the dataset" if self.against_data else "for format only (--data DIR checks ids and motions too)"
        )
        more = " or more" if len(self.errors) == MOST_KEPT else ""
        counts = f"{_count_of(len(self.errors), 'error')}{more}, {_count_of(len(self.warnings), 'warning')}"
        if len(self.faults) > MOST_PRINTED:
            counts += f"; the first {MOST_PRINTED} are listed"
        return f"{self.path}: {_count_of(self.rows, 'row')} checked {basis}: {counts if self.faults else 'no faults'}"

    def as_json(self) -> dict[str, Any]:
        """The report as values for JSON."""
        return {
            "path": self.path,
            "good": self.good,
            "rows": self.rows,
            "against_data": self.against_data,
            "errors": len(self.errors),
            "warnings": len(self.warnings),
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
