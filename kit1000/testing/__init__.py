"""Conformance checks of extensions: call them on your own class or function in your own tests.

A failed check raises AssertionError with one line: the violated rule and the measured value.
"""

from __future__ import annotations

from kit1000.testing.families import check_family, check_symmetry, surface_distances
from kit1000.testing.metrics import check_metric
from kit1000.testing.predictors import check_predictor, moved_geometry, moved_query, moved_truth
from kit1000.testing.renderers import check_renderer
from kit1000.testing.sensors import check_sensor
from kit1000.testing.sources import check_source

__all__ = [
    "check_family",
    "check_metric",
    "check_predictor",
    "check_renderer",
    "check_sensor",
    "check_source",
    "check_symmetry",
    "moved_geometry",
    "moved_query",
    "moved_truth",
    "surface_distances",
]
