"""Conformance checks for those who extend the package: run them on your own class or function in your own tests.

Each check raises AssertionError with one line that says what was broken and by how much.
"""

from __future__ import annotations

from kit1000.testing.families import check_family, check_symmetry, distances
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
    "distances",
    "moved_geometry",
    "moved_query",
    "moved_truth",
]
