"""Near-duplicates: parts of practically the same shape.

Two parts are near-duplicates when five scale-invariant measures all differ by less than MIN_DIFFERENCE: share of the
bounding box filled, share of the convex hull filled, two ratios of the box's sides, and area over volume^(2/3).
"""

from __future__ import annotations

from decimal import Context, Decimal

import numpy as np
from scipy.spatial import ConvexHull

from kit1000.mesh import Mesh

MIN_DIFFERENCE = 0.01  # relative difference of two different parts in at least one measure
DIGITS = 40  # of intermediate results: twice those of a float64 and some


def shape_measures(mesh: Mesh) -> np.ndarray:
    """(5,) fill of the box, fill of the convex hull, middle / longest side, shortest / longest, area / volume^(2/3)."""
    short, middle, long = np.sort(mesh.extents)
    hull = ConvexHull(mesh.vertices).volume
    return np.array(
        [
            mesh.volume / mesh.extents.prod(),
            mesh.volume / hull,
            middle / long,
            short / long,
            mesh.area / power(mesh.volume, 2 / 3),
        ]
    )


def power(base: float, exponent: float) -> float:
    """The power of a positive number, correctly rounded: those of numpy and C differ in the last bit by processor."""
    return float(Context(prec=DIGITS).power(Decimal(float(base)), Decimal(exponent)))


def near_duplicate_of(measures: np.ndarray, others: np.ndarray) -> int | None:
    """Index of the first near-duplicate, among others (n, 5), of a part with the given measures (5,); or None."""
    alike = (np.abs(others / measures - 1) < MIN_DIFFERENCE).all(1)
    return int(alike.argmax()) if alike.any() else None
