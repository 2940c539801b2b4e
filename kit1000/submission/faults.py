"""What is wrong with a submission: one fault a line, and the report that gathers them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Literal

LONGEST_SHOWN = 60  # characters of a value that a message repeats
FEW = 3  # ids or lines that a message names


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong in one place. As text: file:line:column: what is seen: what is expected; the repair."""

    file: str
    """manifest.toml, predictions.csv, or the path that was given."""
    line: int | None
    """Counted from 1; None when the fault is one of the whole file."""
    column: int | None
    """The character of the line at which the value begins, counted from 1."""
    seen: str
    wanted: str
    repair: str
    kind: Literal["error", "warning"]
    name: str
    """The sort of fault, such as decimal-comma: for programs, always the same."""

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        mark = "" if self.kind == "error" else "warning: "
        return f"{place}: {mark}{self.seen}: expected {self.wanted}; {self.repair}"


@dataclass(frozen=True)
class Report:
    """All that a check found."""

    path: str
    faults: tuple[Fault, ...]
    """Ordered by file, line and column."""
    read: int
    """Rows of predictions that have all their fields."""
    against_data: bool
    """Whether a dataset was at hand, or the form alone could be checked."""

    @property
    def errors(self) -> tuple[Fault, ...]:
        """The faults that a submission may not have."""
        return tuple(fault for fault in self.faults if fault.kind == "error")

    @property
    def warnings(self) -> tuple[Fault, ...]:
        """What is allowed, and probably not meant."""
        return tuple(fault for fault in self.faults if fault.kind == "warning")

    @property
    def good(self) -> bool:
        """Whether there are no errors; warnings may be there."""
        return not self.errors

    def __str__(self) -> str:
        return "\n".join([*map(str, self.faults), self.summary])

    @property
    def summary(self) -> str:
        """The last line of the report."""
        basis = "against the dataset" if self.against_data else "for form alone (--data DIR checks ids and motions too)"
        counts = f"{_counted(len(self.errors), 'error')}, {_counted(len(self.warnings), 'warning')}"
        return f"{self.path}: {_counted(self.read, 'row')} checked {basis}: {counts if self.faults else 'all good'}"

    def as_json(self) -> dict[str, Any]:
        """The report as plain values."""
        return {
            "path": self.path,
            "good": self.good,
            "read": self.read,
            "against_data": self.against_data,
            "errors": len(self.errors),
            "warnings": len(self.warnings),
            "faults": [asdict(fault) for fault in self.faults],
        }


def in_order(faults: Iterable[Fault]) -> tuple[Fault, ...]:
    """By file, and inside a file what concerns all of it before what concerns a line."""
    return tuple(sorted(faults, key=lambda f: (f.file, f.line or 0, f.column or 0, f.kind, f.name)))


def first_error(faults: Iterable[Fault]) -> Fault | None:
    """The error that stands first in its file."""
    return next((fault for fault in in_order(faults) if fault.kind == "error"), None)


def quoted(value: object) -> str:
    """A value as a message shows it: in quotes, shortened, printable in any terminal."""
    text = value if isinstance(value, str) else str(value)
    short = text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."
    return json.dumps(short).replace("\x7f", "\\u007f")


def printable(name: object) -> str:
    """A path or a name as a message shows it, without quotes: in ASCII, for terminals that know no more."""
    return "".join(c if " " <= c <= "~" else ascii(c)[1:-1] for c in str(name))


def named(values: Iterable[str], count: int) -> str:
    """The first few of some values: `a, b, c and 17 more`."""
    few = [value for value, _ in zip(values, range(FEW), strict=False)]
    more = f" and {count - len(few)} more" if count > len(few) else ""
    return f"{', '.join(few)}{more}"


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
