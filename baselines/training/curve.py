"""Learning curves as SVG, from the log of a training run: a chart of the loss and one of each measure, by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import ceil, floor, log10
from typing import Any

WIDTH, HEIGHT = 360, 220  # [px] of a chart
LEFT, RIGHT, TOP, BOTTOM = 52, 14, 30, 34  # [px] around the plotted area
LOG_RATIO = 10.0  # largest over smallest value above which an axis is logarithmic
STYLE = """\
svg { --ink: #1f2328; --rule: #dfe3e8; --median: #2f6f9f; --mean: #c2571a; --paper: #ffffff;
  font: 12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
@media (prefers-color-scheme: dark) { svg { --ink: #e6e9ed; --rule: #2c333c; --median: #6cb2e6; --mean: #f2955a;
  --paper: #12161b; } }
text { fill: var(--ink); } .title { font-weight: 600; } .end { text-anchor: end; } .rule { stroke: var(--rule); }
path { fill: none; stroke-width: 2; stroke-linejoin: round; } .paper { fill: var(--paper); }
.median { stroke: var(--median); } .mean { stroke: var(--mean); stroke-dasharray: 6 4; }
.median-name { fill: var(--median); } .mean-name { fill: var(--mean); }
"""

Points = list[tuple[float, float]]


def curve(rows: Sequence[Mapping[str, Any]]) -> str:
    """An SVG file of the rows of a log, possibly none: the same rows give the same bytes."""
    charts = [_chart("loss", {"mean": [(row["step"], row["loss"]) for row in rows]})]
    for name in rows[0]["measures"] if rows else ():
        kinds = ("median", "mean")
        charts.append(_chart(name, {k: [(row["step"], row["measures"][name][k]) for row in rows] for k in kinds}))
    height = HEIGHT * len(charts)
    moved = [f'<g transform="translate(0 {HEIGHT * i})">{chart}</g>' for i, chart in enumerate(charts)]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" role="img" viewBox="0 0 {WIDTH} {height}" width="{2 * WIDTH}">'
    paper = f'<rect class="paper" width="{WIDTH}" height="{height}"/>'
    return f"{head}<title>training</title><style>{STYLE}</style>{paper}{''.join(moved)}</svg>\n"


def _chart(title: str, lines: Mapping[str, Points]) -> str:
    """Lines by their kind, over a grid; logarithmic where values span more than LOG_RATIO."""
    values = [value for points in lines.values() for _, value in points]
    last = max([step for points in lines.values() for step, _ in points], default=1)
    ticks, log = _ticks(values)
    low, high = (log10(ticks[0]), log10(ticks[-1])) if log else (ticks[0], ticks[-1])

    def pixel(step: float, value: float) -> tuple[float, float]:
        share = ((log10(value) if log else value) - low) / (high - low)
        return LEFT + (WIDTH - LEFT - RIGHT) * step / last, HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share

    marks = [f'<text class="title" x="{LEFT}" y="18">{escape(title)}</text>']
    for tick in ticks:
        y = pixel(0, tick)[1]
        marks.append(f'<path class="rule" d="M{LEFT} {y:.2f}H{WIDTH - RIGHT}" style="stroke-width:1"/>')
        marks.append(f'<text class="end" x="{LEFT - 6}" y="{y + 4:.2f}">{tick:.4g}</text>')
    for i, (kind, points) in enumerate(lines.items()):
        path = "L".join(f"{x:.2f} {y:.2f}" for x, y in (pixel(*point) for point in points))
        marks.append(f'<path class="{kind}" d="M{path}"/>' if points else "")
        marks.append(f'<text class="end {kind}-name" x="{WIDTH - RIGHT - 60 * i}" y="18">{kind}</text>')
    marks.append(f'<text x="{LEFT}" y="{HEIGHT - 12}">0</text>')
    marks.append(f'<text class="end" x="{WIDTH - RIGHT}" y="{HEIGHT - 12}">step {last:.10g}</text>')
    return "".join(marks)


def _ticks(values: Sequence[float]) -> tuple[list[float], bool]:
    """Round numbers that enclose all values, at least two, and whether the axis is logarithmic."""
    low, high = min(values, default=0.0), max(values, default=1.0)
    if low > 0 and high / low > LOG_RATIO:
        powers = range(floor(log10(low)), ceil(log10(high)) + 1)
        every = ceil(len(powers) / 6)
        return [10.0**power for power in range(powers[0], powers[-1] + every, every)], True
    low, high = min(low, 0.0), max(high, 0.0)
    step = _step((high - low) or 1.0)
    return [
        step * i for i in range(floor(low / step + 1e-9), (ceil(high / step - 1e-9) if high > low else 1) + 1)
    ], False


def _step(span: float) -> float:
    """The smallest of 1, 2 or 5 times a power of ten that spans this in five steps."""
    power = 10.0 ** floor(log10(span / 5))
    return next(step * power for step in (1, 2, 5, 10) if step * power * 5 >= span * (1 - 1e-9))
