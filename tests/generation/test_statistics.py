"""Tests of the statistics: integers in bins that cover all values, independent of the distribution of scenes."""

from __future__ import annotations

import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.generation import statistics
from kit1000.generation.statistics import add_up, bin_name, part_statistics, scene_statistics, track_of
from tests.samples.cards import PAIRS, tables, truth

EDGES = [edges for name, edges in vars(statistics).items() if isinstance(edges, tuple) and name.isupper()]
TREES = st.recursive(
    st.dictionaries(st.sampled_from("abc"), st.integers(0, 9), max_size=3),
    lambda inner: st.dictionaries(st.sampled_from("xyz"), inner, max_size=3),
    max_leaves=8,
)


def leaves(tree: object) -> list[int]:
    return [leaf for value in tree.values() for leaf in leaves(value)] if isinstance(tree, dict) else [tree]  # type: ignore[list-item]


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


@given(st.lists(TREES, max_size=4).filter(lambda trees: len({*map(shape, trees)}) <= 1))
def test_sums_contain_every_count(trees: list[dict]) -> None:
    assert sum(leaves(add_up(trees))) == sum(sum(leaves(tree)) for tree in trees)


def shape(tree: object) -> int:
    return 1 + max(map(shape, tree.values()), default=0) if isinstance(tree, dict) else 0


@given(st.sampled_from(EDGES), st.floats(0, 100))
def test_every_number_has_exactly_one_bin(edges: tuple[int, ...], value: float) -> None:
    name = bin_name(value, edges)
    low, _, high = name.partition("-")
    assert float(low.rstrip("+")) <= value
    assert value < float(high or "inf") or value == edges[-1] == 100


@pytest.mark.parametrize(
    ("query_id", "track"),
    [
        ("test-s0007-p2-snap", "snap"),
        ("val-s0007-p12-snap-tilt", "snap-tilt"),
        ("train-s0000-p0-place-paper", "place-paper"),
        ("curves-s0007-p2-rot3-pos1", "curves"),
    ],
)
def test_a_track_is_read_from_the_id(query_id: str, track: str) -> None:
    assert track_of(query_id) == track


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
