"""Charts as SVG text: lines with bands, histograms, means with their intervals.

A chart is as wide as the column of a phone, so its text stays legible; pages set several side by side. Colours are
variables with a light and a dark set, defined by STYLE: a page has it in its style sheet, a file of its own includes it
(`standalone`). The same numbers give the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, isfinite, log10

WIDTH, HEIGHT = 360, 260  # [px] of a chart before its legend
LEFT, RIGHT, TOP, BOTTOM = 46, 14, 34, 44  # [px] around the plotted area
LEGEND_ROW = 18  # [px]
LETTER = 6.9  # [px] width of a letter of a label, on average
MAX_NAME = 40  # letters of a name in a legend; longer ones are cut
DOT_ROW = 26  # [px] height of a line of a dot plot
NAMES, NOTES = 122, 62  # [px] beside a dot plot
MARK = (84, 16)  # [px] of an interval in a cell of a table
TICKS = 5
MOST_POINTS = 40  # of a line that marks each of its points
GAP = 12  # [px] below a row of a file of its own
DASHES = ("", "6 4", "1.5 4")  # of the lines of a chart in turn: the paper's figure dots the largest error
LIGHT = ("#2f6f9f", "#c2571a", "#8a4f86", "#1f7f74", "#8f6b10", "#5c6670")  # colours of lines in turn, by day
DARK = ("#6cb2e6", "#f2955a", "#d29ace", "#58c2b4", "#dcb552", "#aab4bf")
HUES = len(LIGHT)


def _variables(ink: str, soft: str, rule: str, paper: str, hues: Sequence[str]) -> str:
    named = {"ink": ink, "soft": soft, "rule": rule, "paper": paper} | {f"hue-{i}": hue for i, hue in enumerate(hues)}
    return " ".join(f"--{name}: {colour};" for name, colour in named.items())


STYLE = f"""\
svg.chart {{ {_variables("#1f2328", "#5f6872", "#dfe3e8", "#ffffff", LIGHT)}
  font: 12px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; font-variant-numeric: tabular-nums; }}
