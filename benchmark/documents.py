"""Documents with tables of results: what stands between two marks is made from results/ and from scored submissions.

A mark names its table: `<!-- result: NAME TABLE -->` that of results/NAME.json; with `submissions` as NAME one of
`benchmark.score_tables` or Table I. `<!-- end -->` follows the table. Text outside the marks stays as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmark.entries import Entry, read_entries
from benchmark.measurements import Measurement, Table, read_measurement
from benchmark.score_tables import score_table
from benchmark.table1 import as_markdown, markdown_cell, table_of
from kit1000.errors import InputError
from kit1000.files import write_bytes

SUBMISSIONS = "submissions"  # the name that stands for scores.json of all of them
BLOCK = re.compile(r"<!-- result: (?P<words>[^>]+?) -->\n(?P<table>.*?)<!-- end -->", re.DOTALL)
MARKED = re.compile(r"<!-- (result:[^>]*|end) -->")


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

    Raises InputError where marks do not pair or name nothing.
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
        return f"{as_table(measurement.tables[table])}\n\n{caption(measurement)}"
    if table == "table1":
        return as_markdown(table_of(entries), tracks=False).rstrip("\n")
    return f"{as_table(score_table(table, entries, others))}\n\n{setting_of(entries)}"


def as_table(table: Table) -> str:
    """A table as Markdown, its title in bold above it."""
    rule = ["---" if column.decimals is None and column.key != "n" else "---:" for column in table.columns]
    heads = [column.heading for column in table.columns]
    rows = [[_cell(text) for text in row] for row in table.cells()]
    lines = [f"| {' | '.join(row)} |" for row in (heads, rule, *rows)]
    return "\n".join([f"**{table.title}**", "", *lines])


def setting_of(entries: Sequence[Entry]) -> str:
    """The protocol and the dataset of scores."""
    setting = entries[0].setting
    return f"*Protocol {setting['protocol']}, dataset {setting['dataset_id']}, split {setting['split']}.*"


def caption(measurement: Measurement) -> str:
    """Where the numbers come from."""
    setting = measurement.setting
    data = f" on data {setting['data_version']}" if setting["data_version"] else ""
    return f"*Measured {setting['date']}{data} by `{setting['command']}`; {setting['hardware']}.*"


def _cell(text: str) -> str:
    """Code keeps its backticks; all else is escaped."""
    return text if re.fullmatch(r"`[^`]*`", text) else markdown_cell(text)
