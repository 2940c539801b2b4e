"""Table I of the paper, its numbers beside those that the same methods reach here; made from submissions alone.

A row of the paper is there from the start, and empty until a submission names it in its manifest; the other submissions
follow by label, controls last. The same cells go into Markdown and into the board's HTML.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Literal

from benchmark.entries import Entry, read_entries
from benchmark.protocol import ABLATION
from benchmark.quantities import POSITION, POSITION_PLAIN, ROTATION, ROTATION_PLAIN, Quantity
from benchmark.report import Grid, versions_text
from kit1000.errors import InputError, did_you_mean
from kit1000.queries.tracks import PAPER_TRACKS, TRACKS

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
        return dict(zip(PAPER_TRACKS.values(), (self.with_input, self.without_input), strict=True)).get(track, NOTHING)


PAPER_ROWS = {  # numbers: Table I of "Scene Editing as Teleoperation", arXiv 2110.04450
    "kitnet": PaperRow("KitNet", NOTHING, (None, 49.2)),
    "transporternet": PaperRow("TransporterNet", (15.3, 18.3), (41.5, 45.1)),
    "snapnet-partialvol": PaperRow("SnapNet, partial volumes", (5.1, 5.7), (49.4, 53.2)),
    "snapnet": PaperRow("SnapNet", (3.9, 4.9), (10.8, 29.6)),
    "snapnet-gtvol": PaperRow("SnapNet, true volumes", (3.7, 4.61), (8.1, 28.9)),
}
"""Rows of the paper by key, as `paper_row` of a manifest names it."""
HALVES = " and ".join(f"{half} ({track})" for half, track in PAPER_TRACKS.items())
OVERVIEW = f"{HALVES.capitalize()}: mean errors, printed in the paper and measured here."
PLAIN = {POSITION: POSITION_PLAIN, ROTATION: ROTATION_PLAIN}
"""The errors of the table, and the same to one fixed goal."""
NEEDED = ("n", "coverage", *(quantity.key for pair in PLAIN.items() for quantity in pair))  # keys of a scored track

NOTES = (
    "The paper's numbers are those of its Table I. It does not name their statistic; its code prints mean and median.",
    "The paper's millimetres may be voxels: the evaluation in its release prints the position error in voxels of "
    "0.89 mm, labelled mm. If so, 3.9 are 3.5 mm.",
    "The guesses of snap-tilt are those of the paper's release, rotated by a tilt alone; by its text they are rotated "
    "about any axis.",
    "Parts, kits and views differ from the paper's, so its numbers and ours are not directly comparable.",
    "Mean and median are of errors to the nearest goal, the one of smallest MSSD: a rotation by a symmetry of the part "
    "is no error. Plain errors are to one fixed goal: the one that the guess was drawn around or, without a guess, the "
    "design pose.",
    "[lo, hi] is the 95 % interval of the mean, from a bootstrap over assemblies and parts. A missing prediction "
    "counts as no motion.",
    "On noisy depth rows by given masks are an ablation and come last. Methods that get the shapes of the scene stand "
    "on the leaderboard alone.",
    "Methods with true volumes or true geometry read the ground truth: they show what is possible with perfect "
    "perception. Controls are reference points and no methods.",
)


@dataclass(frozen=True)
class Row:
    """A method with its numbers, printed and measured."""

    label: str
    kind: Literal["paper", "other", "control"]
    """A row of the paper, another method, or a control."""
    submission: str | None
    """Name of its folder; None: not yet there."""
    camera_set: str | None
    printed: dict[str, Pair]
    """The paper's numbers, by track."""
    tracks: dict[str, dict[str, Any]]
    """Values of each scored track: n, coverage, and the errors as in scores.json."""
    masks: dict[str, str]
    """Whose masks they rest on, by noisy track, see `benchmark.protocol.masks_of`."""


@dataclass(frozen=True)
class Table:
    """All rows, and the common setting of their scores."""

    setting: dict[str, Any] | None
    """Protocol, its status, metric versions, dataset and split; None while nothing is scored."""
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = NOTES


@dataclass(frozen=True)
class Section:
    """A table of text cells with its heading; the first column holds the method."""

    title: str
    description: str
    grid: Grid
    classes: tuple[str, ...]
    """Class of each row in HTML: control, or none."""


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
    reproduced = {entry.manifest.paper_row: entry for entry in entries}
    paper = [_row(row.label, "paper", reproduced.get(key), row) for key, row in PAPER_ROWS.items()]
    others = [entry for entry in entries if not entry.manifest.paper_row]
    others.sort(key=lambda entry: (entry.manifest.control, entry.manifest.display_name.casefold()))
    rest = [
        _row(entry.manifest.display_name, "control" if entry.manifest.control else "other", entry) for entry in others
    ]
    return Table(entries[0].setting if entries else None, (*paper, *rest))


def _check(entry: Entry) -> None:
    """Refuse a submission that names no row of the paper, or whose scores lack a key."""
    row = entry.manifest.paper_row
    if row and row not in PAPER_ROWS:
        hint = did_you_mean(row, PAPER_ROWS)
        raise InputError(f"{entry.folder}: paper_row {row!r}: {hint}expected one of {', '.join(PAPER_ROWS)}, or none")
    scored = {track: row for track, row in entry.scores["tracks"].items() if track in TRACKS}
    missing = [f"{key} of {track}" for track, row in scored.items() for key in NEEDED if key not in row]
    if missing:
        path = entry.folder / "scores.json"
        raise InputError(f"{path}: expected scores of `python -m benchmark score`; there is no {', '.join(missing)}")


