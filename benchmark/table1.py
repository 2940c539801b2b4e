"""Table I of the paper, its numbers beside those that the same methods reach here; made from scores.json files alone.

A row is there from the start and stays empty until its submission is scored. The same cells go into Markdown, into the
board's HTML and, unrounded, into JSON.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Any, Literal

from benchmark.report import json_text
from kit1000.errors import InputError
from kit1000.files import read_json, write_bytes

MARK = "<!-- table1 -->"  # stands before and behind the table in a document that it is written into
NOT_YET = "not yet"  # where no submission is scored
NONE = "–"  # where nothing was measured or printed

Pair = tuple[float | None, float | None]
"""Position error in mm and rotation error in degrees, None where the paper prints none."""
NOTHING: Pair = (None, None)


@dataclass(frozen=True)
class Method:
    """A row of the table, before anything is measured."""

    submission: str
    """Name of the folder below submissions/."""
    label: str
    kind: Literal["paper", "here", "control"]
    """A row of the paper's, one that it has not, or a yardstick."""
    guided: Pair = NOTHING
    """What the paper prints with user input."""
    alone: Pair = NOTHING
    """What it prints without."""


METHODS = (  # numbers: Table I of "Scene Editing as Teleoperation", arXiv 2110.04450
    Method("kitnet", "KitNet", "paper", alone=(None, 49.2)),
    Method("transporter6dof", "TransporterNet", "paper", (15.3, 18.3), (41.5, 45.1)),
    Method("snapnet-partialvol", "SnapNet, partial volumes", "paper", (5.1, 5.7), (49.4, 53.2)),
    Method("snapnet", "SnapNet", "paper", (3.9, 4.9), (10.8, 29.6)),
    Method("snapnet-gtvol", "SnapNet, true volumes", "paper", (3.7, 4.61), (8.1, 28.9)),
    Method("snapnet-partialvol-fine", "SnapNet, partial volumes, mean of turns", "here"),
    Method("snapnet-gtvol-fine", "SnapNet, true volumes, mean of turns", "here"),
    Method("snapnet-gtvol-twice", "SnapNet, true volumes, two looks", "here"),
    Method("registration", "Registration, from depth", "here"),
    Method("registration-any-clearance", "Registration, clearance unknown", "here"),
    Method("registration-gtvol", "Registration, true geometry", "here"),
    Method("icp", "ICP from the guess", "here"),
    Method("guess", "The guess, unchanged", "control"),
    Method("chance", "Chance", "control"),
)
PRINTED = {"snap-tilt": "guided", "place-paper": "alone"}
"""The tracks that ask what the paper asks, and the field of a Method that says what it prints there."""
TRACKS = {
    "snap-tilt": "With user input, as in the paper: a guess within 28 mm an axis, tilted by up to 27.5°.",
    "snap": "With user input: the guess is turned by up to 27.5° about any axis.",
    "place-paper": "Without user input, as in the paper: no guess, goals within 15° of roll and pitch.",
    "place": "Without user input: no guess, kits tilted by up to 45°.",
    "snap-d415": "As snap, on the depth of a D415.",
    "place-d415": "As place, on the depth of a D415.",
}
OVERVIEW = "With user input (snap-tilt) and without (place-paper): mean errors, printed in the paper and measured here."
ERRORS = {"position_mm": "mm", "rotation_deg": "°"}
PLAIN = {"position_mm": "position_plain_mm", "rotation_deg": "rotation_plain_deg"}
TOLD = ("n", "coverage", *ERRORS, *PLAIN.values())  # what is read of a track
ALIKE = ("protocol", "status", "metric_versions", "dataset_id", "split")  # scores that differ in one share no table

NOTES = (
    "Numbers of the paper are those of its Table I. It does not say which statistic they are; its code prints mean and "
    "median.",
    "Its millimetres may be voxels: the evaluation in its release prints the position error in voxels of 0.89 mm under "
    "the name of mm. If so, 3.9 are 3.5 mm.",
    "Parts, kits and views are others than the paper's, so its numbers and ours stand side by side and prove nothing "
    "against each other.",
    "Mean and median are of errors against the goal that judges the answer, the one of least MSSD: a turn that changes "
    "nothing costs nothing. Plain errors are against one goal: the one that the guess was drawn around or, without a "
    "guess, the design pose.",
    "[lo, hi] is the 95 % interval of the mean, from a bootstrap over assemblies. A query without an answer counts as "
    "no motion.",
    "True volumes and true geometry are read from the truth: what a method with perfect sight would reach. Guess and "
    "chance are yardsticks.",
)


@dataclass(frozen=True)
class Line:
    """A method with what was measured of it."""

    method: Method
    scored: bool
    """False: not yet."""
    camera_set: str | None
    tracks: dict[str, dict[str, Any]]
    """Of each track it answers: n, coverage, and the errors as scores.json has them."""