@media (prefers-color-scheme: dark) {{ svg.chart {{ {_variables("#e6e9ed", "#9aa4af", "#2c333c", "#12161b", DARK)} }} }}
.chart text {{ fill: var(--ink); }} .chart .soft {{ fill: var(--soft); }} .chart .title {{ font-weight: 600; }}
.chart .end {{ text-anchor: end; }} .chart .middle {{ text-anchor: middle; }} .chart path {{ fill: none; }}
.chart .rule {{ stroke: var(--rule); }} .chart .axis {{ stroke: var(--soft); }} .chart .paper {{ fill: var(--paper); }}
.chart .identity {{ stroke: var(--soft); stroke-dasharray: 2 3; }} .chart .whisker {{ stroke-width: 1.5; }}
.chart .line {{ stroke-width: 2; stroke-linejoin: round; stroke-linecap: round; }} .chart .band {{ opacity: 0.15; }}
""" + "".join(
    f".chart .stroke-{i} {{ stroke: var(--hue-{i}); }} .chart .fill-{i} {{ fill: var(--hue-{i}); }}\n"
    for i in range(HUES)
)


@dataclass(frozen=True)
class Line:
    """A line of a chart, perhaps with a band about it."""

    name: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] = ()
    high: Sequence[float] = ()
    hue: int = 0
    dash: int = 0


@dataclass(frozen=True)
class Dot:
    """A mean with its interval, under a name."""

    name: str
    value: float | None
    low: float | None
    high: float | None
    note: str = ""  # text at the end of the line, such as n = 40


@dataclass(frozen=True)
class Axis:
    """An axis with its label, from 0 to `end`."""

    label: str
    end: float

    @property
    def ticks(self) -> list[float]:
        """Round numbers from 0 to no more than `end`."""
        step = tick_step(self.end)
        return [step * i for i in range(floor(self.end / step + 1e-9) + 1)]

    def fraction(self, value: float) -> float:
        """The position of a number: 0 at the start of the axis, 1 at its end, clipped."""
        return min(max(value / self.end, 0.0), 1.0)


def tick_step(end: float) -> float:
    """The smallest of 1, 2 or 5 times a power of ten that reaches `end` in TICKS steps."""
    if not (isfinite(end) and end > 0):
        return 1.0
    power = 10.0 ** floor(log10(end / TICKS))
    return next(step * power for step in (1, 2, 5, 10) if step * power * TICKS >= end * (1 - 1e-9))


def rounded_up(value: float) -> float:
    """The end of an axis that holds a number: the next tick."""
    step = tick_step(value)
    return max(ceil(value / step - 1e-9), 1) * step


def line_chart(
    title: str, description: str, lines: Sequence[Line], x: Axis, y: Axis, identity: bool = False, note: str = ""
) -> str:
    """Lines with their bands over a grid, and a legend of their names if there are several.

    Args:
        title: above the chart; a screen reader reads it with `description`.
        identity: whether to draw y = x: the error of the guess, unchanged.
        note: at the upper right, such as n = 40.
    """
    names = [line for line in lines if len(lines) > 1]
    frame = _Frame(x, y, LEFT, WIDTH - RIGHT, HEIGHT - BOTTOM)
    marks = [heading(title, note), frame.grid(), frame.across([(tick, number(tick)) for tick in x.ticks])]
    if identity:
        end = min(x.end, y.end)
        marks.append(f'<path class="identity" d="{frame.path([0, end], [0, end])}"/>')
    marks += [_band(frame, line) for line in lines if len(line.low)]  # all below all lines
    marks += [_stroke(frame, line) for line in lines if len(line.x)]
    legend, height = _legend(names)
    return svg(title, description, HEIGHT + height, [*marks, legend])


def histogram(title: str, description: str, edges: Sequence[float | None], counts: Sequence[int], label: str) -> str:
    """A bar for each bin, all of one width; if the last edge is None, the last bin is open and labelled so."""
    frame = _Frame(
        Axis(label, len(counts)), Axis("queries", rounded_up(max([*counts, 1]))), LEFT, WIDTH - RIGHT, HEIGHT - BOTTOM
    )
    bars = []
    for i, count in enumerate(counts):
        (left, top), (right, bottom) = frame.at(i + 0.08, count), frame.at(i + 0.92, 0)
        tooltip = f"<title>{escape(f'{_between(edges[i], edges[i + 1])}: {count}')}</title>"
        place = f'x="{px(left)}" y="{px(top)}" width="{px(right - left)}" height="{px(bottom - top)}"'
        bars.append(f'<rect class="fill-0" {place}>{tooltip}</rect>')
    every = ceil(len(counts) / 6) or 1
    ticks = [(float(i), number(edge)) for i, edge in enumerate(edges) if edge is not None and i % every == 0]
    if edges[-1] is None:
        ticks = [tick for tick in ticks if len(counts) - tick[0] > 0.8 * every] + [(float(len(counts)), "∞")]
    return svg(
        title, description, HEIGHT, [heading(title, f"n = {sum(counts)}"), frame.grid(), *bars, frame.across(ticks)]
    )


def dot_plot(title: str, description: str, dots: Sequence[Dot], axis: Axis, names: float = NAMES) -> str:
    """Means with their intervals under one another: names at the left, in a width [px], notes at the right."""
    bottom = TOP + DOT_ROW * len(dots)
    frame = _Frame(axis, None, names, WIDTH - NOTES, bottom)
    marks = [heading(title, "")]
    marks += [f'<path class="rule" d="M{px(frame.at(tick, 0)[0])} {TOP}V{bottom}"/>' for tick in axis.ticks]
    for i, dot in enumerate(dots):
        level = TOP + DOT_ROW * (i + 0.5)
        marks.append(written(names - 10, level + 4, cut(dot.name, int((names - 12) / LETTER)), "end"))
        marks.append(_interval(dot, level, lambda value: frame.at(value, 0)[0], axis.end))
        marks.append(written(WIDTH - 4, level + 4, dot.note, "soft end"))
    marks.append(frame.across([(tick, number(tick)) for tick in axis.ticks]))
    return svg(title, description, bottom + BOTTOM, marks)


def interval_mark(dot: Dot, end: float) -> str:
    """A mean with its interval for a cell of a table, from 0 to `end`; an arrow if the mean lies beyond."""
    width, height = MARK
    drawn = _interval(dot, height / 2, lambda value: 4 + (width - 8) * Axis("", end).fraction(value), end)
    head = f'<svg class="chart mark" role="img" viewBox="0 0 {width} {height}" width="{width}" height="{height}">'
    return (
        f'{head}<title>{escape(dot.name)}</title><path class="rule" d="M4 {px(height / 2)}H{width - 4}"/>{drawn}</svg>'
    )


def standalone(rows: Sequence[Sequence[str]]) -> str:
    """One SVG file of charts in rows, with its style and background."""
    heights = [max(map(_height, row)) + GAP for row in rows]
    width, height = WIDTH * max(map(len, rows)), sum(heights)
    placed = [
        chart.replace(
            "<svg ", f'<svg x="{WIDTH * column}" y="{sum(heights[:row])}" width="{WIDTH}" height="{_height(chart)}" ', 1
        )
        for row, charts in enumerate(rows)
        for column, chart in enumerate(charts)
    ]
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" {size}>\n<style>\n{STYLE}</style>'
    return "\n".join([head, f'<rect class="paper" width="{width}" height="{height}"/>', *placed, "</svg>\n"])


@dataclass(frozen=True)
class _Frame:
    """The plotted area: numbers to positions in the picture."""

    x: Axis
    y: Axis | None
    left: float
    right: float
    bottom: float

    def at(self, x: float, y: float) -> tuple[float, float]:
        """The position of a pair of numbers [px]."""
        up = self.y.fraction(y) if self.y else 0.0
        return self.left + (self.right - self.left) * self.x.fraction(x), self.bottom - (self.bottom - TOP) * up

    def path(self, x: Sequence[float], y: Sequence[float]) -> str:
        """A chain of straight lines as path data."""
        places = [self.at(*pair) for pair in zip(x, y, strict=True)]
        return "M" + "L".join(f"{px(u)} {px(v)}" for u, v in places)

    def grid(self) -> str:
        """Horizontal grid lines with their numbers, and the label of the y axis."""
        assert self.y is not None
        marks = []
        for tick in self.y.ticks:
            level = self.at(0, tick)[1]
            marks.append(f'<path class="rule" d="M{px(self.left)} {px(level)}H{px(self.right)}"/>')
            marks.append(written(self.left - 7, level + 4, number(tick), "soft end"))
        middle = (TOP + self.bottom) / 2
        return "".join(
            [*marks, written(11, middle, self.y.label, "soft middle", f' transform="rotate(-90 11 {px(middle)})"')]
        )

    def across(self, ticks: Sequence[tuple[float, str]]) -> str:
        """The x axis with texts at some positions, and its label."""
        marks = [f'<path class="axis" d="M{px(self.left)} {px(self.bottom)}H{px(self.right)}"/>']
        for place, text in ticks:
            u = self.at(place, 0)[0]
            marks.append(
                f'<path class="axis" d="M{px(u)} {px(self.bottom)}v4"/>'
                + written(u, self.bottom + 17, text, "soft middle")
            )
        return "".join([*marks, written((self.left + self.right) / 2, self.bottom + 36, self.x.label, "soft middle")])


def _band(frame: _Frame, line: Line) -> str:
    there, back = frame.path(line.x, line.high), frame.path(line.x[::-1], line.low[::-1])
    points = f"{there} {back}".replace("M", "").replace("L", " ")
    return f'<polygon class="band fill-{line.hue % HUES}" points="{points}"/>'


def _stroke(frame: _Frame, line: Line) -> str:
    """A line; one of few points marks each of them, with its numbers as a tooltip."""
    marks = [f'<path class="line stroke-{line.hue % HUES}"{_dashes(line)} d="{frame.path(line.x, line.y)}"/>']
    for x, y in zip(line.x, line.y, strict=True) if len(line.x) <= MOST_POINTS else ():
        u, v = frame.at(x, y)
        tooltip = f"<title>{escape(f'{line.name}: {x:.3g}, {y:.3g}')}</title>"
        marks.append(f'<circle class="fill-{line.hue % HUES}" cx="{px(u)}" cy="{px(v)}" r="2.6">{tooltip}</circle>')
    return "".join(marks)


def _dashes(line: Line) -> str:
    dash = DASHES[line.dash % len(DASHES)]
    return f' stroke-dasharray="{dash}"' if dash else ""


def _legend(lines: Sequence[Line]) -> tuple[str, int]:
    """Names of the lines below a chart, as many in a row as fit, and the height that they take [px]."""
    marks, u, row = [], float(LEFT), 0
    for line in lines:
        name = cut(line.name, MAX_NAME)
        width = 30 + LETTER * len(name) + 14
        if u > LEFT and u + width > WIDTH:
            u, row = float(LEFT), row + 1
        level = HEIGHT + LEGEND_ROW * row + 6
        marks.append(f'<path class="line stroke-{line.hue % HUES}"{_dashes(line)} d="M{px(u)} {level}h22"/>')
        marks.append(written(u + 29, level + 4, name))
        u += width
    return "".join(marks), LEGEND_ROW * (row + 1) if lines else 0


def _interval(dot: Dot, level: float, position: Callable[[float], float], end: float) -> str:
    """A dot on its whisker; an arrow if the mean lies beyond the end of the scale. position: [px] of a number."""
    if dot.value is None:
        return ""
    if dot.value > end * (1 + 1e-9):
        tip = position(end)
        return f'<path class="whisker stroke-0" d="M{px(tip - 5)} {px(level - 4)}l5 4l-5 4"/>'
    whisker = ""
    if dot.low is not None and dot.high is not None:
        low, high = position(dot.low), position(dot.high)
        ends = f"M{px(low)} {px(level - 3)}v6M{px(high)} {px(level - 3)}v6"
        whisker = f'<path class="whisker stroke-0" d="M{px(low)} {px(level)}H{px(high)}{ends}"/>'
    return f'{whisker}<circle class="fill-0" cx="{px(position(dot.value))}" cy="{px(level)}" r="3.5"/>'


def heading(title: str, note: str) -> str:
    """The title of a chart, and a note at the upper right."""
    return written(4, 16, title, "title") + (written(WIDTH - RIGHT, 16, note, "soft end") if note else "")


def written(x: float, y: float, text: str, kind: str = "", more: str = "") -> str:
    """A text at a place [px]; kind: classes of STYLE."""
    named = f' class="{kind}"' if kind else ""
    return f'<text{named} x="{px(x)}" y="{px(y)}"{more}>{escape(text)}</text>'


def svg(title: str, description: str, height: int, marks: Sequence[str]) -> str:
    """A chart of a height [px]; a screen reader reads title and description."""
    head = f'<svg class="chart" role="img" viewBox="0 0 {WIDTH} {height}">'
    return f"{head}<title>{escape(title)}</title><desc>{escape(description)}</desc>{''.join(marks)}</svg>"


def _height(chart: str) -> int:
    """The height of a chart that `svg` wrote [px]."""
    return int(chart.split('viewBox="', 1)[1].split('"', 1)[0].split()[3])


def _between(low: float | None, high: float | None) -> str:
    return f"{number(low or 0.0)} and more" if high is None else f"{number(low or 0.0)} to {number(high)}"


def cut(text: str, letters: int) -> str:
    """The text, its end replaced by dots when it is longer."""
    return text if len(text) <= letters else text[: letters - 1].rstrip() + "…"


def number(value: float) -> str:
    """A number as text, to six digits."""
    return f"{value:.6g}"


def px(value: float) -> str:
    """A coordinate in a picture, to a hundredth of a pixel."""
    return f"{round(value, 2) + 0.0:.6g}"
