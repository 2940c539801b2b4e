"""Charts: positions of numbers, ends of axes at round numbers, escaped text, the same bytes each time."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.pictures.charts import (
    GAP,
    HEIGHT,
    LEFT,
    RIGHT,
    STYLE,
    TICKS,
    TOP,
    WIDTH,
    Axis,
    Dot,
    Line,
    dot_plot,
    histogram,
    interval_mark,
    line_chart,
    rounded_up,
    standalone,
    tick_step,
)

NASTY = "<script>alert('x')</script> & \"more\""
X, Y = Axis("guess [mm]", 28), Axis("left [mm]", 30)


def elements(svg: str, kind: str) -> list[ElementTree.Element]:
    return [element for element in ElementTree.fromstring(svg).iter() if element.tag.rpartition("}")[2] == kind]


def texts(svg: str) -> list[str]:
    return [element.text or "" for element in elements(svg, "text")]


@given(st.floats(1e-9, 1e9))
def test_axes_end_at_the_tick_above_the_largest_value(largest: float) -> None:
    end, step = rounded_up(largest), tick_step(largest)
    assert end >= largest * (1 - 1e-9)
    assert end - step < largest * (1 + 1e-9)
    assert 1 <= len(Axis("", end).ticks) - 1 <= TICKS + 1
    assert f"{step:e}"[0] in "125"


@pytest.mark.parametrize("largest", [0.0, -1.0, float("nan"), float("inf")])
def test_an_axis_without_values_has_ticks(largest: float) -> None:
    assert tick_step(largest) == 1


def test_points_of_a_line_are_at_their_values() -> None:
    points = elements(line_chart("t", "d", [Line("a", [0, 14, 28], [30, 15, 0])], X, Y), "circle")
    u, v = ([float(point.attrib[name]) for point in points] for name in ("cx", "cy"))
    assert u == [LEFT, (LEFT + WIDTH - RIGHT) / 2, WIDTH - RIGHT]
    assert v[0] == TOP
    assert v[1] == pytest.approx((v[0] + v[2]) / 2)
    assert v[2] < HEIGHT


def test_a_band_runs_along_its_high_end_and_back_along_its_low_end() -> None:
    line = Line("a", [0, 28], [10, 10], low=[0, 0], high=[30, 30])
    (band,) = elements(line_chart("t", "d", [line], X, Y), "polygon")
    corners = [tuple(map(float, pair)) for pair in zip(*[iter(band.attrib["points"].split())] * 2, strict=True)]
    right = WIDTH - RIGHT
    assert [u for u, _ in corners] == [LEFT, right, right, LEFT]
    assert [v == TOP for _, v in corners] == [True, True, False, False]


def test_several_lines_have_a_legend_that_names_lines_without_points_too() -> None:
    one, empty = Line("first", [0, 28], [1, 2]), Line("second", [], [])
    assert "first" not in texts(line_chart("t", "d", [one], X, Y))
    both = line_chart("t", "d", [one, empty], X, Y)
    assert {"first", "second"} <= {*texts(both)}
    assert len(elements(both, "circle")) == 2
    assert elements(both, "svg")[0].attrib["viewBox"] != f"0 0 {WIDTH} {HEIGHT}"


def test_bars_are_as_high_as_their_counts_and_the_open_bin_is_labelled() -> None:
    svg = histogram("t", "d", [0, 1, 5, None], [4, 0, 2], "error [mm]")
    bars = elements(svg, "rect")
    heights = [float(bar.attrib["height"]) for bar in bars]
    assert heights[0] == pytest.approx(2 * heights[2])
    assert heights[1] == 0
    assert [bar[0].text for bar in bars] == ["0 to 1: 4", "1 to 5: 0", "5 and more: 2"]
    assert {"n = 6", "∞", "error [mm]", "queries"} <= {*texts(svg)}


def test_a_mean_beyond_the_scale_becomes_an_arrow() -> None:
    inside, beyond = (interval_mark(Dot("mean", value, value - 1, value + 1), 10) for value in (5.0, 50.0))
    assert len(elements(inside, "circle")) == 1
    assert not elements(beyond, "circle")
    assert interval_mark(Dot("none", None, None, None), 10).count("<path") == 1


def charts(text: str) -> list[str]:
    line = Line(text, [0, 1], [0, 1], [0, 0], [1, 1])
    return [
        line_chart(text, text, [line, line], Axis(text, 1), Axis(text, 1), identity=True, note=text),
        histogram(text, text, [0, 1, None], [1, 2], text),
        dot_plot(text, text, [Dot(text, 1, 0, 2, text)], Axis(text, 2)),
        interval_mark(Dot(text, 1, 0, 2), 2),
    ]


def test_text_is_never_markup() -> None:
    for svg in charts(NASTY):
        assert "<script" not in svg
        assert not elements(svg, "script")
        assert any((element.text or "").startswith("<scr") for element in ElementTree.fromstring(svg).iter())


def test_every_class_is_in_the_style() -> None:
    known = set(re.findall(r"\.([a-z][\w-]*)", STYLE)) | {"mark"}
    for svg in charts("x"):
        used = {name for element in ElementTree.fromstring(svg).iter() for name in element.get("class", "").split()}
        assert used <= known | {"stroke-0", "fill-0"}


def test_a_standalone_file_includes_its_style_and_every_chart() -> None:
    whole = standalone([charts("a")[:2], charts("b")[:1]])
    assert whole == standalone([charts("a")[:2], charts("b")[:1]])
    placed = elements(whole, "svg")
    assert [(chart.get("x"), chart.get("y")) for chart in placed[1:]] == [
        ("0", "0"),
        (str(WIDTH), "0"),
        ("0", str(int(placed[1].attrib["height"]) + GAP)),
    ]
    assert elements(whole, "style")[0].text == f"\n{STYLE}"
