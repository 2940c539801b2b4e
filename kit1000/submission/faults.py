"""Faults of a submission, one printed line each, and the report that lists them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

LONGEST_VALUE = 60  # characters of a value in a message; longer ones are shortened
LISTED = 3  # ids in a message; the others are counted
MOST_KEPT = 1000  # errors, and warnings, in a report; further ones are counted: its size is limited for any file
MOST_PRINTED = 20  # faults of a report as text


@dataclass(frozen=True)
class Fault:
    """One fault in one place. As text: `file:line:column: actual: expected EXPECTED; repair`."""

    file: str
    """manifest.toml, predictions.csv, or the given path."""
    line: int | None
    """Counted from 1; None when the fault concerns the whole file."""
    column: int | None
    """Position in the line where the value begins, counted from 1."""
    actual: str
    """What the file contains, such as `qw = "abc"`."""
    expected: str
    repair: str
    """What to do."""
    severity: Literal["error", "warning"]
    code: str
    """Kind of fault, such as decimal-comma: stable, for programs."""

    def __str__(self) -> str:
        location = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        prefix = "" if self.severity == "error" else "warning: "
        return f"{location}: {prefix}{self.actual}: expected {self.expected}; {self.repair}"


@dataclass
class FaultList:
    """Faults, of which those of the first lines are kept and all are counted."""

    kept: list[Fault] = field(default_factory=list)
    """The first errors and warnings, at most MOST_KEPT of each."""
    errors: int = 0
    warnings: int = 0

    @classmethod
    def of(cls, faults: Iterable[Fault]) -> FaultList:
        """A list of faults, in any order."""
        made = cls()
        for fault in faults:
            made._count(fault.severity, 1)
            made.kept.append(fault)
        made.kept = _first(made.kept)
        return made

    @classmethod
    def of_rows(
        cls,
        rows: Sequence[int] | np.ndarray,
        make: Callable[[int], Fault],
        severity: Literal["error", "warning"] = "error",
    ) -> FaultList:
        """One fault for each of some rows, in their order; only those that are kept are made."""
        made = cls([make(int(row)) for row in rows[:MOST_KEPT]])
        made._count(severity, len(rows))
        return made

    def append(self, fault: Fault) -> None:
        """Add a fault that comes after all others."""
        self._count(fault.severity, 1)
        if (self.errors if fault.severity == "error" else self.warnings) <= MOST_KEPT:
            self.kept.append(fault)

    def add(self, faults: FaultList | Iterable[Fault]) -> None:
        """Add faults of any place."""
        other = faults if isinstance(faults, FaultList) else FaultList.of(faults)
        self.errors += other.errors
        self.warnings += other.warnings
        self.kept = _first([*self.kept, *other.kept])

    def _count(self, severity: str, n: int) -> None:
        if severity == "error":
            self.errors += n
        else:
            self.warnings += n


@dataclass(frozen=True)
class Report:
    """The result of a check."""

    path: str
    faults: tuple[Fault, ...]
    """Ordered by file, line and column; where there are more, the first MOST_KEPT errors and warnings."""
    rows: int
    """Number of predictions with all their fields."""
    against_data: bool
    """Whether ids and motions were checked against a dataset, or only the format."""
    error_count: int
    """Number of all errors, kept in `faults` or not."""
    warning_count: int
    form_errors: tuple[Fault, ...]
    """Errors of the manifest, of the header, of ids, or of all rows together: not those of single predictions."""

    @property
    def errors(self) -> tuple[Fault, ...]:
        """Faults that make a submission invalid, those in `faults`."""
        return tuple(fault for fault in self.faults if fault.severity == "error")

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """Allowed, but probably not intended."""
        return tuple(fault for fault in self.faults if fault.severity == "warning")

    @property
    def good(self) -> bool:
        """Whether there are no errors; there may be warnings."""
        return not self.error_count

    def __str__(self) -> str:
        printed = sorted_faults([*self.errors, *self.warnings][:MOST_PRINTED])
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


def _first(faults: Sequence[Fault]) -> list[Fault]:
    """The faults in order: of errors and of warnings the first MOST_KEPT."""
    kept: list[Fault] = []
    for severity in ("error", "warning"):
        kept += sorted_faults(fault for fault in faults if fault.severity == severity)[:MOST_KEPT]
    return list(sorted_faults(kept))


def sorted_faults(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """Sorted by file, line and column; faults of a whole file come first."""
    return tuple(sorted(faults, key=lambda f: (f.file, f.line or 0, f.column or 0, f.severity, f.code)))


def first_error(faults: Iterable[Fault]) -> Fault | None:
    """The first error in sorted order; None when there is none."""
    return next((fault for fault in sorted_faults(faults) if fault.severity == "error"), None)


def quote(value: object) -> str:
    """A value for a message: in quotes, shortened, in ASCII."""
    text = value if isinstance(value, str) else str(value)
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