def _row(
    label: str, kind: Literal["paper", "other", "control"], entry: Entry | None, paper: PaperRow | None = None
) -> Row:
    printed = {track: paper.printed(track) if paper else NOTHING for track in PAPER_TRACKS.values()}
    if entry is None:
        return Row(label, kind, None, None, printed, {}, {})
    scored = entry.scores["tracks"]
    tracks = {track: {key: scored[track][key] for key in NEEDED} for track in TRACKS if track in scored}
    masks = {track: text for track in tracks if (text := entry.masks(track))}
    return Row(label, kind, entry.name, entry.manifest.camera_set, printed, tracks, masks)


def sections(table: Table) -> tuple[Section, ...]:
    """The paper's table, then one for each track."""
    return (_overview(table), *(_detail(table, track) for track in TRACKS))


def _overview(table: Table) -> Section:
    """As in the paper: position and rotation with user input, then without."""
    columns = [(half.split()[0], track, error) for half, track in PAPER_TRACKS.items() for error in PLAIN]
    headings = [f"{half}: {error.unit.symbol}{of}" for half, _, error in columns for of in (", paper", "")]
    shown = [row for row in table.rows if row.kind == "paper" or set(PAPER_TRACKS.values()) & set(row.tracks)]
    rows = [
        [row.label, *(cell for _, track, error in columns for cell in _beside(row, track, error)), row.camera_set or ""]
        for row in shown
    ]
    return _section("As in the paper", OVERVIEW, ["Method", *headings, "cameras"], rows, shown)


def _beside(row: Row, track: str, error: Quantity) -> tuple[str, str]:
    """The paper's number and our mean, which is not yet there if only the paper has a number."""
    printed = _printed(row, track, error)
    awaited = row.submission is None and printed != NO_VALUE
    return printed, NOT_YET if awaited else _mean(row, track, error)


def _detail(table: Table, track: str) -> Section:
    """All numbers of one track."""
    columns: list[tuple[str, Callable[[Row, str, Quantity], str], Quantity]] = []
    for error in PLAIN:
        of = {"mean": _mean, "plain mean": _plain, "median": _median}
        if track in PAPER_TRACKS.values():
            of = {"paper": _printed} | of
        columns += [(f"{error.unit.symbol}, {name}", cell, error) for name, cell in of.items()]
    shown = sorted(table.rows, key=lambda row: row.masks.get(track) == ABLATION)
    noisy = any(track in row.masks for row in shown)
    headings = ["Method", *(["masks"] if noisy else []), "n", *(heading for heading, _, _ in columns)]
    rows = [
        [
            row.label,
            *([row.masks.get(track, NO_VALUE)] if noisy else []),
            _count(row, track),
            *(cell(row, track, error) for _, cell, error in columns),
        ]
        for row in shown
    ]
    return _section(track, TRACKS[track].description, headings, rows, shown)


def _section(
    title: str, description: str, header: Sequence[str], cells: Sequence[Sequence[str]], rows: Sequence[Row]
) -> Section:
    classes = tuple("control" if row.kind == "control" else "" for row in rows)
    return Section(title, description, Grid(header, cells), classes)


def _printed(row: Row, track: str, error: Quantity) -> str:
    """A number of the paper, as it prints it."""
    value = dict(zip(PLAIN, row.printed[track], strict=True))[error]
    return NO_VALUE if value is None else f"{value:g}"


def _mean(row: Row, track: str, error: Quantity) -> str:
    """Our mean with its interval."""
    value, interval = error.estimate(row.tracks.get(track, {}))
    return _number(error, value) + (f" [{', '.join(map(error.text, interval))}]" if interval else "")


def _plain(row: Row, track: str, error: Quantity) -> str:
    value, _ = PLAIN[error].estimate(row.tracks.get(track, {}))
    return _number(error, value)


def _median(row: Row, track: str, error: Quantity) -> str:
    return _number(error, error.median(row.tracks.get(track, {})))


def _number(error: Quantity, value: float | None) -> str:
    return NO_VALUE if value is None else error.text(value)


def _count(row: Row, track: str) -> str:
    """The number of queries, and the share of them with a prediction if not all have one."""
    scored = row.tracks.get(track)
    if scored is None:
        return NOT_YET if row.submission is None else NO_VALUE
    return f"{scored['n']}" if scored["coverage"] == 1 else f"{scored['n']}, {100 * scored['coverage']:.1f} % predicted"


def source(table: Table) -> str:
    """The line with protocol, dataset and metric versions."""
    if table.setting is None:
        return "No submission is scored yet."
    setting = table.setting
    protocol = f"Protocol {setting['protocol']} ({setting['status']})"
    return f"{protocol}, dataset {setting['dataset_id']}, split {setting['split']}; {versions_text(setting)}."


def as_markdown(table: Table, tracks: bool = True) -> str:
    """The paper's table and, with `tracks`, that of each track, with notes; one line per row."""
    blocks = [source(table)]
    for section in sections(table) if tracks else (_overview(table),):
        blocks += [f"### {section.title}", section.description, section.grid.markdown()]
    blocks += ["### Notes", "\n".join(f"- {note}" for note in table.notes)]
    return "\n\n".join(blocks) + "\n"


def as_html(table: Table) -> str:
    """The same as a fragment of a page, headings from h3 down."""
    lines = [f'<p class="about">{escape(source(table))}</p>']
    for section in sections(table):
        lines += [f"<h3>{escape(section.title)}</h3>", f'<p class="about">{escape(section.description)}</p>']
        lines.append(section.grid.html(f"Table I: {section.title}", section.classes))
    lines += ["<ul>", *(f"<li>{escape(note)}</li>" for note in table.notes), "</ul>"]
    return "\n".join(lines) + "\n"
