"""Tests of the data card: it states counts and redraws of dataset.json, and has the same bytes for the same summary."""

from __future__ import annotations

import ast
import re
from itertools import chain

import pytest

from kit1000.dataset.scene_data import SceneTruth
from kit1000.generation.readme import FILES, READING_EXAMPLE, citation, files_by_pattern, readme_bytes
from kit1000.values import Query, View
from tests.samples.cards import summary, withheld


def table_below(card: str, heading: str) -> list[list[str]]:
    """The rows of the first table below a heading, its head first."""
    below = card.partition(f"# {heading}\n")[2]
    assert below, heading
    rows = re.match(r"[^|#]*((?:\|.*\n)+)", below)
    assert rows, heading
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in rows[1].splitlines()]
    assert len({*map(len, cells)}) == 1
    return [row for i, row in enumerate(cells) if i != 1]


def card(of: dict) -> str:
    return readme_bytes(of).decode()


def test_counts_and_redraws_are_in_tables_the_most_frequent_first() -> None:
    text = card(summary())
    assert table_below(text, "Counts")[1:] == [[split, "2", "2", "2"] for split in ("train", "val", "test")]
    assert "| snap-tilt | 0 | 0 | 2 |\n" in text
    assert table_below(text, "Redraws")[1:] == [
        ["parts", "near-duplicate", "11"],
        ["parts", "loose fit", "3"],
        ["scenes", "parts touch", "2"],
        ["scenes left out", "out of view", "1"],
    ]
    assert "gear, tee" in text


def test_the_head_is_valid_metadata() -> None:
    blank, head, _ = card(summary()).split("---\n", 2)
    fields = dict(line.split(": ") for line in head.splitlines())
    assert blank == ""
    assert fields["pretty_name"] == "KIT1000 tiny"
    assert fields["license"] == "cc-by-4.0"


def test_every_file_is_explained() -> None:
    files = summary()["files"]
    explained = files_by_pattern(summary())
    assert sorted(name for names in explained.values() for name in names) == sorted(files)
    rows = {row[0].strip("`"): int(row[1]) for row in table_below(card(summary()), "Files")[1:]}
    assert rows == {name: len(names) for name, names in explained.items()} | {"dataset.json": 1, "croissant.json": 1}
    assert rows.keys() == FILES.keys()


def test_a_withheld_split_is_named_and_nothing_is_revealed() -> None:
    text = card(withheld())
    assert "The truth of the split `test`, its meshes and the plan are withheld" in text
    assert table_below(text, "Redraws")
    assert "| seed |" not in text
    assert "`plan.json`" not in text
    assert "withheld" not in card(summary())


def test_a_dataset_without_statistics_has_a_card() -> None:
    bare = {key: value for key, value in summary().items() if key not in ("statistics", "config", "refused_scenes")}
    text = card(bare | {"statistics": {"train": {}, "val": {}, "test": {}}, "redraws": {}})
    assert "There were none." in text
    assert "## How to read it" in text


def test_the_citation_names_the_dataset() -> None:
    cited = citation(summary())
    assert "0123456789abcdef" in cited
    assert cited in card(summary())
    assert cited.count("{") == cited.count("}")


def test_the_code_example_uses_existing_names() -> None:
    from kit1000.dataset.reader import Dataset, RecordedScene, Split

    names = {node.attr for node in ast.walk(ast.parse(READING_EXAMPLE)) if isinstance(node, ast.Attribute)}
    there = chain.from_iterable(map(dir, (Dataset, Split, RecordedScene, Query)))
    fields = chain.from_iterable(kind.__dataclass_fields__ for kind in (View, SceneTruth, Query))
    assert names <= {*there, *fields}
    assert len(READING_EXAMPLE.splitlines()) <= 12


@pytest.mark.parametrize("of", [summary, withheld])
def test_a_card_is_plain_markdown(of) -> None:
    text = card(of())
    assert text.endswith("```\n")
    assert "\n\n\n" not in text
    assert text.count("```") % 2 == 0
    assert not re.search(r"\bNone\b(?!\.)|\{|nan", text.partition("## How to read it")[0])
