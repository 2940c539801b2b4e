"""Learning curves as an SVG file, from the log of a training run: a chart of the loss and one of each measure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kit1000.pictures.charts import Axis, Line, axis_around, line_chart, standalone


def curve(rows: Sequence[Mapping[str, Any]]) -> str:
    """An SVG file of the rows of a log, possibly none: the same rows give the same bytes."""
    steps = [row["step"] for row in rows]
    charts = [_chart("loss", [Line("mean", steps, [row["loss"] for row in rows], hue=1, dash=1)])]
    for name in rows[0]["measures"] if rows else ():
        median, mean = ([row["measures"][name][kind] for row in rows] for kind in ("median", "mean"))
        charts.append(_chart(name, [Line("median", steps, median), Line("mean", steps, mean, hue=1, dash=1)]))
    return standalone([[chart] for chart in charts])


def _chart(title: str, lines: Sequence[Line]) -> str:
    x = Axis("step", max(lines[0].x, default=1))
    return line_chart(title, "By training step.", lines, x, axis_around("", [y for line in lines for y in line.y]))
