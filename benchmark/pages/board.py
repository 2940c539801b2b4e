"""The board: for each track a table of each group of methods, the intervals of a column drawn on one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from markupsafe import Markup

from benchmark import quantities
from benchmark.entries import Entry, read_entries, unscored
from benchmark.protocol import ABLATION
from benchmark.quantities import Quantity
from kit1000.errors import InputError
from kit1000.pictures.charts import Dot, interval_mark, rounded_up
from kit1000.queries.tracks import TRACKS

FAST, SLOW = 1.0, 10.0  # [s] per query: between the classes of runtime
RUNTIMES = {"fast": "up to 1 s", "medium": "1 to 10 s", "slow": "over 10 s", "unknown": "not measured"}
SORTED_BY = quantities.MSSD.key  # the column by which a table is sorted at first
MEDIAN = " median"  # behind the key of a quantity: the column of its median
REAL = "real"  # folder of the submissions about scenes that people recorded and labelled, and the name of their track
GROUPS = {
    "any masks": ("", ""),
    "found": ("Masks found in the image", "Controls and methods with true geometry read no masks."),
    "given": ("Masks given: an ablation", "The masks of the dataset are exact to a pixel; no camera gives them."),
    "shapes": ("Known shapes", "These methods get the meshes of the scene, without poses."),
    "shapes, given": ("Known shapes, masks given: an ablation", "They get exact masks too."),
}
"""Title and description of the tables of a track, in their order."""
REAL_TEXT = "Scenes of real cameras, labelled by people: printed kits, depth as recorded."


@dataclass(frozen=True, eq=False)
class Board:
    """All entries, and the common setting of their scores."""

    entries: tuple[Entry, ...]
    """Entries by name of their folders; never empty."""
    unscored: tuple[str, ...]
    """Names of the submissions without scores."""
    real: tuple[Entry, ...] = ()
    """Entries on real scenes, which have a dataset of their own; their names begin with `real-`."""

    @property
    def setting(self) -> Mapping[str, Any]:
        """Protocol, its status, metric versions, dataset and split of all scores."""
        return self.entries[0].setting

    @property
    def evaluators(self) -> tuple[str, ...]:
        """The evaluators of the scores: one, unless some are older."""
        return tuple(sorted({entry.scores["evaluator"] for entry in self.entries}))

    @property
    def date(self) -> str:
        """Date of the latest submission, YYYY-MM-DD."""
        return max(entry.manifest.date for entry in self.entries)

    @property
    def tracks(self) -> tuple[str, ...]:
        """All tracks, those that are scored and not among TRACKS last."""
        scored = {track for entry in self.entries for track in entry.scores["tracks"]}
        return (*TRACKS, *sorted(scored - set(TRACKS)))


def read_board(submissions: Path) -> Board:
    """The board of a folder of submissions. Raises InputError if none is scored, or if two cannot share a table."""
    entries = read_entries(submissions)
    if not entries:
        raise InputError(f"{submissions}: no scored submission (folders with manifest.toml and scores.json)")
    folder = submissions / REAL  # missing until somebody sends some
    real = (replace(entry, name=f"{REAL}-{entry.name}") for entry in (read_entries(folder) if folder.is_dir() else ()))
    return Board(entries, unscored(submissions), tuple(real))


@dataclass(frozen=True)
class Column:
    """A column of the board."""

    key: str
    name: str
    detail: str
    description: str
    """For a tooltip."""
    first: str = "ascending"
    """Order after the first click."""


def columns() -> tuple[Column, ...]:
    """The columns behind the name of a method."""
    made: list[Column] = []
    for quantity in quantities.shown_in("board"):
        unit = quantity.unit.symbol
        order = "descending" if quantity.higher_is_better else "ascending"
        detail = unit if quantity.rate else f"mean, {unit}"
        made.append(Column(quantity.key, quantity.name, detail, quantity.description, order))
        if "median" in quantity.outputs:
            made.append(Column(quantity.key + MEDIAN, "", "median", f"{quantity.name}, median, {unit}"))
    coverage = "Share of queries with a prediction; a missing one counts as no motion"
    made.append(Column("coverage", "Coverage", "%", coverage, "descending"))
    made.append(Column("date", "Date", "", "Of the submission", "descending"))
    return tuple(made)


@dataclass(frozen=True, eq=False)
class Row:
    """A method in the table of a track."""

    entry: Entry
    cells: Mapping[str, Cell]
    """Cells by key of the column."""
    runtime: str
    """Its class of runtime, a key of RUNTIMES."""


@dataclass(frozen=True, eq=False)
class Group:
    """A table of methods that are compared with each other."""

    title: str
    description: str
    rows: tuple[Row, ...]
    scale_ends: Mapping[str, str]
    """The end of the scale of a column with drawn intervals, by its key; shown in its head."""


@dataclass(frozen=True, eq=False)
class TrackTable:
    """The tables of a track."""

    name: str
    description: str
    n: int
    """Number of queries."""
    groups: tuple[Group, ...]


def track_tables(board: Board) -> list[TrackTable]:
    """A table for every track, also for those without a method."""
    return [*(_table(board.entries, track) for track in board.tracks), *_real_tables(board.real)]


def _real_tables(entries: Sequence[Entry]) -> list[TrackTable]:
    """A table for each track of the real scenes; an empty one if there are none."""
    scored = [track for track in TRACKS if any(track in entry.scores["tracks"] for entry in entries)]
    tables = [_table(entries, track) for track in scored]
    described = [
        replace(table, name=f"{REAL}-{table.name}", description=f"{REAL_TEXT} {table.description}") for table in tables
    ]
    return described or [TrackTable(REAL, f"{REAL_TEXT} None was sent yet.", 0, ())]


def runtime_class(seconds: float | None) -> str:
    """The class of a mean time per query [s]."""
    if seconds is None:
        return "unknown"
    return "fast" if seconds <= FAST else "medium" if seconds <= SLOW else "slow"


def _table(every: Sequence[Entry], track: str) -> TrackTable:
    entries = [entry for entry in every if track in entry.scores["tracks"]]
    of_group = {key: [entry for entry in entries if _group_of(entry, track) == key] for key in GROUPS}
    groups = tuple(_group(own, track, *GROUPS[key]) for key, own in of_group.items() if own)
    description = TRACKS[track].description if track in TRACKS else ""
    n = max((entry.scores["tracks"][track]["n"] for entry in entries), default=0)
    return TrackTable(track, description, n, groups)


def _group_of(entry: Entry, track: str) -> str:
    """The key of its group in GROUPS."""
    masks = entry.masks(track)
    if entry.knows_shapes:
        return "shapes, given" if masks == ABLATION else "shapes"
    return {"": "any masks", ABLATION: "given"}.get(masks, "found")


def _group(entries: Sequence[Entry], track: str, title: str, description: str) -> Group:
    scored = {entry.name: entry.scores["tracks"][track] for entry in entries}
    methods = [scored[entry.name] for entry in entries if not entry.manifest.control] or list(scored.values())
    ends = {quantity.key: scale_end(quantity, methods) for quantity in quantities.shown_in("interval")}
    rows = [_row(entry, scored[entry.name], ends) for entry in entries]
    rows.sort(key=lambda row: (row.cells[SORTED_BY].value is None, row.cells[SORTED_BY].value or 0.0, row.entry.name))
    return Group(title, description, tuple(rows), {key: f"{end:g}" for key, end in ends.items()})


def _row(entry: Entry, scored: Mapping[str, Any], ends: Mapping[str, float]) -> Row:
    cells: dict[str, Cell] = {}
    for quantity in quantities.shown_in("board"):
        cells[quantity.key] = mean_cell(quantity, scored, ends.get(quantity.key))
        if "median" in quantity.outputs:
            cells[quantity.key + MEDIAN] = median_cell(quantity, scored)
    date = entry.manifest.date
    cells["coverage"] = Cell(percent(scored["coverage"]).removesuffix(" %"), scored["coverage"])
    cells["date"] = Cell(date, float(date.replace("-", "")))
    seconds, _ = quantities.SECONDS.estimate(scored)
    return Row(entry, cells, runtime_class(seconds))


NO_VALUE = "–"  # if nothing was measured


@dataclass(frozen=True)
class Cell:
    """A number in a table."""

    text: str
    value: float | None
    """The key it is sorted by; None comes last."""
    mark: Markup | None = None
    """The interval, drawn."""


def mean_cell(quantity: Quantity, row: Mapping[str, Any], scale_end: float | None = None) -> Cell:
    """The mean or rate, its interval drawn from 0 to `scale_end` if given."""
    value, interval = quantity.estimate(row)
    if value is None or interval is None:
        return Cell(NO_VALUE, None)
    text = quantity.text(value)
    if scale_end is None:
        return Cell(text, value)
    (low, high), unit = interval, quantity.unit.suffix
    tooltip = f"{text}{unit}, 95 % interval {quantity.text(low)} to {quantity.text(high)}{unit}"
    return Cell(text, value, Markup(interval_mark(Dot(tooltip, value, low, high), scale_end)))


def median_cell(quantity: Quantity, row: Mapping[str, Any]) -> Cell:
    """The median."""
    value = quantity.median(row)
    return Cell(NO_VALUE, None) if value is None else Cell(quantity.text(value), value)


def scale_end(quantity: Quantity, rows: Sequence[Mapping[str, Any]]) -> float:
    """The end of a common scale of some rows: 100 for rates, else a round number above all intervals."""
    if quantity.rate:
        return 100.0
    highs = [interval[1] for row in rows if (interval := quantity.estimate(row)[1]) is not None]
    return rounded_up(max(highs, default=1.0))


def percent(share: float) -> str:
    """A share as a percentage, without decimals if it is whole."""
    return f"{100 * share:.1f}".removesuffix(".0") + " %"
