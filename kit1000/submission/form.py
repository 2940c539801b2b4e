"""Rules that every row of a predictions file keeps by itself, whatever the dataset."""

from __future__ import annotations

import re

import numpy as np

from kit1000.submission.faults import Fault
from kit1000.submission.rows import Rows

NORM_WARNS, NORM_REFUSED = 1e-3, 1e-2  # how far the norm of a quaternion may be off 1
ZERO_NORM = 1e-9  # below which a quaternion points nowhere
FAR, TOO_FAR = 10.0, 1e6  # [m] a motion is some 0.3 m; numbers beyond the second are none of a table
NOT_MEASURED = -1.0  # seconds
ID = re.compile(r"(?!#|query_id\Z)[!#-+\--~]+\Z")  # printable ASCII without blanks, quotes and commas


def form_faults(rows: Rows) -> list[Fault]:
    """Ids, quaternions, positions, confidences and seconds that cannot be, or are odd."""
    return [
        *_id_faults(rows),
        *_doubles(rows),
        *_quaternion_faults(rows),
        *_position_faults(rows),
        *_confidence_faults(rows),
        *_seconds_faults(rows),
    ]


def _id_faults(rows: Rows) -> list[Fault]:
    faults = []
    for i, query_id in enumerate(rows.query_ids):
        if not ID.match(query_id):
            name = "odd-id" if query_id else "empty-id"
            repair = "copy the id as the dataset has it: letters, digits and hyphens"
            faults.append(rows.fault(i, "query_id", name, "a query id such as test-s0007-p2-snap", repair))
    return faults


def _doubles(rows: Rows) -> list[Fault]:
    """Ids that stand in two rows."""
    faults, first = [], {}
    for i, query_id in enumerate(rows.query_ids):
        before = first.setdefault(query_id, i)
        if before != i and query_id:
            wanted = f"one row a query, and line {rows.lines[before]} has this one"
            repair = f"delete line {rows.lines[i]} or line {rows.lines[before]}"
            faults.append(rows.fault(i, "query_id", "double", wanted, repair))
    return faults


def _quaternion_faults(rows: Rows) -> list[Fault]:
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(rows.numbers[:, :4], axis=1)
        off = np.abs(norm - 1)  # NaN, for fields that have a fault already, is never off
    faults = []
    for i in np.flatnonzero(off > NORM_WARNS).tolist():
        if norm[i] < ZERO_NORM:
            repair = "write 1,0,0,0 for no turn"
            faults.append(rows.fault(i, "qw", "zero-quaternion", "a quaternion of norm 1, got 0", repair))
            continue
        wanted = f"qw, qx, qy, qz of norm 1, got {norm[i]:.6g}"
        repair = "divide the four by their norm" if norm[i] < 2 else "write a unit quaternion, not angles in degrees"
        kind = "error" if off[i] > NORM_REFUSED else "warning"
        faults.append(rows.fault(i, "qw", "not-unit", wanted, repair, kind))
    return faults


def _position_faults(rows: Rows) -> list[Fault]:
    size = np.abs(rows.numbers[:, 4:7])
    usual = bool(np.nanmedian(size.max(axis=1)) < FAR) if np.isfinite(size).all(axis=1).any() else False
    faults = []
    for i, j in np.argwhere(size > (FAR if usual else TOO_FAR)).tolist():
        kind = "error" if size[i, j] > TOO_FAR else "warning"
        faults.append(
            rows.fault(i, "xyz"[j], "far", f"metres, at most {FAR:g} of them", "divide millimetres by 1000", kind)
        )
    return faults


def _confidence_faults(rows: Rows) -> list[Fault]:
    confidence = rows.numbers[:, 7]
    faults = []
    for i in np.flatnonzero((confidence < 0) | (confidence > 1)).tolist():
        percent = 1 < confidence[i] <= 100
        repair = "divide percent by 100" if percent else "map scores to 0 .. 1; write 1 when there are none"
        faults.append(rows.fault(i, "confidence", "confidence-range", "0 to 1", repair))
    return faults


def _seconds_faults(rows: Rows) -> list[Fault]:
    seconds = rows.numbers[:, 8]
    wanted, repair = "0 or more", "write -1 when it was not measured"
    odd = np.flatnonzero((seconds < 0) & (seconds != NOT_MEASURED)).tolist()
    return [rows.fault(i, "seconds", "seconds-range", wanted, repair) for i in odd]
