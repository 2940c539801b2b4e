"""Checks of the values of each row of a predictions file, without a dataset."""

from __future__ import annotations

import re
from functools import partial
from typing import Literal

import numpy as np

from kit1000.submission.faults import MOST_KEPT, Fault, FaultList
from kit1000.submission.rows import Rows

NORM_WARNING, NORM_ERROR = 1e-3, 1e-2  # difference of a quaternion's norm from 1
ZERO_NORM = 1e-9  # a quaternion with a smaller norm counts as zero
FAR_POSITION, LARGEST_POSITION = 10.0, 1e6  # [m] warning and error; a motion is about 0.3 m
NOT_MEASURED = -1.0  # seconds
ID_PATTERN = re.compile(r"(?!#|query_id\Z)[!#-+\--~]+\Z")  # printable ASCII without spaces, quotes and commas


def value_faults(rows: Rows) -> FaultList:
    """Faults of ids, quaternions, positions, confidences and seconds, each of a single row."""
    faults = FaultList()
    for of in (_id_faults, _quaternion_faults, _position_faults, _confidence_faults, _seconds_faults):
        faults.add(of(rows))
    return faults


def valid_rows(rows: Rows) -> np.ndarray:
    """(n,) bool: the rows without an error, whatever the others hold."""
    valid = np.array([bool(ID_PATTERN.match(query_id)) for query_id in rows.query_ids], bool)
    valid &= np.isfinite(rows.numbers).all(axis=1)
    valid &= _norm_errors(rows)[1] <= NORM_ERROR
    valid &= np.abs(rows.numbers[:, 4:7]).max(axis=1, initial=0) <= LARGEST_POSITION
    return valid & ~_wrong_confidence(rows) & ~_wrong_seconds(rows)


def _id_faults(rows: Rows) -> FaultList:
    def fault(i: int) -> Fault:
        code = "invalid-id" if rows.query_ids[i] else "empty-id"
        repair = "copy the id from the dataset: letters, digits and hyphens"
        return rows.fault(i, "query_id", code, "a query id such as test-s0007-p2-snap", repair)

    return FaultList.of_rows([i for i, name in enumerate(rows.query_ids) if not ID_PATTERN.match(name)], fault)


def duplicate_faults(rows: Rows) -> FaultList:
    """Ids of more than one row: no row says which of them is meant."""
    faults, first = FaultList(), {}
    for i, query_id in enumerate(rows.query_ids):
        before = first.setdefault(query_id, i)
        if before == i or not query_id:
            continue
        if len(faults.kept) == MOST_KEPT:
            faults.errors += 1
            continue
        expected = f"one row per query, but line {rows.lines[before]} has the same id"
        repair = f"delete line {rows.lines[i]} or line {rows.lines[before]}"
        faults.append(rows.fault(i, "query_id", "duplicate-id", expected, repair))
    return faults


def _norm_errors(rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """(n,) the norm of each quaternion, and its difference from 1; NaN for fields with another fault."""
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(rows.numbers[:, :4], axis=1)
        return norm, np.abs(norm - 1)


def _quaternion_faults(rows: Rows) -> FaultList:
    norm, off = _norm_errors(rows)

    def fault(i: int) -> Fault:
        if norm[i] < ZERO_NORM:
            repair = "write 1,0,0,0 for no rotation"
            return rows.fault(i, "qw", "zero-quaternion", "a quaternion of norm 1, got 0", repair)
        expected = f"qw, qx, qy, qz of norm 1, got {norm[i]:.6g}"
        repair = "divide the four by their norm" if norm[i] < 2 else "write a unit quaternion, not angles in degrees"
        severity = "error" if off[i] > NORM_ERROR else "warning"
        return rows.fault(i, "qw", "quaternion-norm", expected, repair, severity)

    faults = FaultList.of_rows(_where(off > NORM_ERROR), fault)
    faults.add(FaultList.of_rows(_where((off > NORM_WARNING) & (off <= NORM_ERROR)), fault, "warning"))
    return faults


def _position_faults(rows: Rows) -> FaultList:
    size = np.abs(rows.numbers[:, 4:7])
    in_metres = bool(np.nanmedian(size.max(axis=1)) < FAR_POSITION) if np.isfinite(size).all(axis=1).any() else False
    expected, repair = f"metres, at most {FAR_POSITION:g}", "divide millimetres by 1000"

    def fault(i: int, name: str, severity: Literal["error", "warning"]) -> Fault:
        return rows.fault(i, name, "position-range", expected, repair, severity)

    faults = FaultList()
    for j, name in enumerate("xyz"):
        beyond = size[:, j] > LARGEST_POSITION
        far = (size[:, j] > FAR_POSITION) & ~beyond if in_metres else np.zeros(len(size), bool)
        faults.add(FaultList.of_rows(_where(beyond), partial(fault, name=name, severity="error")))
        faults.add(FaultList.of_rows(_where(far), partial(fault, name=name, severity="warning"), "warning"))
    return faults


def _wrong_confidence(rows: Rows) -> np.ndarray:
    return (rows.numbers[:, 7] < 0) | (rows.numbers[:, 7] > 1)


def _confidence_faults(rows: Rows) -> FaultList:
    def fault(i: int) -> Fault:
        percent = 1 < rows.numbers[i, 7] <= 100
        repair = "divide percent by 100" if percent else "scale scores to 0 .. 1, or write 1 when the method has none"
        return rows.fault(i, "confidence", "confidence-range", "0 to 1", repair)

    return FaultList.of_rows(_where(_wrong_confidence(rows)), fault)


def _wrong_seconds(rows: Rows) -> np.ndarray:
    return (rows.numbers[:, 8] < 0) & (rows.numbers[:, 8] != NOT_MEASURED)


def _seconds_faults(rows: Rows) -> FaultList:
    def fault(i: int) -> Fault:
        return rows.fault(i, "seconds", "seconds-range", "0 or more", "write -1 when it was not measured")

    return FaultList.of_rows(_where(_wrong_seconds(rows)), fault)


def _where(wrong: np.ndarray) -> np.ndarray:
    """The rows (k,) in which a bool of (n,) is true."""
    return np.flatnonzero(wrong)
