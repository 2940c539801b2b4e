"""Conformance checks of your own method or part family: call them in your own tests.

A failed check raises AssertionError with one line: the violated rule and the measured value.
"""

from __future__ import annotations

from kit1000.testing.families import check_family, check_symmetry, surface_distances
from kit1000.testing.predictors import check_predictor, moved_geometry, moved_query, moved_truth

__all__ = [
    "check_family",
    "check_predictor",
    "check_symmetry",
    "moved_geometry",
    "moved_query",
    "moved_truth",
    "surface_distances",
]
