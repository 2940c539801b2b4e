"""Plots of a study as SVG: people as lines between conditions, differences with their intervals, outcomes of parts.

The same numbers give the same bytes. See `kit1000.pictures.charts` for the style.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor

from kit1000.pictures.charts import (
    BOTTOM,
    HEIGHT,
    HUES,
    LEFT,
    LEGEND_ROW,
    LETTER,
    RIGHT,
    TOP,
    WIDTH,
    Axis,
    cut,
    heading,
    number,
    px,
    rounded_up,
    svg,
    tick_step,
    written,
)
from kit1000.planner.execute import SEATED

ROW, BAR = 30, 16  # [px] height of a row of differences or of parts, and of its bar
NAMES = 128  # [px] beside rows
ROUNDING = 1e-9  # of a number of steps


@dataclass(frozen=True)
class Column:
    """A condition: what each person has in it, and the mean."""

    name: str
    values: Mapping[str, float]
    """Values by participant."""
    mean: float | None
    low: float | None
    high: float | None
    hue: int = 0


@dataclass(frozen=True)
class Difference:
    """A contrast with its interval."""

    name: str
    mean: float
    low: float
    high: float


def people_plot(title: str, description: str, label: str, columns: Sequence[Column]) -> str:
    """A thin line for each person from condition to condition, and the means with their intervals."""
    every = [value for column in columns for value in column.values.values()]
    highs = [column.high for column in columns if column.high is not None]
    axis = Axis(label, rounded_up(max([*every, *highs, 1e-9])))
    bottom, count = HEIGHT - BOTTOM, len(columns)
    places = [LEFT + (WIDTH - LEFT - RIGHT) * (i + 0.5) / count for i in range(count)]
    marks = [heading(title, f"n = {max(len(column.values) for column in columns)}"), _grid(axis, bottom)]
    people = dict.fromkeys(person for column in columns for person in column.values)
    for person in people:
        known = [
            (u, column.values[person]) for u, column in zip(places, columns, strict=True) if person in column.values
        ]
        path = "L".join(f"{px(u)} {px(_level(axis, bottom, value))}" for u, value in known)
        tooltip = f"<title>{escape(person)}: {', '.join(number(round(value, 2)) for _, value in known)}</title>"
        marks.append(f'<path class="axis" opacity="0.45" d="M{path}">{tooltip}</path>')
    for u, column in zip(places, columns, strict=True):
        marks.append(_mean_mark(axis, bottom, u, column))
        marks += [
            written(u, bottom + 17 + 14 * row, words, "middle")
            for row, words in enumerate(_two_lines(column.name, (WIDTH - LEFT - RIGHT) / count))
        ]
    return svg(title, description, HEIGHT, marks)


def difference_plot(title: str, description: str, label: str, rows: Sequence[Difference]) -> str:
    """Differences with their intervals about zero, one under the other."""
    low, high = min([0.0, *(row.low for row in rows)]), max([0.0, *(row.high for row in rows)])
    step = tick_step(max(high - low, 1e-9))
    first, last = floor(low / step + ROUNDING), ceil(high / step - ROUNDING)
    left, right, bottom = NAMES + 6, WIDTH - RIGHT - 6, TOP + ROW * len(rows)

    def at(value: float) -> float:
        return left + (right - left) * (value - first * step) / max((last - first) * step, 1e-12)

    marks = [heading(title, "")]
    for k in range(first, last + 1):
        kind = "axis" if k == 0 else "rule"
        marks.append(f'<path class="{kind}" d="M{px(at(k * step))} {TOP}V{bottom}"/>')
        marks.append(
            written(at(k * step), bottom + 17, number(round(k * step, 9)).replace("-", "\u2212"), "soft middle")
        )
    for i, row in enumerate(rows):
        level = TOP + ROW * (i + 0.5)
        marks += _row_name(level, row.name)
        ends = f"M{px(at(row.low))} {px(level - 4)}v8M{px(at(row.high))} {px(level - 4)}v8"
        words = f"{row.name}: {number(round(row.mean, 2))} [{number(round(row.low, 2))}, {number(round(row.high, 2))}]"
        marks.append(
            f'<path class="whisker stroke-0" d="M{px(at(row.low))} {px(level)}H{px(at(row.high))}{ends}"/>'
            f'<circle class="fill-0" cx="{px(at(row.mean))}" cy="{px(level)}" r="4">'
            f"<title>{escape(words)}</title></circle>"
        )
    marks.append(written((left + right) / 2, bottom + 36, label, "soft middle"))
    return svg(title, description, bottom + BOTTOM, marks)


def outcome_plot(title: str, description: str, rows: Mapping[str, Mapping[str, int]]) -> str:
    """A bar for each condition: its parts by what became of them, seated ones first, then by frequency."""
    counts: dict[str, int] = {}
    for outcomes in rows.values():
        for outcome, count in outcomes.items():
            counts[outcome] = counts.get(outcome, 0) + count
    names = sorted(counts, key=lambda name: (name != SEATED, -counts[name]))
    left, right, bottom = NAMES + 6, WIDTH - RIGHT, TOP + ROW * len(rows)
    marks = [heading(title, f"{sum(counts.values())} parts")]
    for i, (condition, outcomes) in enumerate(rows.items()):
        level, total, u = TOP + ROW * (i + 0.5), sum(outcomes.values()), float(left)
        marks += _row_name(level, condition)
        for name in names:
            width = (right - left) * outcomes.get(name, 0) / max(total, 1)
            if width:
                place = f'x="{px(u)}" y="{px(level - BAR / 2)}" width="{px(width)}" height="{BAR}"'
                tooltip = f"<title>{escape(f'{condition}, {name}: {outcomes[name]} of {total}')}</title>"
                marks.append(f'<rect class="fill-{names.index(name) % HUES}" {place}>{tooltip}</rect>')
            u += width
    legend, height = _legend(names, bottom + 14)
    return svg(title, description, bottom + 14 + height, [*marks, legend])


def _grid(axis: Axis, bottom: float) -> str:
    marks = []
    for tick in axis.ticks:
        level = _level(axis, bottom, tick)
        marks.append(f'<path class="rule" d="M{LEFT} {px(level)}H{WIDTH - RIGHT}"/>')
        marks.append(written(LEFT - 7, level + 4, number(tick), "soft end"))
    middle = (TOP + bottom) / 2
    return "".join(
        [*marks, written(11, middle, axis.label, "soft middle", f' transform="rotate(-90 11 {px(middle)})"')]
    )


def _level(axis: Axis, bottom: float, value: float) -> float:
    return bottom - (bottom - TOP) * axis.fraction(value)


def _mean_mark(axis: Axis, bottom: float, u: float, column: Column) -> str:
    if column.mean is None:
        return ""
    mark, level = "", _level(axis, bottom, column.mean)
    hue = column.hue % HUES
    if column.low is not None and column.high is not None:
        low, high = _level(axis, bottom, column.low), _level(axis, bottom, column.high)
        ends = f"M{px(u - 5)} {px(low)}h10M{px(u - 5)} {px(high)}h10"
        mark = f'<path class="line stroke-{hue}" d="M{px(u)} {px(low)}V{px(high)}{ends}"/>'
    words = f"<title>{escape(f'{column.name}: mean {column.mean:.2f}')}</title>"
    return f'{mark}<circle class="fill-{hue}" cx="{px(u)}" cy="{px(level)}" r="5">{words}</circle>'


def _row_name(level: float, name: str) -> list[str]:
    """The name beside a row, about a height [px]."""
    lines = _two_lines(name, NAMES)
    return [
        written(NAMES - 4, level + 4 + 13 * (k - (len(lines) - 1) / 2), words, "end") for k, words in enumerate(lines)
    ]


def _two_lines(words: str, width: float) -> list[str]:
    """Words in one or two lines of a width [px], the second cut where it is too long."""
    letters = int(width / LETTER)
    if len(words) <= letters:
        return [words]
    at = words.rfind(" ", 0, letters + 1)
    if at <= 0:
        return [cut(words, letters)]
    return [words[:at], cut(words[at + 1 :], letters)]


def _legend(names: Sequence[str], top: float) -> tuple[str, int]:
    """Squares with names, as many in a row as fit, and the height that they take [px]."""
    marks, u, row = [], 4.0, 0
    for i, name in enumerate(names):
        width = 18 + LETTER * len(name) + 12
        if u > 4 and u + width > WIDTH:
            u, row = 4.0, row + 1
        level = top + LEGEND_ROW * row
        marks.append(f'<rect class="fill-{i % HUES}" x="{px(u)}" y="{px(level)}" width="11" height="11"/>')
        marks.append(written(u + 17, level + 10, name))
        u += width
    return "".join(marks), LEGEND_ROW * (row + 1)
