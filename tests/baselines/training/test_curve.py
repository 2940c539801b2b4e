"""Learning curves: an SVG for any log, every line inside its frame, few grid lines."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from baselines.training.curve import curve
from kit1000.pictures.charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH

VALUES = st.floats(1e-9, 1e9) | st.floats(-1e6, -1e-9) | st.just(0.0)


def log(losses: list[float]) -> list[dict[str, Any]]:
    """Rows with these losses and a measure derived from them."""
    return [
        {"step": 50 * (i + 1), "loss": loss, "measures": {"a<b": {"mean": 2 * loss, "median": loss}}}
        for i, loss in enumerate(losses)
    ]


def points_of(text: str) -> list[tuple[float, float]]:
    """Points of all lines, by chart."""
    lines = re.findall(r'class="line stroke-\d"[^>]* d="M([^"h]+)"', text)
    return [(float(x), float(y)) for line in lines for x, y in (point.split() for point in line.split("L"))]


@given(losses=st.lists(VALUES, min_size=1, max_size=8))
def test_every_log_is_drawn_inside_its_frame(losses: list[float]) -> None:
    text = curve(log(losses))
    ElementTree.fromstring(text)
    points = points_of(text)
    assert len(points) == 3 * len(losses)
    assert all(LEFT - 0.01 <= x <= WIDTH - RIGHT + 0.01 for x, _ in points)
    assert all(TOP - 0.01 <= y <= HEIGHT - BOTTOM + 0.01 for _, y in points)
    assert 2 <= text.count('class="rule"') / 2 <= 8


def test_a_log_without_rows_is_an_empty_chart() -> None:
    ElementTree.fromstring(curve([]))
    assert points_of(curve([])) == []


def test_values_over_orders_of_magnitude_have_a_logarithmic_axis() -> None:
    for losses in ([1.0, 0.1, 0.01], [1.0, 0.6, 0.2]):
        (_, first), (_, second), (_, third) = points_of(curve(log(losses)))[:3]
        assert third - second == pytest.approx(second - first, abs=0.02)
