"""The protocol agrees with the code, and the evaluator hash covers exactly the sources that scoring imports."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark import provenance
from benchmark.protocol import CURRENT, FOLDER, protocol_of, read_protocol
from benchmark.provenance import BENCHMARK, LIBRARY, evaluator, evaluator_modules
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


NOT_SCORING = ("pages/board.py", "curve_charts.py", "compare.py", "table1.py", "report.py", "__main__.py")


@pytest.fixture
def tree(tmp_path: Path) -> tuple[Path, Path]:
    """Copies of the two packages."""
    for package in (BENCHMARK, LIBRARY):
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(package, tmp_path / package.name, ignore=ignored)
    return tmp_path / BENCHMARK.name, tmp_path / LIBRARY.name


def hash_of(tree: tuple[Path, Path]) -> str:
    evaluator.cache_clear()
    return evaluator(*tree)


def test_the_same_sources_have_the_same_hash_anywhere(tree: tuple[Path, Path]) -> None:
    assert hash_of(tree) == evaluator()
    assert len(evaluator()) == provenance.DIGITS


def test_a_change_of_any_module_that_scoring_imports_changes_the_hash(
    tree: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes, found = {hash_of(tree)}, evaluator_modules(*tree)
    monkeypatch.setattr(provenance, "evaluator_modules", lambda *_: found)  # the changes add no import
    for path in found.values():
        path.write_text(path.read_text("utf-8") + "# changed\n", "utf-8")
        assert hash_of(tree) not in hashes, path
        hashes.add(hash_of(tree))
    protocol = next(tree[0].glob("protocols/*.json"))
    protocol.write_text(protocol.read_text("utf-8").replace("frozen", "draft"), "utf-8")
    assert hash_of(tree) not in hashes


def test_a_change_of_pages_charts_and_reports_does_not(tree: tuple[Path, Path]) -> None:
    before = hash_of(tree)
    for name in NOT_SCORING:
        path = tree[0] / name
        path.write_text(path.read_text("utf-8") + "# changed\n", "utf-8")
    shutil.rmtree(tree[1] / "generation")
    assert hash_of(tree) == before


def test_the_modules_are_all_that_scoring_loads() -> None:
    command = "import benchmark.score, sys; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", command], capture_output=True, text=True, check=True, cwd=BENCHMARK.parent
    )
    loaded = {name for name in done.stdout.split() if name.partition(".")[0] in ("benchmark", "kit1000")}
    assert loaded <= set(evaluator_modules())


def test_imports_inside_functions_count_and_those_for_type_checkers_do_not(tmp_path: Path) -> None:
    for name, text in {
        "benchmark/__init__.py": "",
        "benchmark/score.py": "from typing import TYPE_CHECKING\n\n\ndef score():\n    from kit1000 import inner\n\n\n"
        "if TYPE_CHECKING:\n    from kit1000 import types_only\n",
        "kit1000/__init__.py": "",
        "kit1000/inner.py": "try:\n    import kit1000.pack.deep\nexcept ImportError:\n    pass\n",
        "kit1000/pack/__init__.py": "",
        "kit1000/pack/deep.py": "",
        "kit1000/types_only.py": "",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, "utf-8")
    assert set(evaluator_modules(tmp_path / "benchmark", tmp_path / "kit1000")) == {
        "benchmark",
        "benchmark.score",
        "kit1000",
        "kit1000.inner",
        "kit1000.pack",
        "kit1000.pack.deep",
    }


def test_the_commit_is_unknown_outside_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "BENCHMARK", tmp_path / "benchmark")
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.commit.__wrapped__() == "unknown"
