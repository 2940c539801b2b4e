"""Tests of the data card: it has the statistics of dataset.json, and the same bytes for the same summary."""

from __future__ import annotations

import ast
import json
import re
from itertools import chain

import pytest

from kit1000.dataset.schema import SceneTruth
from kit1000.generation.card import FILES, READING_EXAMPLE, card_bytes, citation, files_by_pattern
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
    return card_bytes(of).decode()


def test_statistics_are_in_tables_by_split() -> None:
    text = card(summary())
    assert table_below(text, "Tilt of the slot [deg]") == [["", "test"], ["0-5", "2 (50.0 %)"], ["30-45", "2 (50.0 %)"]]
    assert table_below(text, "How parts lie")[1:] == [["tumbled", "2 (50.0 %)"], ["upright", "2 (50.0 %)"]]
    assert table_below(text, "Kits in an assembly")[1:] == [["2", "2 (100.0 %)"]]
    assert table_below(text, "Queries by track")[1:] == [["curves", "2"], ["place-paper", "2"], ["snap-tilt", "2"]]
    assert table_below(text, "How far guesses are off, at the pivot")[1:] == [["test", "snap-tilt", "2", "20.0", "5.7"]]
    assert table_below(text, "Keyedness: smallest wrong turn that does not seat [deg]")[1:] == [
        ["20-30", "6 (100.0 %)"]
    ]
    assert table_below(text, "Counts")[1:] == [[split, "2", "2", "2"] for split in ("train", "val", "test")]


def test_redraws_are_listed_by_reason_the_most_frequent_first() -> None:
    text = card(summary())
    assert table_below(text, "Parts")[1:] == [["near-duplicate", "11"], ["loose fit", "3"]]
    assert table_below(text, "Scenes")[1:] == [["parts touch", "2"]]
    assert table_below(text, "Refused scenes")[1:] == [["out of view", "1"]]
    assert "### Assemblies\n\nNone." in text
    assert "3 were, and none is left" in text


def test_held_out_families_are_named_where_they_occur() -> None:
    assert "Families in the test split alone: tee.\n" in card(summary())
    assert "Families in the test split alone: gear, tee.\n" in card(withheld())  # of which no figures are told


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
    assert "| seed |" not in text
    assert "`plan.json`" not in text
    assert "withheld" not in card(summary())


def test_a_dataset_without_statistics_has_a_card() -> None:
    bare = {key: value for key, value in summary().items() if key not in ("statistics", "config", "refused_scenes")}
    text = card(bare | {"statistics": {"train": {}, "val": {}, "test": {}}, "redraws": {}})
    assert "## Figures" not in text
    assert "## How to read it" in text


def test_the_same_summary_gives_the_same_bytes_also_after_json() -> None:
    again = json.loads(json.dumps(summary(), sort_keys=True))
    assert card_bytes(again) == card_bytes(summary())


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
