"""Documents with tables of results: the text between two marks is made from results/ and from scored submissions.

A mark names its table: `<!-- result: NAME TABLE -->` that of results/NAME.json; with `submissions` as NAME one of
TABLES below, or Table I. `<!-- end -->` follows the table. Text outside the marks stays as it is.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from benchmark.entries import Entry, read_entries
from benchmark.measurements import Column, Measurement, Table, read_measurement
from benchmark.protocol import ABLATION
from benchmark.quantities import SEATED
from benchmark.table1 import PAPER_ROWS, as_markdown, table_of
from kit1000.errors import InputError, did_you_mean
from kit1000.files import write_bytes
from kit1000.queries.tracks import PAPER_TRACKS, TRACKS

SUBMISSIONS = "submissions"  # the name that stands for scores.json of all of them
BLOCK = re.compile(r"<!-- result: (?P<words>[^>]+?) -->\n(?P<table>.*?)<!-- end -->", re.DOTALL)
MARKED = re.compile(r"<!-- (result:[^>]*|end) -->")
NAMES = (Column("method", "method"), Column("submission", "submission"))
MASKS = Column("masks", "masks")
IDEAL = [name for name, track in TRACKS.items() if track.sensor == "ideal"]
NOISY = [name for name in TRACKS if name not in IDEAL]
WITH_GUESS = PAPER_TRACKS["with user input"]
SHARES: dict[str, tuple[str, Sequence[str], bool]] = {
    "seated": ("Parts seated", IDEAL, False),
    "noisy": ("Parts seated on noisy depth", NOISY, False),
    "known": ("Parts of known shape seated", list(TRACKS), True),
}
"""Tables of parts seated: the title, the tracks, and whether of methods that get the shapes of the scene."""


def run(documents: Iterable[Path], results: Path, submissions: Path) -> list[Path]:
    """Fill the tables of documents; returns those that changed.

    Args:
        documents: Markdown files.
        results: folder of NAME.json files.
        submissions: folder with a folder for each submission.
    """
    entries = read_entries(submissions)
    texts = {path: filled(path, results, entries) for path in documents}
    changed = [path for path, text in texts.items() if text != path.read_text(encoding="utf-8")]
    for path in changed:
        write_bytes(path, texts[path].encode())
    return changed


def filled(path: Path, results: Path, entries: Sequence[Entry]) -> str:
    """The text of a document with all tables as they should be.

    Raises InputError if marks do not pair or name nothing.
    """
    text = path.read_text(encoding="utf-8")
    marks = MARKED.findall(text)
    if any((mark == "end") != bool(number % 2) for number, mark in enumerate(marks)) or len(marks) % 2:
        raise InputError(f"{path}: marks do not pair; each <!-- result: NAME TABLE --> needs its <!-- end -->")

    def replaced(block: re.Match[str]) -> str:
        words = block["words"].split()
        try:
            return f"<!-- result: {' '.join(words)} -->\n\n{_table(words, results, entries)}\n\n<!-- end -->"
        except InputError as error:
            raise InputError(f"{path}: <!-- result: {block['words']} -->: {error}") from error

    return BLOCK.sub(replaced, text)


def _table(words: Sequence[str], results: Path, entries: Sequence[Entry]) -> str:
    if len(words) < 2:
        raise InputError("expected the name of a result and of its table")
    name, table, *others = words
    if name != SUBMISSIONS:
        measurement = read_measurement(results / f"{name}.json")
        if table not in measurement.tables:
            raise InputError(f"{name}.json has no table {table!r}; it has {', '.join(measurement.tables)}")
        return f"{measurement.tables[table].markdown()}\n\n{caption(measurement)}"
    if table == "table1":
        return as_markdown(table_of(entries)).rstrip("\n")
    scored = score_table(table, entries, others)
    if not scored.rows:
        return "No such method is scored yet."
    setting = entries[0].setting
    source = f"*Protocol {setting['protocol']}, dataset {setting['dataset_id']}, split {setting['split']}.*"
    return f"{scored.markdown()}\n\n{source}"


def caption(measurement: Measurement) -> str:
    """Where the numbers come from."""
    setting = measurement.setting
    data = f" on data {setting['data_version']}" if setting["data_version"] else ""
    return f"*Measured {setting['date']}{data} by `{setting['command']}`; {setting['hardware']}.*"


def score_table(name: str, entries: Sequence[Entry], words: Sequence[str]) -> Table:
    """The table `name` of TABLES. words: names of submissions in their order; all without names."""
    if name not in TABLES:
        raise InputError(f"no table {name!r} of submissions; {did_you_mean(name, TABLES)}there are {', '.join(TABLES)}")
    return TABLES[name](entries, list(words))


def share_table(name: str, entries: Sequence[Entry], words: Sequence[str]) -> Table:
    """The table `name` of SHARES: a row for each entry on any of its tracks, those with given masks last.

    Tracks without a row are left out.
    """
    title, tracks, knows_shapes = SHARES[name]
    with_masks = [] if tracks is IDEAL else [MASKS]
    those = [entry for entry in chosen(entries, words) if entry.knows_shapes == knows_shapes]
    masks = {entry.name: next(filter(None, map(entry.masks, tracks)), "") for entry in those}
    scored_tracks = [track for track in tracks if any(track in entry.scores["tracks"] for entry in those)]
    shown = [Column(track, f"`{track}`", 1, True) for track in scored_tracks]
    table = Table(name, f"{title}, in percent, by track", [*NAMES, *with_masks, *shown])
    for entry in sorted(those, key=lambda entry: masks[entry.name] == ABLATION):
        scored = entry.scores["tracks"]
        shares = {track: scored[track][SEATED.key] for track in tracks if track in scored}
        named = _named(entry) | ({"masks": masks[entry.name]} if with_masks else {})
        if shares:
            table.add(**named, **shares)
    return table


def readme(entries: Sequence[Entry], words: Sequence[str]) -> Table:
    """The paper's mean errors with a guess beside ours, and the share of parts seated."""
    heads = [f"{unit}, {of}" for unit in ("mm", "°") for of in ("paper", "here")]
    keys = ("mm_paper", "mm", "deg_paper", "deg")
    numbers = [Column(key, head, 2) for key, head in zip(keys, heads, strict=True)]
    table = Table(
        "readme", "Mean errors with an initial guess", [*NAMES, *numbers, Column("seated", "seated, %", 1, True)]
    )
    for entry in chosen(entries, words):
        row = entry.scores["tracks"][WITH_GUESS]
        paper = PAPER_ROWS.get(entry.manifest.paper_row)
        printed = paper.printed(WITH_GUESS) if paper else (None, None)
        texts = ["–" if value is None else f"{value:g}" for value in printed]
        table.add(
            **_named(entry),
            mm_paper=texts[0],
            mm=row["position_mm"]["mean"],
            deg_paper=texts[1],
            deg=row["rotation_deg"]["mean"],
            seated=row["seated"]["rate"],
        )
    return table


TABLES: dict[str, Callable[[Sequence[Entry], list[str]], Table]] = {
    **{name: partial(share_table, name) for name in SHARES},
    "readme": readme,
}


def chosen(entries: Sequence[Entry], names: Sequence[str]) -> list[Entry]:
    """The entries of these names in their order; all without names. A name ending in * stands for all that begin so."""
    if not names:
        return list(entries)
    by_name = {entry.name: entry for entry in entries}
    found: list[Entry] = []
    for name in names:
        own = [e for key, e in by_name.items() if key == name or (name.endswith("*") and key.startswith(name[:-1]))]
        if not own:
            raise InputError(
                f"no scored submission {name!r}; {did_you_mean(name, by_name)}there are {', '.join(by_name)}"
            )
        found += [entry for entry in own if entry not in found]
    return found


def _named(entry: Entry) -> dict[str, str]:
    return {"method": entry.manifest.display_name, "submission": f"`{entry.name}`"}
