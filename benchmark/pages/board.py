"""The board: for each track a table of all methods, its intervals drawn on one scale a column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmark.pages import numbers
from benchmark.pages.entries import Board, Entry
from benchmark.pages.numbers import Cell, mean_cell, mean_of, median_cell, most_of
from kit1000.tracks import TRACKS

QUICK, SLOW = 1.0, 10.0  # [s] a query: between the classes of runtime
RUNTIMES = {"quick": "up to 1 s", "medium": "1 to 10 s", "slow": "over 10 s", "unknown": "not measured"}

ABOUT = {
    "snap": "Exact depth and a person’s rough guess, wrong by up to 28 mm along each axis and by up to 27.5° about any "
    "axis. All parts are asked about.",
    "snap-tilt": "As snap, but the guess is turned only by a tilt, as in the paper: the left half of its Table I.",
    "place": "Exact depth and no guess. Parts lie upright; their yaw is free, slots are tilted up to 45°.",
    "place-paper": "No guess, and only goals with roll and pitch within ± 15°: the right half of the paper’s Table I.",
    "snap-d415": "The questions of snap, seen with the noise of a consumer depth camera.",
    "place-d415": "The questions of place, seen with the noise of a consumer depth camera.",
}
"""What each track asks."""


@dataclass(frozen=True)
class Column:
    """A column of the board."""

    key: str
    name: str
    detail: str
    tells: str
    """What it means, for a tooltip."""
    first: str = "ascending"
    """How the first click sorts."""


COLUMNS = (
    Column("position", "Position", "mean, mm", "Distance of the part’s centroid from the goal that judges it"),
    Column("position_median", "", "median", "Median position error, mm"),
    Column("rotation", "Rotation", "mean, °", "Angle between predicted and wanted orientation"),
    Column("rotation_median", "", "median", "Median rotation error, degrees"),
    Column("mssd", "MSSD", "mean, mm", "Most that any point of the part misses, symmetry-aware"),
    Column("seated", "Seated", "%", "Share of answers with which the part goes into its slot", "descending"),
    Column("strict", "Strict", "%", "The same within 1 mm in place of 3 mm", "descending"),
    Column("seconds", "Time", "s a query", "Mean time for a query, as its authors measured it"),
    Column(
        "coverage", "Answered", "%", "Share of queries answered; a missing answer counts as no motion", "descending"
    ),
    Column("date", "Date", "", "Of the submission", "descending"),
)
LEADING = "mssd"  # the column that a table is sorted by at first


@dataclass(frozen=True, eq=False)
class Row:
    """A method in the table of a track."""

    entry: Entry
    cells: Mapping[str, Cell]
    runtime: str
    """Its class of runtime, a key of RUNTIMES."""


@dataclass(frozen=True, eq=False)
class TrackTable:
    """The table of a track."""

    name: str
    about: str
    n: int
    """How many queries it asks."""
    rows: tuple[Row, ...]
    ends: Mapping[str, str]
    """Where the scale of a column ends, by its key; written in its head."""


def track_tables(board: Board) -> list[TrackTable]:
    """A table for every track, also for those that nobody has answered yet."""
    known = [*TRACKS, *sorted(set(board.tracks) - set(TRACKS))]
    return [_table(board, track) for track in known]


def runtime_class(seconds: float | None) -> str:
    """The class of a mean time for a query [s]."""
    if seconds is None:
        return "unknown"
    return "quick" if seconds <= QUICK else "medium" if seconds <= SLOW else "slow"


def _table(board: Board, track: str) -> TrackTable:
    entries = [entry for entry in board.entries if track in entry.scores["tracks"]]
    scored = {entry.name: entry.scores["tracks"][track] for entry in entries}
    methods = [scored[entry.name] for entry in entries if not entry.manifest.control] or list(scored.values())
    quantities = {
        "position": numbers.POSITION,
        "rotation": numbers.ROTATION,
        "mssd": numbers.MSSD,
        "seated": numbers.SEATED,
    }
    most = {key: most_of(quantity, methods) for key, quantity in quantities.items()}
    rows = [_row(entry, scored[entry.name], most) for entry in entries]
    rows.sort(key=lambda row: (row.cells[LEADING].value is None, row.cells[LEADING].value or 0.0, row.entry.name))
    ends = {key: f"{end:g}" for key, end in most.items()}
    return TrackTable(
        track, ABOUT.get(track, ""), max((row["n"] for row in scored.values()), default=0), tuple(rows), ends
    )


def _row(entry: Entry, scored: Mapping[str, Any], most: Mapping[str, float]) -> Row:
    seconds, _ = mean_of(numbers.SECONDS, scored)
    date = entry.manifest.date
    cells = {
        "position": mean_cell(numbers.POSITION, scored, most["position"]),
        "position_median": median_cell(numbers.POSITION, scored),
        "rotation": mean_cell(numbers.ROTATION, scored, most["rotation"]),
        "rotation_median": median_cell(numbers.ROTATION, scored),
        "mssd": mean_cell(numbers.MSSD, scored, most["mssd"]),
        "seated": mean_cell(numbers.SEATED, scored, most["seated"]),
        "strict": mean_cell(numbers.STRICT, scored),
        "seconds": mean_cell(numbers.SECONDS, scored),
        "coverage": Cell(numbers.percent(scored["coverage"]).removesuffix(" %"), scored["coverage"]),
        "date": Cell(date, float(date.replace("-", ""))),
    }
    return Row(entry, cells, runtime_class(seconds))
