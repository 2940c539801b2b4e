"""The protocol agrees with the code, and a file that differs from it is refused."""

from __future__ import annotations

import hashlib
import json
from typing import Any

import numpy as np
import pytest

from benchmark.protocol import CURRENT, FOLDER, protocol_of, read_protocol
from benchmark.quantities import BEYOND, QUANTITIES, STRICT
from kit1000.dataset.reader import SPLIT_QUERIES
from kit1000.errors import InputError
from kit1000.generation.plan import dataset_id, make_plan
from kit1000.generation.presets import PRESETS
from kit1000.queries.guesses import FIXED_LEVELS, LEVELS, MAX_ANGLE, MAX_OFFSET
from kit1000.queries.tracks import TRACKS


def current() -> dict[str, Any]:
    return json.loads((FOLDER / f"{CURRENT}.json").read_text("utf-8"))


FROZEN = {
    "kit1000-2026": "bd34e5e025f0aa0aeaea2d0e955da20bbad1cad6eabb47ddac58e8eaee8d0c11",
    "kit1000-2026-11": "4c54738a1ae724fa4659c9a4bcc35cf0835f46573d8ecd8c6ce7d7f39e7fcce6",
    "kit1000-2026-12": "0cae8ee328ae78b2912f9dba68ba842d485e328fddeccf00ec4ab4556210ac52",
}
"""SHA-256 of the files of frozen protocols."""


def test_frozen_protocols_never_change() -> None:
    assert read_protocol().name == CURRENT
    for path in FOLDER.glob("*.json"):
        frozen = read_protocol(path.stem).status == "frozen"
        assert frozen == (path.stem in FROZEN)
        assert not frozen or hashlib.sha256(path.read_bytes()).hexdigest() == FROZEN[path.stem], path.name


def test_the_protocol_agrees_with_dataset_metrics_and_descriptions() -> None:
    protocol = read_protocol()
    assert {name: row["sensor"] for name, row in protocol.tracks.items()} == {
        name: track.sensor for name, track in TRACKS.items()
    }
    for name, row in protocol.tracks.items():
        assert (row["guess"] is not None) == (TRACKS[name].guess is not None)
        assert row["split"] == protocol.splits[0]
    assert {*protocol.splits, protocol.curves["split"]} == set(SPLIT_QUERIES)
    preset = PRESETS[protocol.dataset["preset"]]
    assert protocol.dataset["id"] == dataset_id(make_plan(preset, preset.seed))
    curves, limits = protocol.curves, protocol.thresholds
    assert (curves["levels"], tuple(curves["fixed_levels"])) == (LEVELS, FIXED_LEVELS)
    assert (curves["most_mm"], curves["most_deg"]) == pytest.approx((MAX_OFFSET * 1e3, np.degrees(MAX_ANGLE)))
    assert {quantity.metric for quantity in QUANTITIES} - {None} == set(protocol.metric_versions)
    assert f"{limits['beyond_mm']:g} mm or {limits['beyond_deg']:g}°" in BEYOND.description
    assert f"{limits['strict_mm']:g} mm in place of {limits['seated_mm']:g} mm" in STRICT.description
    assert all(
        (np.diff(edges) > 0).all() for bins in (protocol.breakdown, protocol.histograms) for edges in bins.values()
    )
    assert all(edges[0] == 0 for edges in protocol.histograms.values())  # nothing falls below the first bin


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"metric_versions": {"mssd": 99}}, "wants mssd version 99; this code has version 1"),
        ({"metric_versions": {"vsd": 1}}, "wants vsd version 1; this code has no such metric"),
        ({"status": "final"}, "status 'final', expected draft or frozen"),
        ({"name": "another"}, "its file calls it 'another'"),
        ({"extra": 1}, "fields missing or too many: extra"),
    ],
)
def test_a_file_that_differs_from_the_code_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        protocol_of(current() | change, CURRENT)


@pytest.mark.parametrize("limit", ["seated_mm", "strict_mm", "near_limit_mm"])
def test_limits_are_those_of_the_metrics(limit: str) -> None:
    row = current()
    row["thresholds"][limit] += 0.5
    with pytest.raises(InputError, match=f"{limit} .*; the code has"):
        protocol_of(row, CURRENT)


def test_an_unknown_protocol_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=f"no protocol 'kit1000-1999'; there are kit1000-2026, .*{CURRENT}"):
        read_protocol("kit1000-1999")
