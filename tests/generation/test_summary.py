"""The summary: every number of dataset.json agrees with the files that it describes and with a count by hand."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.dataset.reader import Dataset
from kit1000.files import json_bytes, read_json
from kit1000.generation import statistics
from kit1000.generation.croissant import croissant_bytes
from kit1000.generation.dataset_summary import summary_bytes
from kit1000.generation.plan import DATA_VERSION, dataset_id, make_plan
from kit1000.generation.readme import readme_bytes
from kit1000.generation.statistics import add_up, bin_name, part_statistics, scene_statistics
from kit1000.queries.tracks import SPLITS
from tests.samples.cards import PAIRS, tables, truth
from tests.samples.mini import MINI, file_hashes

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=10,
)


@pytest.fixture(scope="module")
def summary(mini: Path) -> dict[str, Any]:
    return read_json(mini / "dataset.json")


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_the_checksum_matches_the_summary_read_back_only(values: dict[str, Any]) -> None:
    data = summary_bytes(values)
    assert summary_bytes(json.loads(data)) == data
    plain = {key: value for key, value in values.items() if key != "checksum"}
    assert json.loads(data) == plain | {"checksum": hashlib.sha256(json_bytes(plain)).hexdigest()}
    assert summary_bytes({**json.loads(data), "more": 1}) != data


def test_id_and_configuration_are_those_of_the_plan(mini: Path, summary: dict[str, Any]) -> None:
    plan = make_plan(MINI, MINI.seed)
    assert read_json(mini / "plan.json") == plan
    assert summary["dataset_id"] == dataset_id(plan)
    assert (summary["seed"], summary["config"], summary["preset"]) == (MINI.seed, MINI.config, "mini")
    assert summary["data_version"] == DATA_VERSION


def test_counts_are_those_of_the_tables_and_the_recordings(mini: Path, summary: dict[str, Any]) -> None:
    for split in SPLITS:
        for table in ("parts", "assemblies"):
            rows = read_json(mini / f"{table}.json").values()
            assert summary["counts"][split][table] == sum(row["split"] == split for row in rows)
        assert summary["counts"][split]["scenes"] == len(list(Dataset(mini).split(split)))


def test_redraws_are_those_of_the_tables(mini: Path, summary: dict[str, Any]) -> None:
    for table in ("parts", "assemblies"):
        rows = read_json(mini / f"{table}.json").values()
        assert summary["redraws"][table] == Counter(reason for row in rows for reason in row["redraws"])
    assert all(count > 0 for count in summary["redraws"]["scenes"].values())


def test_statistics_are_those_of_the_truth_and_the_tables(mini: Path, summary: dict[str, Any]) -> None:
    tables = [read_json(mini / f"{name}.json") for name in ("parts", "kits")]
    for split in SPLITS:
        parts, kits = ([row for row in table.values() if row["split"] == split] for table in tables)
        truths = [scene.truth for scene in Dataset(mini).split(split, truth=True)]
        assert summary["statistics"][split] == add_up([scene_statistics(truths), part_statistics(parts, kits)])


def test_all_files_exist_with_their_hashes(mini: Path, summary: dict[str, Any]) -> None:
    found = file_hashes(mini)
    assert summary["files"] == {name: digest for name, digest in found.items() if name != "dataset.json"}
    assert set(summary["shards"]) == {name for name in found if name.count(".") == 1 and name.endswith(".mcap")}


def test_card_and_croissant_depend_on_the_summary_only(mini: Path, summary: dict[str, Any]) -> None:
    told = {key: value for key, value in summary.items() if key != "checksum"}
    told["files"] = {i: digest for i, digest in summary["files"].items() if i not in ("README.md", "croissant.json")}
    assert (mini / "README.md").read_bytes() == readme_bytes(told)
    assert (mini / "croissant.json").read_bytes() == croissant_bytes(told)


EDGES = [edges for name, edges in vars(statistics).items() if isinstance(edges, tuple) and name.isupper()]


def test_the_statistics_of_a_scene_match_a_count_by_hand() -> None:
    found = scene_statistics([truth()])
    assert found["scenes"] == 1
    assert found["parts"] == 2
    assert found["kits"] == {"2": 1}
    assert found["rest_mode"] == {"tumbled": 1, "upright": 1}
    assert found["tilt_deg"] == {"0-5": 1, "30-45": 1}  # the limit itself counts below
    assert found["visible_percent"] == {"90-100": 2}
    assert found["pixels"] == {"800-1600": 1, "1600-3200": 1}
    assert found["slot_angle_deg"] == {"20-40": 2}
    assert found["slot_visible_percent"] == {"50-75": 2}
    assert found["unseen"] == {"slot seen at a grazing angle": 1}
    assert found["queries"] == {"curves": 1, "place-paper": 1, "snap-tilt": 1}


@given(st.lists(st.floats(0, 0.05), max_size=6), st.integers(0, 6))
def test_statistics_do_not_depend_on_the_distribution_of_scenes(offs: list[float], cut: int) -> None:
    scenes = [truth(off=off) for off in offs]
    whole = scene_statistics(scenes)
    assert add_up([scene_statistics(scenes[cut:]), scene_statistics(scenes[:cut])]) == whole
    assert add_up(scene_statistics([scene]) for scene in reversed(scenes)) == whole
    assert json.loads(json.dumps(whole)) == whole


@given(st.sampled_from(EDGES), st.floats(0, 100))
def test_every_number_has_exactly_one_bin(edges: tuple[int, ...], value: float) -> None:
    name = bin_name(value, edges)
    low, _, high = name.partition("-")
    assert float(low.rstrip("+")) <= value
    assert value < float(high or "inf") or value == edges[-1] == 100


def test_pairs_are_counted_by_family_symmetry_and_keyedness() -> None:
    parts, kits = (list(tables()[name].values()) for name in PAIRS)
    kits[0] = kits[0] | {"keyedness": None}
    kits[1] = kits[1] | {"keyedness": 0.0872664625997}  # 5 degrees, but for the last bits
    found = part_statistics(parts, kits)
    assert found["pairs"] == len(parts)
    assert found["part_family"] == Counter(row["family"] for row in parts)
    assert found["symmetry"] == {"C2": len(parts)}
    assert found["keyedness_deg"] == {"20-30": len(parts) - 2, "any turn seats": 1, "5-10": 1}
    assert part_statistics([], []) == {}
