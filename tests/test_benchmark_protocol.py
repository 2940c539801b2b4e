"""The protocol says what the code does, and a file that says otherwise is refused."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from benchmark.protocol import CURRENT, FOLDER, protocol_of, read_protocol
from kit1000.dataset.reader import WANTED
from kit1000.errors import InputError
from kit1000.generation.plan import dataset_id, make_plan
from kit1000.generation.presets import PRESETS
from kit1000.guesses import MAX_ANGLE, FIXED_LEVELS, LEVELS, MAX_OFFSET
from kit1000.metrics import METRIC_VERSIONS
from kit1000.tracks import TRACKS


def current() -> dict[str, Any]:
    return json.loads((FOLDER / f"{CURRENT}.json").read_text("utf-8"))


def test_the_current_protocol_is_a_draft_until_it_is_frozen() -> None:
    assert read_protocol().name == CURRENT
    assert read_protocol().status == "draft"


def test_tracks_are_those_of_the_dataset() -> None:
    tracks = read_protocol().tracks
    assert {name: row["sensor"] for name, row in tracks.items()} == {
        name: track.sensor for name, track in TRACKS.items()
    }
    for name, row in tracks.items():
        assert (row["guess"] is not None) == (TRACKS[name].guess is not None)
        assert row["split"] == read_protocol().splits[0]


def test_splits_are_those_of_the_reader() -> None:
    protocol = read_protocol()
    assert {*protocol.splits, protocol.curves["split"]} == set(WANTED)


def test_the_dataset_is_the_one_its_preset_makes() -> None:
    stated = read_protocol().dataset
    preset = PRESETS[stated["preset"]]
    assert stated["id"] == dataset_id(make_plan(preset, preset.seed))


def test_curves_are_those_that_the_dataset_asks() -> None:
    curves = read_protocol().curves
    assert (curves["levels"], tuple(curves["fixed_levels"])) == (LEVELS, FIXED_LEVELS)
    assert (curves["most_mm"], curves["most_deg"]) == pytest.approx((MAX_OFFSET * 1e3, np.degrees(MAX_ANGLE)))


def test_metrics_are_measured_in_the_versions_that_it_names() -> None:
    assert read_protocol().metric_versions.items() <= METRIC_VERSIONS.items()


def test_bins_rise() -> None:
    protocol = read_protocol()
    for edges in (*protocol.breakdown.values(), *protocol.histograms.values()):
        assert (np.diff(edges) > 0).all()
    assert all(edges[0] == 0 for edges in protocol.histograms.values())  # nothing falls below the first bin


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"metric_versions": {"mssd": 99}}, "wants mssd version 99; this code has version 1"),
        ({"metric_versions": {"vsd": 1}}, "wants vsd version 1; this code has no such metric"),
        ({"status": "final"}, "status 'final', expected draft or frozen"),
        ({"name": "another"}, "its file calls it 'another'"),
        ({"extra": 1}, "fields missing or too many: extra"),
    ],
)
def test_a_file_at_odds_with_the_code_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        protocol_of(current() | change, CURRENT)


@pytest.mark.parametrize("limit", ["seated_mm", "strict_mm", "near_limit_mm"])
def test_limits_are_those_of_the_metrics(limit: str) -> None:
    row = current()
    row["thresholds"][limit] += 0.5
    with pytest.raises(InputError, match=f"{limit} .*; the code has"):
        protocol_of(row, CURRENT)


def test_an_unknown_protocol_is_answered_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=f"no protocol 'kit1000-1999'; there are {CURRENT}"):
        read_protocol("kit1000-1999")
