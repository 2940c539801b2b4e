"""Checks of all rows of a predictions file together: units, quaternion order, and conventions of motions.

Statistical: a fault is reported when the numbers are implausible as they are, and plausible when read another way.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from kit1000.pose import Pose, quaternion_angle
from kit1000.submission.conventions import convention_findings, sample_of
from kit1000.submission.faults import Fault
from kit1000.submission.rows import Rows

if TYPE_CHECKING:
    from kit1000.submission.expected_queries import ExpectedQueries

UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}  # [m]
DOUBTFUL = 2.0  # [m] median length of a position above which it is probably not in metres; correct ones: 0.3 m
IMPOSSIBLE = 10.0  # [m] the same, certainly
MILLIMETRES = 95.0  # the same above which it is rather in millimetres than in centimetres
LARGEST_LENGTH = 1e9  # positions beyond are left out
LEAST_ROWS = 10  # for a comparison with guesses
LEAST_ROWS_ALONE = 20  # for statistics without guesses
FAR_ANGLE, NEAR_ANGLE = np.radians(60), np.radians(40)  # median angle to the guess: no method's, every method's
WORLD_MOTION = "goal_from_now, a motion in the world frame"
SIGMAS = 5.0  # standard errors by which two mean squares must differ
NORM_RANGE = (0.5, 2.0)  # norms of four numbers that are taken for a quaternion


def plausibility_faults(rows: Rows, expected: ExpectedQueries | None, rotation_only: bool) -> list[Fault]:
    """Faults of the rows as a whole; with the queries of the dataset, guesses make them more certain."""
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(rows.numbers[:, :4], axis=1)
    usable = np.isfinite(rows.numbers[:, :7]).all(axis=1) & (norm > NORM_RANGE[0]) & (norm < NORM_RANGE[1])
    usable &= np.abs(np.nan_to_num(rows.numbers[:, 4:7])).max(axis=1, initial=0) < LARGEST_LENGTH
    wxyz, xyz = rows.numbers[usable, :4], rows.numbers[usable, 4:7]
    index = None if expected is None else _query_index(rows, expected, usable)
    faults = _angle_faults(rows, norm)
    if len(wxyz) == 0:
        return faults
    unit, scale = (None, 1.0) if rotation_only else _unit_fault(wxyz, xyz, expected, index)
    guesses = None if expected is None or index is None else expected.guessed_rotations[index]
    order = _order_fault(wxyz, guesses)
    faults += [_fault(rows, *details) for details in (unit, order) if details]
    if expected is not None and index is not None and not rotation_only:
        motions = Pose(np.roll(wxyz, 1, axis=1) if order else wxyz, xyz * scale)
        sample = sample_of(expected, index, motions)
        for found in () if sample is None else convention_findings(sample, order is not None):
            severity = "error" if found.is_error else "warning"
            faults.append(_fault(rows, found.code, found.actual, WORLD_MOTION, found.repair, severity))
    return faults


FaultDetails = tuple[str, str, str, str, Literal["error", "warning"]]  # code, actual, expected, repair, severity


def _fault(
    rows: Rows, code: str, actual: str, expected: str, repair: str, severity: Literal["error", "warning"]
) -> Fault:
    return Fault(rows.file, None, None, actual, expected, repair, severity, code)


def _query_index(rows: Rows, expected: ExpectedQueries, usable: np.ndarray) -> np.ndarray:
    """(k,) the index of the query of each usable row; -1 for an unknown id."""
    return np.array([expected.index.get(rows.query_ids[i], -1) for i in np.flatnonzero(usable)], dtype=np.int64)


def _angle_faults(rows: Rows, norm: np.ndarray) -> list[Fault]:
    """Most quaternions far from unit norm: their columns contain something else."""
    finite = norm[np.isfinite(norm)]
    if len(finite) < LEAST_ROWS or np.median(np.abs(finite - 1)) < 0.05:
        return []
    largest = float(np.nanmedian(np.nanmax(np.abs(rows.numbers[:, :4]), axis=1)))
    what = "angles in degrees" if largest > 4 else "angles, or quaternions that are not normalised"
    actual = f"most of qw, qx, qy, qz have a norm far from 1 (median {np.median(finite):.3g}), probably {what}"
    repair = "convert them: q = (cos(a/2), sin(a/2) * axis) of the angle a in radians"
    return [_fault(rows, "angles-suspected", actual, "unit quaternions, scalar first", repair, "error")]


def _unit_fault(
    wxyz: np.ndarray, xyz: np.ndarray, expected: ExpectedQueries | None, index: np.ndarray | None
) -> tuple[FaultDetails | None, float]:
    """A fault of the unit of the positions, and the unit in metres: that in which most parts lie in their kits."""
    median = float(np.median(np.linalg.norm(xyz, axis=1)))
    if median <= DOUBTFUL:
        return None, 1.0
    likely = "millimetres" if median > MILLIMETRES else "centimetres"

    def plausibility(unit: str) -> tuple[float, bool]:
        sample = None
        if expected is not None and index is not None:
            sample = sample_of(expected, index, Pose(wxyz, xyz * UNITS[unit]))
        return (0.0 if sample is None else sample.share(sample.motions.apply(sample.pivots))), unit == likely

    unit = max(UNITS, key=plausibility)
    actual = f"the median length of x, y, z is {median:.4g}, probably {unit}"
    severity = "error" if median > IMPOSSIBLE else "warning"
    return (f"{unit}-suspected", actual, "metres", f"multiply x, y, z by {UNITS[unit]:g}", severity), UNITS[unit]


def _order_fault(wxyz: np.ndarray, guesses: np.ndarray | None) -> FaultDetails | None:
    """A fault when the scalar is probably last."""
    expected, repair = "the scalar first: qw, qx, qy, qz", "move the last of the four to the front"
    if guesses is not None:
        with_guess = np.isfinite(guesses).all(axis=1)
        if with_guess.sum() >= LEAST_ROWS:
            orders = (wxyz, np.roll(wxyz, 1, axis=1))
            as_is, moved = (_median_angle(q[with_guess], guesses[with_guess]) for q in orders)
            if as_is <= FAR_ANGLE or moved >= NEAR_ANGLE:
                return None
            actual = f"rotations are {_degrees(as_is)} from the guesses, but {_degrees(moved)} with the scalar last"
            return "scalar-last-suspected", f"{actual}: probably x, y, z, w", expected, repair, "error"
    if not _scalar_looks_last(wxyz):
        return None
    actual = "qz has the statistics of the scalar of a quaternion, and qw those of its x: probably x, y, z, w"
    return "scalar-last-suspected", actual, expected, repair, "warning"


def _scalar_looks_last(wxyz: np.ndarray) -> bool:
    """Motions on a table rotate mostly about the vertical: w and z are large, x and y small.

    With the scalar last, the columns of x and y contain y and z, so that the third column is larger than the first.
    """
    last_is_one = np.abs(wxyz[:, 3]) > 1 - 1e-9
    if len(wxyz) >= 5 and last_is_one.mean() > 0.5 and not (np.abs(wxyz[:, 0]) > 1 - 1e-9).any():
        return True  # (0, 0, 0, 1): no rotation, or every part by exactly 180 degrees
    if len(wxyz) < LEAST_ROWS_ALONE:
        return False
    difference = wxyz[:, 0] ** 2 - wxyz[:, 2] ** 2
    return bool(difference.mean() < -SIGMAS * difference.std() / np.sqrt(len(wxyz))) and _first_is_small(wxyz)


def _first_is_small(wxyz: np.ndarray) -> bool:
    return bool(np.mean(wxyz[:, 0] ** 2) < 0.2 and np.mean(wxyz[:, 3] ** 2) > 0.25)


def _median_angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.median(quaternion_angle(a, b)))


def _degrees(angle: float) -> str:
    return f"{np.degrees(angle):.0f} degrees"
