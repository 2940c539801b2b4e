"""The data card and the Croissant description: valid, complete, and silent about what is withheld."""

from __future__ import annotations

import ast
import json
import re
from itertools import chain
from pathlib import Path
from typing import Any

import mlcroissant
import pytest

from kit1000.dataset.scene_data import SceneTruth
from kit1000.generation.croissant import PUBLISHED, croissant_bytes
from kit1000.generation.readme import (
    BIASES,
    FILES,
    LIMITS,
    READING_EXAMPLE,
    USES,
    citation,
    files_by_pattern,
    readme_bytes,
)
from kit1000.values import Query, View
from tests.samples.cards import summary, tables, withheld


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


def test_the_code_example_uses_existing_names() -> None:
    from kit1000.dataset.reader import Dataset, RecordedScene, Split

    names = {node.attr for node in ast.walk(ast.parse(READING_EXAMPLE)) if isinstance(node, ast.Attribute)}
    there = chain.from_iterable(map(dir, (Dataset, Split, RecordedScene, Query)))
    fields = chain.from_iterable(kind.__dataclass_fields__ for kind in (View, SceneTruth, Query))
    assert names <= {*there, *fields}
    assert len(READING_EXAMPLE.splitlines()) <= 12


pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib.*")  # of the validator's own reader

DATASETS = {"whole": summary, "withheld": withheld}


@pytest.fixture(params=DATASETS, scope="module")
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a description of a dataset, and the tables that it describes."""
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "croissant.json").write_bytes(croissant_bytes(DATASETS[request.param](folder)))
    return folder


@pytest.fixture
def loaded(folder: Path) -> mlcroissant.Dataset:
    return mlcroissant.Dataset(jsonld=str(folder / "croissant.json"))


def described(of: dict[str, Any]) -> dict[str, Any]:
    return json.loads(croissant_bytes(of))


def test_the_validator_finds_no_fault(loaded: mlcroissant.Dataset, caplog: pytest.LogCaptureFixture) -> None:
    issues = loaded.metadata.ctx.issues
    assert not issues.errors
    assert not issues.warnings
    assert not caplog.records
    assert str(loaded.metadata.ctx.conforms_to.value).endswith("croissant/1.1")


def test_tables_load_as_records(loaded: mlcroissant.Dataset) -> None:
    found = [{k.partition("/")[2]: plain(v) for k, v in row.items()} for row in loaded.records("kits")]
    columns = {"part": "part_id", "split": "split", "clearance": "clearance", "depth": "depth"}
    assert found == [{name: row[key] for name, key in columns.items()} for row in tables()["kits"].values()]
    parts = [plain(row["parts/symmetry"]) for row in loaded.records("parts")]
    assert parts == [row["symmetry"]["name"] for row in tables()["parts"].values()]
    assert [plain(row["assemblies/target"]) for row in loaded.records("assemblies")] == list(tables()["assemblies"])


def plain(value: Any) -> Any:
    return value.decode() if isinstance(value, bytes) else value


def test_scenes_load_as_records_that_name_a_listed_file(loaded: mlcroissant.Dataset, folder: Path) -> None:
    rows = [{k.partition("/")[2]: plain(v) for k, v in row.items()} for row in loaded.records("scenes")]
    assert {row["id"]: row["recording"] for row in rows} == {
        scene: shard for shard, scenes in summary()["shards"].items() for scene in scenes
    }
    names = {node["@id"] for node in json.loads((folder / "croissant.json").read_text())["distribution"]}
    assert all(row["recording"] in names for row in rows)
    assert all(row["id"].startswith(row["split"]) for row in rows)


@pytest.mark.parametrize("of", DATASETS.values())
def test_every_file_is_named_with_its_hash_or_by_a_pattern(of) -> None:
    nodes = described(of())["distribution"]
    hashes = {node["contentUrl"]: node["sha256"] for node in nodes if node["@type"] == "cr:FileObject"}
    patterns = {node["includes"] for node in nodes if node["@type"] == "cr:FileSet"}
    for name, digest in of()["files"].items():
        assert hashes.get(name) == digest or (name.endswith(".glb") and name.partition("/")[0] + "/*.glb" in patterns)
    assert hashes.keys() <= of()["files"].keys()


def test_required_properties_and_texts_of_the_card_are_present() -> None:
    text = described(summary())
    required = "@context @type conformsTo name description license url creator datePublished distribution"
    assert all(text.get(key) for key in required.split())
    assert text["license"] == "https://creativecommons.org/licenses/by/4.0/"
    assert text["version"] == summary()["data_version"]
    assert text["datePublished"] == PUBLISHED
    assert text["citeAs"] == citation(summary())
    assert text["url"] == "urn:kit1000:0123456789abcdef"
    assert text["rai:dataLimitations"] == list(LIMITS)
    assert text["rai:dataBiases"] == list(BIASES)
    assert text["rai:dataUseCases"] == list(USES)


def test_a_withheld_split_is_named() -> None:
    assert "withheld" in described(withheld())["description"]
    assert "withheld" not in described(summary())["description"]
