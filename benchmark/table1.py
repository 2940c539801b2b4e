"""Table I of the paper, its numbers beside those that the same methods reach here; made from submissions alone.

A row of the paper is there from the start, and empty until a submission names it in its manifest; the other submissions
on the paper's tracks follow by label, controls last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.entries import Entry, read_entries
from benchmark.quantities import POSITION, ROTATION, Quantity
from benchmark.report import Grid, versions_text
from kit1000.errors import InputError, did_you_mean
from kit1000.queries.tracks import PAPER_TRACKS

NOT_YET = "not yet"  # if no submission is scored
NO_VALUE = "–"  # if nothing was measured or printed

Pair = tuple[float | None, float | None]
"""Position error in mm and rotation error in degrees, None if the paper prints none."""
NOTHING: Pair = (None, None)


@dataclass(frozen=True)
class PaperRow:
    """A method of the paper's table, with its printed numbers."""

    label: str
    with_input: Pair
    without_input: Pair

    def printed(self, track: str) -> Pair:
        """The numbers of one of PAPER_TRACKS, which are in this order."""
        return dict(zip(PAPER_TRACKS.values(), (self.with_input, self.without_input), strict=True))[track]


PAPER_ROWS = {  # numbers: Table I of "Scene Editing as Teleoperation", arXiv 2110.04450
    "kitnet": PaperRow("KitNet", NOTHING, (None, 49.2)),
    "transporternet": PaperRow("TransporterNet", (15.3, 18.3), (41.5, 45.1)),
    "snapnet-partialvol": PaperRow("SnapNet, partial volumes", (5.1, 5.7), (49.4, 53.2)),
    "snapnet": PaperRow("SnapNet", (3.9, 4.9), (10.8, 29.6)),
    "snapnet-gtvol": PaperRow("SnapNet, true volumes", (3.7, 4.61), (8.1, 28.9)),
}
"""Rows of the paper by key, as `paper_row` of a manifest names it."""
HALVES = " and ".join(f"{half} ({track})" for half, track in PAPER_TRACKS.items())
DESCRIPTION = f"{HALVES.capitalize()}: mean errors, printed in the paper and measured here."
ERRORS = (POSITION, ROTATION)

NOTES = (
    "The paper's numbers are those of its Table I. It does not name their statistic; its code prints mean and median.",
    "The paper's millimetres may be voxels: the evaluation in its release prints the position error in voxels of "
    "0.89 mm, labelled mm. If so, 3.9 are 3.5 mm.",
    "The guesses of snap-tilt are those of the paper's release, rotated by a tilt alone; by its text they are rotated "
    "about any axis.",
    "Parts, kits and views differ from the paper's, so its numbers and ours are not directly comparable.",
    "Errors are to the nearest goal, the one of smallest MSSD: a rotation by a symmetry of the part is no error.",
    "[lo, hi] is the 95 % interval of the mean, from a bootstrap over assemblies and parts. A missing prediction "
    "counts as no motion.",
    "Methods that get the shapes of the scene stand on the leaderboard alone.",
    "Methods with true volumes or true geometry read the ground truth: they show what is possible with perfect "
    "perception. Controls are reference points and no methods.",
)


@dataclass(frozen=True)
class Table:
    """The table as text."""

    source: str
    """Protocol, metric versions, dataset and split of the scores."""
    grid: Grid
    """The rows; the first column holds the method."""
    controls: frozenset[str]
    """Labels of the controls."""


def read_table(submissions: Path) -> Table:
    """The table of a folder of submissions. Raises InputError if two of them cannot share a table."""
    return table_of(read_entries(submissions))


def table_of(entries: Sequence[Entry]) -> Table:
    """The table of scored submissions: the rows of the paper, then other methods by label, then controls by label.

    Methods that get the shapes of the scene are not compared with them, and left out.
    """
    entries = [entry for entry in entries if not entry.knows_shapes]
    for entry in entries:
        _check(entry)
    columns = [(half.split()[0], track, error) for half, track in PAPER_TRACKS.items() for error in ERRORS]
    headings = [f"{half}: {error.unit.symbol}{of}" for half, _, error in columns for of in (", paper", "")]
    reproduced = {entry.manifest.paper_row: entry for entry in entries}
    rows = [_row(row.label, reproduced.get(key), row) for key, row in PAPER_ROWS.items()]
    others = [e for e in entries if not e.manifest.paper_row and set(PAPER_TRACKS.values()) & set(e.scores["tracks"])]
    others.sort(key=lambda entry: (entry.manifest.control, entry.manifest.display_name.casefold()))
    rows += [_row(entry.manifest.display_name, entry, PaperRow("", NOTHING, NOTHING)) for entry in others]
    controls = frozenset(entry.manifest.display_name for entry in others if entry.manifest.control)
    return Table(_source(entries), Grid(["Method", *headings, "cameras"], rows), controls)


def _check(entry: Entry) -> None:
    """Refuse a submission that names no row of the paper, or whose scores lack a key."""
    row = entry.manifest.paper_row
    if row and row not in PAPER_ROWS:
        hint = did_you_mean(row, PAPER_ROWS)
        raise InputError(f"{entry.folder}: paper_row {row!r}: {hint}expected one of {', '.join(PAPER_ROWS)}, or none")
    scored = {track: row for track, row in entry.scores["tracks"].items() if track in PAPER_TRACKS.values()}
    missing = [f"{error.key} of {track}" for track, row in scored.items() for error in ERRORS if error.key not in row]
    if missing:
        path = entry.folder / "scores.json"
        raise InputError(f"{path}: expected scores of `python -m benchmark score`; there is no {', '.join(missing)}")


def _row(label: str, entry: Entry | None, paper: PaperRow) -> list[str]:
    """The cells of a method: for each track and error the paper's number, then our mean; last its cameras."""
    cells = [label]
    for track in PAPER_TRACKS.values():
        for error, printed in zip(ERRORS, paper.printed(track), strict=True):
            cells.append(NO_VALUE if printed is None else f"{printed:g}")
            awaited = entry is None and printed is not None
            cells.append(NOT_YET if awaited else _mean(entry, track, error))
    return [*cells, entry.manifest.camera_set if entry else ""]


def _mean(entry: Entry | None, track: str, error: Quantity) -> str:
    """Our mean with its interval."""
    value, interval = error.estimate(entry.scores["tracks"].get(track, {}) if entry else {})
    if value is None or interval is None:
        return NO_VALUE
    return f"{error.text(value)} [{', '.join(map(error.text, interval))}]"


def _source(entries: Sequence[Entry]) -> str:
    """The line with protocol, dataset and metric versions."""
    if not entries:
        return "No submission is scored yet."
    setting = entries[0].setting
    protocol = f"Protocol {setting['protocol']} ({setting['status']})"
    return f"{protocol}, dataset {setting['dataset_id']}, split {setting['split']}; {versions_text(setting)}."


def as_markdown(table: Table) -> str:
    """The table with its notes; one line per row."""
    notes = "\n".join(f"- {note}" for note in NOTES)
    return "\n\n".join([table.source, DESCRIPTION, table.grid.markdown(), "### Notes", notes]) + "\n"
