"""Checks of the values of each row of a predictions file, without a dataset."""

from __future__ import annotations

import re

import numpy as np

from kit1000.submission.faults import Fault
from kit1000.submission.rows import Rows

NORM_WARNING, NORM_ERROR = 1e-3, 1e-2  # difference of a quaternion's norm from 1
ZERO_NORM = 1e-9  # a quaternion with a smaller norm counts as zero
FAR_POSITION, LARGEST_POSITION = 10.0, 1e6  # [m] warning and error; a motion is about 0.3 m
NOT_MEASURED = -1.0  # seconds
ID_PATTERN = re.compile(r"(?!#|query_id\Z)[!#-+\--~]+\Z")  # printable ASCII without spaces, quotes and commas


def row_faults(rows: Rows) -> list[Fault]:
    """Faults of ids, quaternions, positions, confidences and seconds."""
    return [
        *_id_faults(rows),
        *_duplicate_faults(rows),
        *_quaternion_faults(rows),
        *_position_faults(rows),
        *_confidence_faults(rows),
        *_seconds_faults(rows),
    ]


def _id_faults(rows: Rows) -> list[Fault]:
    faults = []
    for i, query_id in enumerate(rows.query_ids):
        if not ID_PATTERN.match(query_id):
            code = "invalid-id" if query_id else "empty-id"
            repair = "copy the id from the dataset: letters, digits and hyphens"
            faults.append(rows.fault(i, "query_id", code, "a query id such as test-s0007-p2-snap", repair))
    return faults


def _duplicate_faults(rows: Rows) -> list[Fault]:
    """Ids of more than one row."""
    faults, first = [], {}
    for i, query_id in enumerate(rows.query_ids):
        before = first.setdefault(query_id, i)
        if before != i and query_id:
            expected = f"one row per query, but line {rows.lines[before]} has the same id"
            repair = f"delete line {rows.lines[i]} or line {rows.lines[before]}"
            faults.append(rows.fault(i, "query_id", "duplicate-id", expected, repair))
    return faults


def _quaternion_faults(rows: Rows) -> list[Fault]:
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(rows.numbers[:, :4], axis=1)
        off = np.abs(norm - 1)  # NaN, for fields with another fault, compares false
    faults = []
    for i in np.flatnonzero(off > NORM_WARNING).tolist():
        if norm[i] < ZERO_NORM:
            repair = "write 1,0,0,0 for no rotation"
            faults.append(rows.fault(i, "qw", "zero-quaternion", "a quaternion of norm 1, got 0", repair))
            continue
        expected = f"qw, qx, qy, qz of norm 1, got {norm[i]:.6g}"
        repair = "divide the four by their norm" if norm[i] < 2 else "write a unit quaternion, not angles in degrees"
        severity = "error" if off[i] > NORM_ERROR else "warning"
        faults.append(rows.fault(i, "qw", "quaternion-norm", expected, repair, severity))
    return faults


def _position_faults(rows: Rows) -> list[Fault]:
    size = np.abs(rows.numbers[:, 4:7])
    in_metres = bool(np.nanmedian(size.max(axis=1)) < FAR_POSITION) if np.isfinite(size).all(axis=1).any() else False
    expected, repair = f"metres, at most {FAR_POSITION:g}", "divide millimetres by 1000"
    faults = []
    for i, j in np.argwhere(size > (FAR_POSITION if in_metres else LARGEST_POSITION)).tolist():
        severity = "error" if size[i, j] > LARGEST_POSITION else "warning"
        faults.append(rows.fault(i, "xyz"[j], "position-range", expected, repair, severity))
    return faults


def _confidence_faults(rows: Rows) -> list[Fault]:
    confidence = rows.numbers[:, 7]
    faults = []
    for i in np.flatnonzero((confidence < 0) | (confidence > 1)).tolist():
        percent = 1 < confidence[i] <= 100
        repair = "divide percent by 100" if percent else "scale scores to 0 .. 1, or write 1 when the method has none"
        faults.append(rows.fault(i, "confidence", "confidence-range", "0 to 1", repair))
    return faults


def _seconds_faults(rows: Rows) -> list[Fault]:
    seconds = rows.numbers[:, 8]
    expected, repair = "0 or more", "write -1 when it was not measured"
    invalid = np.flatnonzero((seconds < 0) & (seconds != NOT_MEASURED)).tolist()
    return [rows.fault(i, "seconds", "seconds-range", expected, repair) for i in invalid]
