"""Tests of a generated dataset, exported and described: other tools agree with `Dataset`."""

from __future__ import annotations

from pathlib import Path

import mlcroissant
import numpy as np
import pytest

from kit1000.dataset.reader import Dataset
from kit1000.export import export
from kit1000.generation.build import generate
from tests.export.test_bop import BopImage, distance_to_model
from tests.samples.mini import MINI, l_shape_sources

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib.*")]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("data")
    generate(MINI, folder / "data", workers=1, sources=l_shape_sources(folder / "files"))
    return Dataset(folder / "data")


@pytest.mark.parametrize("sensor", ["ideal", "d415"])
def test_bop_scenes_match_the_recorded_scenes(dataset: Dataset, sensor: str, tmp_path: Path) -> None:
    export(dataset.root, "bop", tmp_path / "bop", sensor=sensor)
    for split in ("train", "val", "test"):
        for number, recorded in enumerate(dataset.split(split, truth=True)):
            image = BopImage.read(tmp_path / f"bop/{split}/{number:06d}", 0)
            np.testing.assert_allclose(image.depth / 1e3, recorded.view(sensor).depth, atol=5.1e-5)
            for i, row in enumerate(recorded.truth.parts):
                assert distance_to_model(tmp_path / "bop", image, i) < {"ideal": 0.2, "d415": 4}[sensor]
                if sensor == "ideal":
                    assert image.info[i]["px_count_visib"] == pytest.approx(row["pixels"], rel=0.05)
                    assert image.info[i]["visib_fract"] == pytest.approx(row["visible"], abs=0.05)


def test_the_description_of_the_folder_is_valid_and_loads(dataset: Dataset) -> None:
    loaded = mlcroissant.Dataset(jsonld=str(dataset.root / "croissant.json"))
    issues = loaded.metadata.ctx.issues
    assert not issues.errors
    assert not issues.warnings
    assert len(list(loaded.records("kits"))) == len(dataset.geometry.kits)
    scenes = {str(row["scenes/id"]) for row in loaded.records("scenes")}
    assert scenes == {scene for split in ("train", "val", "test") for scene in dataset.split(split).scene_ids}


def test_the_card_counts_match_the_reader(dataset: Dataset) -> None:
    card = (dataset.root / "README.md").read_text()
    _, _, table = card.partition("| queries of track |")
    rows = [line.strip("| ").split(" | ") for line in table.partition("\n\n")[0].splitlines()[2:]]
    asked = {row[0]: int(row[-1]) for row in rows}
    everything = [query.track for query in dataset.split("test-all").queries()]
    assert {track: everything.count(track) for track in set(everything)} == {
        track: n for track, n in asked.items() if track != "curves" and n
    }
