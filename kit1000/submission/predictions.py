"""Predictions of a method as arrays and as the file predictions.csv; writing and reading back changes no bit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.errors import InputError, ShapeError, checked
from kit1000.files import write_bytes
from kit1000.pose import Pose
from kit1000.submission.faults import Fault, FaultList, first_error, printable, quote
from kit1000.submission.header import HEADER
from kit1000.submission.reading import decode_text, read_file
from kit1000.submission.row_rules import (
    ID_PATTERN,
    LARGEST_POSITION,
    NOT_MEASURED,
    duplicate_faults,
    valid_rows,
    value_faults,
)
from kit1000.submission.rows import read_rows

if TYPE_CHECKING:
    from kit1000.values import Prediction

FILE = "predictions.csv"


@dataclass(frozen=True, eq=False)
class Predictions:
    """The predictions of a method, one per query, in any order."""

    query_ids: tuple[str, ...]
    motions: Pose
    """(n,) goal_from_now: the motion of each part in the world, from its current pose to the goal."""
    confidence: np.ndarray
    """(n,) 0 .. 1"""
    seconds: np.ndarray
    """(n,) [s], -1 where it was not measured."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "query_ids", tuple(self.query_ids))
        n = len(self.query_ids)
        object.__setattr__(self, "confidence", checked("confidence", self.confidence, (n,)))
        object.__setattr__(self, "seconds", checked("seconds", self.seconds, (n,)))
        if self.motions.batch_shape != (n,):
            raise ShapeError(f"motions: expected {n}, one per query, got batch shape {self.motions.batch_shape}")
        self._check_values()

    def _check_values(self) -> None:
        """Raise InputError for values that could not be written and read back."""
        if len(self._rows) < len(self.query_ids):
            duplicate = next(query_id for i, query_id in enumerate(self.query_ids) if self._rows[query_id] != i)
            raise InputError(f"predictions: expected one per query, got {quote(duplicate)} more than once")
        invalid = next((query_id for query_id in self.query_ids if not ID_PATTERN.match(query_id)), None)
        if invalid is not None:
            raise InputError(f"predictions: expected ids of letters, digits and hyphens, got {quote(invalid)}")
        confidence, seconds = self.confidence, self.seconds
        self._check_range("confidence", confidence, (confidence < 0) | (confidence > 1), "0 to 1")
        self._check_range(
            "seconds", seconds, (seconds < 0) & (seconds != NOT_MEASURED), "0 or more, or -1 for not measured"
        )
        farthest = np.abs(self.motions.xyz).max(axis=1, initial=0)
        self._check_range("position", farthest, farthest > LARGEST_POSITION, f"metres, at most {LARGEST_POSITION:g}")

    def _check_range(self, name: str, values: np.ndarray, wrong: np.ndarray, expected: str) -> None:
        if wrong.any():
            i = int(np.argmax(wrong))
            raise InputError(f"{name} of {self.query_ids[i]}: expected {expected}, got {values[i]:g}")

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {query_id: i for i, query_id in enumerate(self.query_ids)}

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
        """The index of the prediction for a query; None when there is none."""
        return self._rows.get(query_id)


@dataclass(frozen=True)
class InvalidRows:
    """The rows of a file that are no valid predictions."""

    count: int = 0
    first: Fault | None = None
    """The first of their faults; None without any."""


NO_INVALID = InvalidRows()


def read_predictions(path: str | Path) -> Predictions:
    """Read a predictions file. Raises InputError with its first error, when it has any."""
    predictions, invalid = read_valid_predictions(path)
    if invalid.first is not None:
        raise InputError(f"{invalid.first} (`kit1000 check` lists all faults)")
    return predictions


def read_valid_predictions(path: str | Path, inside: Path | None = None) -> tuple[Predictions, InvalidRows]:
    """Read the valid rows of a predictions file, and count the others; a link must not lead out of `inside`.

    Raises InputError with the first error of the file itself: one without a readable header, or with an id twice.
    """
    file = printable(path)
    data, faults = read_file(Path(path), file, inside)
    text, more = (None, []) if data is None else decode_text(data, file)
    rows, rest, of_rows = (None, [], FaultList()) if text is None else read_rows(text, file)
    error = first_error([*faults, *more, *rest, *(duplicate_faults(rows).kept if rows is not None else ())])
    if error is not None:
        raise InputError(f"{error} (`kit1000 check` lists all faults)")
    assert rows is not None  # or there would be an error
    of_rows.add(value_faults(rows))
    valid = valid_rows(rows)
    wxyz, xyz, confidence, seconds = np.split(rows.numbers[valid], (4, 7, 8), axis=1)
    ids = tuple(compress(rows.query_ids, valid.tolist()))
    invalid = InvalidRows(rows.unreadable + int((~valid).sum()), first_error(of_rows.kept))
    return Predictions(ids, Pose(wxyz, xyz), confidence[:, 0], seconds[:, 0]), invalid


def write_predictions(path: str | Path, predictions: Predictions | Iterable[Prediction]) -> None:
    """Write a predictions file, completely or not at all, with all digits of every number."""
    if not isinstance(predictions, Predictions):
        predictions = Predictions.of(predictions)
    write_bytes(Path(path), predictions_bytes(predictions))


def predictions_bytes(predictions: Predictions) -> bytes:
    """The bytes of a predictions file."""
    motions = predictions.motions
    numbers = np.column_stack([motions.wxyz, motions.xyz, predictions.confidence, predictions.seconds])
    rows = zip(predictions.query_ids, numbers.tolist(), strict=True)
    lines = [",".join([query_id, *map(repr, row)]) for query_id, row in rows]
    return "\n".join([",".join(HEADER), *lines, ""]).encode("ascii")
