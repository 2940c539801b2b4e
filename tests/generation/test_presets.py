"""Tests of presets: a plan gives its preset back, and the sensors follow from the tracks."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.errors import InputError
from kit1000.generation.plan import make_plan
from kit1000.generation.presets import HELD_OUT, IDEAL_TRACKS, LATER_FIELDS, PRESETS, Preset, preset, preset_of
from kit1000.kits.cavity import MIN_WALL
from kit1000.parts.mixtures import MIXTURES
from kit1000.queries.tracks import SPLITS, TRACKS


@pytest.mark.parametrize("name", PRESETS)
def test_a_plan_gives_its_preset_back(name: str) -> None:
    asked = preset(name)
    assert asked.name == name
    found = preset_of(name, json.loads(json.dumps(asked.config)))
    assert replace(found, seed=asked.seed) == asked
    assert found.config == asked.config


def test_a_plan_on_disk_gives_its_preset_back() -> None:
    plan = json.loads(json.dumps(make_plan(preset("tiny"), 5)))
    assert replace(preset_of(plan["preset"], plan["config"]), seed=plan["seed"]) == replace(preset("tiny"), seed=5)


@given(
    st.sets(st.sampled_from(list(TRACKS)), min_size=1),
    st.tuples(st.integers(1, 2), st.integers(2, 5)),
    st.lists(st.floats(1, 45), max_size=3),
    st.booleans(),
)
def test_any_preset_comes_back(tracks: set[str], kits: tuple[int, int], brackets: list[float], level: bool) -> None:
    asked = Preset("any", 3, 1, 2, kits=kits, brackets_deg=tuple(brackets), tracks=tuple(tracks), level_base=level)
    assert preset_of("any", json.loads(json.dumps(asked.config))) == asked


def test_the_config_states_everything_but_name_seed_and_later_fields_at_their_default() -> None:
    assert {*preset("tiny").config, "name", "seed", *LATER_FIELDS} == {field.name for field in fields(Preset)}
    assert {*preset("study").config, "name", "seed"} == {field.name for field in fields(Preset)}
    assert json.loads(json.dumps(preset("study").config)) == preset("study").config


@given(st.sets(st.sampled_from(list(TRACKS))))
def test_sensors_follow_the_tracks(tracks: set[str]) -> None:
    """A noisy sensor is recorded exactly where a track reads it, the ideal image always."""
    for split in SPLITS:
        sensors = Preset("any", 1, 1, 1, tracks=tuple(tracks)).sensors_of(split)
        assert sensors[0] == "ideal"
        assert ("d415" in sensors) == bool(tracks & {"snap-d415", "place-d415"})
        scanned = split != "train" and bool(tracks & {"snap-photoneo", "place-photoneo"})
        assert ("photoneo" in sensors) == scanned
        assert len(set(sensors)) == len(sensors)


def test_every_preset_has_known_tracks() -> None:
    for one in PRESETS.values():
        assert set(one.tracks) <= set(TRACKS)
        assert "snap-tilt" in one.tracks  # contact sheets draw its guesses
        assert {TRACKS[track].sensor for track in one.tracks} == set(one.sensors_of("test"))
    assert not [track for track in IDEAL_TRACKS if TRACKS[track].sensor != "ideal"]


def test_every_preset_can_be_built() -> None:
    for one in PRESETS.values():
        assert one.count("test") >= 1
        assert 0 < one.longest[0] <= one.longest[1] <= 0.1
        assert one.longest[1] / 2 < one.max_part_radius
        assert one.plate >= one.longest[1] + 2 * (one.clearance + MIN_WALL)
        assert one.frames >= 1
        assert 1 <= one.kits[0] <= one.kits[1]
        assert 0 <= one.tilt_deg[0] <= one.tilt_deg[1] < 90
        assert all(one.tilt_deg[0] <= tilt <= one.tilt_deg[1] for tilt in one.brackets_deg)
        assert one.clearance > 0
        assert 0 <= one.crowded <= 1
        assert set(HELD_OUT) < set(MIXTURES[one.mixture])


def test_an_unknown_preset_is_answered_with_the_closest_one() -> None:
    with pytest.raises(InputError, match=r"no preset 'pape'.*did you mean paper\?.*tiny, small, kit1000"):
        preset("pape")
    with pytest.raises(InputError, match=r"no preset 'zzz'; there are tiny"):
        preset("zzz")