@dataclass(frozen=True)
class Table:
    """All methods, and what their scores have in common."""

    stated: dict[str, Any] | None
    """Protocol, its status, metric versions, dataset and split; None while nothing is scored."""
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = NOTES


@dataclass(frozen=True)
class Grid:
    """Cells as text, ready to be drawn."""

    title: str
    about: str
    headings: tuple[str, ...]
    """The first is that of the method."""
    rows: tuple[tuple[str, ...], ...]
    controls: tuple[bool, ...]
    """Which rows are yardsticks."""


def run(submissions: Path, out: Path | None = None) -> None:
    """Print the table as Markdown, or write it.

    Args:
        submissions: folder with one folder a method.
        out: FILE.md, FILE.json or FILE.html. In an .md file that is there, what stands between two marks is replaced.
    """
    table = table_rows(submissions)
    if out is None:
        print(as_markdown(table), end="")
        return
    if out.suffix not in (".md", ".json", ".html"):
        raise InputError(f"--out {out}: expected a name that ends in .md, .json or .html")
    texts = {".json": lambda: json_text(asdict(table)), ".html": lambda: as_html(table)}
    write_bytes(out, texts.get(out.suffix, lambda: _document(out, as_markdown(table)))().encode())


def table_rows(submissions: Path) -> Table:
    """Read what is scored. Raises InputError when there is no such folder, or when two scores share no table."""
    if not submissions.is_dir():
        raise InputError(f"{submissions}: no folder of submissions")
    paths = {method: submissions / method.submission / "scores.json" for method in METHODS}
    found = {method: _scores(path) for method, path in paths.items() if path.is_file()}
    stated = [(paths[method], {key: scores[key] for key in ALIKE}) for method, scores in found.items()]
    for path, theirs in stated[1:]:
        for key, ours in stated[0][1].items():
            if theirs[key] != ours:
                raise InputError(
                    f"{path}: {key} is {theirs[key]}, and {ours} in {stated[0][0]}: score both again, on one dataset"
                )
    lines = tuple(_line(method, found.get(method)) for method in METHODS)
    return Table(stated[0][1] if stated else None, lines)


def _scores(path: Path) -> Mapping[str, Any]:
    """The scores of a file, with all that the table reads."""
    scores = read_json(path)
    missing = [key for key in (*ALIKE, "manifest", "tracks") if not isinstance(scores, dict) or key not in scores]
    if not missing:
        read = ((track, row) for track, row in scores["tracks"].items() if track in TRACKS)
        missing = [f"{key} of {track}" for track, row in read for key in TOLD if key not in row]
    if missing:
        raise InputError(f"{path}: expected scores of `python -m benchmark score`; there is no {', '.join(missing)}")
    return scores


def _line(method: Method, scores: Mapping[str, Any] | None) -> Line:
    if scores is None:
        return Line(method, False, None, {})
    tracks = {track: scores["tracks"][track] for track in TRACKS if track in scores["tracks"]}
    told = {track: {key: row[key] for key in TOLD} for track, row in tracks.items()}
    return Line(method, True, scores["manifest"]["camera_set"], told)


def grids(table: Table) -> tuple[Grid, ...]:
    """The paper's table, then one for each track."""
    return (_overview(table), *(_detail(table, track) for track in TRACKS))


def _overview(table: Table) -> Grid:
    """As in the paper: position and rotation with user input, then without."""
    columns = [(track, error) for track in PRINTED for error in ERRORS]
    names = {"snap-tilt": "with", "place-paper": "without"}
    headings = [f"{names[track]}: {ERRORS[error]}{of}" for track, error in columns for of in (", paper", "")]
    rows = [
        [line.method.label, *(cell for column in columns for cell in _beside(line, *column)), line.camera_set or ""]
        for line in table.lines
    ]
    return _grid("As in the paper", OVERVIEW, ["Method", *headings, "cameras"], rows, table)


def _beside(line: Line, track: str, error: str) -> tuple[str, str]:
    """What the paper prints, and our mean: not yet there, unless it is a number that the paper's own row lacks too."""
    printed = _printed(line, track, error)
    awaited = not line.scored and (line.method.kind != "paper" or printed != NONE)
    return printed, NOT_YET if awaited else _mean(line, track, error)


def _detail(table: Table, track: str) -> Grid:
    """Everything about one track."""
    headings, rows = ["Method", "n"], [[line.method.label, _asked(line, track)] for line in table.lines]
    for error, unit in ERRORS.items():
        columns = {f"{unit}, mean": _mean, f"{unit}, plain mean": _plain, f"{unit}, median": _median}
        if track in PRINTED:
            columns = {f"{unit}, paper": _printed} | columns
        headings += columns
        for row, line in zip(rows, table.lines, strict=True):
            row += [cell(line, track, error) for cell in columns.values()]
    return _grid(track, TRACKS[track], headings, rows, table)


