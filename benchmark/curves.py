"""The table of the robustness curves: the errors that a method leaves, level by level of the guess's error.

The same queries are repeated at every level of one kind of error while the other kind stays fixed. The position error
left is set against the position error of the guess, the rotation error left against the rotation error of the guess.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmark.quantities import POSITION, ROTATION, Quantity, Unit
from kit1000.errors import ShapeError
from kit1000.queries.guesses import LEVELS, level_angle, level_offset
from kit1000.queries.tracks import curve_levels

BAND = (20, 80)  # percentiles about each line, as in the paper

Row = dict[str, Any]
Table = Mapping[str, Sequence[Mapping[str, Any]]]
"""Rows by name of a curve: one for each fixed error and level."""


@dataclass(frozen=True)
class Curve:
    """One of the two curves: the kind of error that varies, and the kind that stays fixed."""

    name: str
    """Its key in the table."""
    fixed_name: str
    varied: str
    """The kind that varies, as query ids spell it."""
    quantity: Quantity
    """The error that is left, of the kind that varies."""
    levels: tuple[float, ...]
    """The guess's errors, in the unit of the quantity."""
    fixed_unit: Unit
    fixed_levels: tuple[float, ...]
    """The errors of the kind that stays fixed."""

    @property
    def unit(self) -> Unit:
        """Unit of the kind that varies."""
        return self.quantity.unit

    def user(self, row: Mapping[str, Any]) -> float:
        """The guess's error of the kind that varies, from a row of the table."""
        return row[f"user_{self.unit.text}"]

    def fixed(self, row: Mapping[str, Any]) -> float:
        """The guess's error of the kind that stays fixed, from a row of the table."""
        return row[f"fixed_{self.fixed_unit.text}"]

    def fixed_errors(self, *tables: Table) -> list[float]:
        """The fixed errors of all lines of some tables, smallest first."""
        return sorted({self.fixed(row) for table in tables for row in table[self.name]})


MM = tuple(1000 * level_offset(level) for level in range(LEVELS))
DEG = tuple(float(np.degrees(level_angle(level))) for level in range(LEVELS))
CURVES = (
    Curve("position", "rotation", "pos", POSITION, MM, ROTATION.unit, DEG),
    Curve("rotation", "position", "rot", ROTATION, DEG, POSITION.unit, MM),
)


def curve_table(query_ids: Sequence[str], position_mm: ArrayLike, rotation_deg: ArrayLike) -> dict[str, list[Row]]:
    """Both curves from the errors of single queries.

    Args:
        query_ids: n ids of the curves, such as curves-s0007-p2-pos3-rot1, in any order; some may be left out.
        position_mm: (n,) position errors [mm]; NaN if a method predicts rotations alone.
        rotation_deg: (n,) rotation errors [degrees].

    Returns:
        Under "position" and "rotation" a row for every fixed error and level of the ids, in this order: the fixed
        error and that of the level in mm and degrees, n, and of the error left mean, median, 20th and 80th percentile,
        null if it was not measured.
    """
    left = {"pos": _errors(POSITION, position_mm, query_ids), "rot": _errors(ROTATION, rotation_deg, query_ids)}
    groups: dict[tuple[str, int, int], list[float]] = defaultdict(list)
    for i, query_id in enumerate(query_ids):
        varied, level, fixed = curve_levels(query_id)
        groups[varied, fixed, level].append(left[varied][i])
    return {
        curve.name: [
            _row(curve, fixed, level, groups[varied, fixed, level])
            for varied, fixed, level in sorted(groups)
            if varied == curve.varied
        ]
        for curve in CURVES
    }


def _errors(quantity: Quantity, values: ArrayLike, query_ids: Sequence[str]) -> np.ndarray:
    """(n,) float64, one for each id; NaN is allowed."""
    errors = np.asarray(values, np.float64)
    if errors.shape != (len(query_ids),):
        raise ShapeError(f"{quantity.key}: expected shape ({len(query_ids)},), one for each query, got {errors.shape}")
    return errors


def _row(curve: Curve, fixed: int, level: int, errors: Sequence[float]) -> Row:
    """A row of the table; fixed, level: indices of the guess's errors."""
    guess = {
        f"fixed_{curve.fixed_unit.text}": curve.fixed_levels[fixed],
        f"user_{curve.unit.text}": curve.levels[level],
        "level": level,
        "n": len(errors),
    }
    low, high = np.percentile(errors, BAND)
    left = {"mean": np.mean(errors), "median": np.median(errors), "p20": low, "p80": high}
    return guess | {name: float(value) if np.isfinite(value) else None for name, value in left.items()}
