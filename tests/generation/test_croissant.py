"""Tests of the Croissant description: the reference validator finds no fault, and its records can be loaded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mlcroissant
import pytest

from kit1000.generation.croissant import PUBLISHED, croissant_bytes
from kit1000.generation.readme import BIASES, LIMITS, USES, citation
from tests.samples.cards import summary, tables, withheld

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


def test_splits_are_of_the_kinds_that_croissant_knows(loaded: mlcroissant.Dataset) -> None:
    kinds = {plain(row["splits/name"]): plain(row["splits/url"]) for row in loaded.records("splits")}
    assert kinds == {"train": "cr:TrainingSplit", "val": "cr:ValidationSplit", "test": "cr:TestSplit"}


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