def _grid(title: str, about: str, headings: Sequence[str], rows: Sequence[Sequence[str]], table: Table) -> Grid:
    controls = tuple(line.method.kind == "control" for line in table.lines)
    return Grid(title, about, tuple(headings), tuple(map(tuple, rows)), controls)


def _printed(line: Line, track: str, error: str) -> str:
    """A number of the paper, as it prints it."""
    position, rotation = getattr(line.method, PRINTED[track])
    value = position if error == "position_mm" else rotation
    return NONE if value is None else f"{value:g}"


def _mean(line: Line, track: str, error: str) -> str:
    """Our mean with its interval."""
    stored = line.tracks.get(track, {}).get(error)
    interval = stored and stored["ci95"]
    return _value(stored, "mean") + (f" [{', '.join(map(_number, interval))}]" if interval else "")


def _plain(line: Line, track: str, error: str) -> str:
    return _value(line.tracks.get(track, {}).get(PLAIN[error]), "mean")


def _median(line: Line, track: str, error: str) -> str:
    return _value(line.tracks.get(track, {}).get(error), "median")


def _value(stored: Mapping[str, Any] | None, key: str) -> str:
    return NONE if not stored or stored[key] is None else _number(stored[key])


def _asked(line: Line, track: str) -> str:
    """How many queries, and which share of them was answered where it is not all."""
    row = line.tracks.get(track)
    if row is None:
        return NONE if line.scored else NOT_YET
    return f"{row['n']}" if row["coverage"] == 1 else f"{row['n']}, {100 * row['coverage']:.1f} % answered"


def _number(value: float) -> str:
    """With two decimals, and never minus zero."""
    return f"{round(value, 2) + 0.0:.2f}"


def source(table: Table) -> str:
    """The line that says what the numbers are of."""
    if table.stated is None:
        return "No submission is scored yet."
    stated = table.stated
    versions = ", ".join(f"{name}@v{version}" for name, version in sorted(stated["metric_versions"].items()))
    protocol = f"Protocol {stated['protocol']} ({stated['status']})"
    return f"{protocol}, dataset {stated['dataset_id']}, split {stated['split']}; {versions}."


def as_markdown(table: Table) -> str:
    """The tables with their notes, one line a row."""
    blocks = [source(table)]
    for grid in grids(table):
        blocks += [f"### {grid.title}", grid.about]
        rule = ["---", *["---:"] * (len(grid.headings) - 1)]
        blocks.append("\n".join(f"| {' | '.join(row)} |" for row in (grid.headings, rule, *grid.rows)))
    blocks += ["### Notes", "\n".join(f"- {note}" for note in table.notes)]
    return "\n\n".join(blocks) + "\n"


def as_html(table: Table) -> str:
    """The same as a fragment of a page, headings from h3 down."""
    lines = [f'<p class="about">{escape(source(table))}</p>']
    for grid in grids(table):
        title = escape(grid.title)
        lines += [f"<h3>{title}</h3>", f'<p class="about">{escape(grid.about)}</p>']
        lines += [f'<div class="scroll" role="region" tabindex="0" aria-label="Table I: {title}">', "<table>"]
        lines.append(f"<thead><tr>{_html_cells('th', grid.headings)}</tr></thead>")
        lines += ["<tbody>", *map(_html_row, grid.rows, grid.controls), "</tbody>", "</table>", "</div>"]
    lines += ["<ul>", *(f"<li>{escape(note)}</li>" for note in table.notes), "</ul>"]
    return "\n".join(lines) + "\n"


def _html_row(row: Sequence[str], control: bool) -> str:
    opened = '<tr class="control">' if control else "<tr>"
    return f'{opened}<th scope="row">{escape(row[0])}</th>{_html_cells("td", row[1:])}</tr>'


def _html_cells(tag: Literal["th", "td"], texts: Sequence[str]) -> str:
    """Cells of a head, the first of which is no number, or of a row behind its first."""
    heads = ['<th scope="col">', *['<th scope="col" class="num">'] * (len(texts) - 1)]
    opened = heads if tag == "th" else ['<td class="num">'] * len(texts)
    return "".join(f"{start}{escape(text)}</{tag}>" for start, text in zip(opened, texts, strict=True))


def _document(path: Path, text: str) -> str:
    """The text of a document with the table between two marks; nothing else in it is touched."""
    if not path.exists():
        return f"{MARK}\n\n{text}\n{MARK}\n"
    try:
        around = path.read_text(encoding="utf-8").split(MARK)
    except (OSError, ValueError) as error:
        raise InputError(f"--out {path}: cannot be read ({error})") from error
    if len(around) != 3:
        raise InputError(
            f"--out {path}: expected a new file, or one with {MARK} twice; it is there {len(around) - 1} times"
        )
    return f"{around[0]}{MARK}\n\n{text}\n{MARK}{around[2]}"
