"""Checks by programs that are not ours find what those object to: programs made here stand in for them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from bench.outside.foreign import Report, run
from bench.outside.slicer import info_fault, slice_fault
from bench.outside.viewers import check_fault, convert_fault, screenshot_fault, topics
from tests.samples.checkout import ROOT

LAYOUT = ROOT / "docs/assets/foxglove-layout.json"


def program(path: Path, text: str = "", status: int = 0, writes: str | None = None) -> Path:
    """A program that prints a text, perhaps writes the file named by its argument after `writes`, and ends."""
    lines = ["#!/bin/sh", f"cat <<'TEXT'\n{text}\nTEXT"]
    if writes is not None:
        lines.append(f'while [ "$1" != {writes} ]; do shift; done; echo ";LAYER_CHANGE" > "$2"')
    path.write_text("\n".join([*lines, f"exit {status}"]) + "\n", encoding="utf-8")
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def recording(mini: Path) -> Path:
    return mini / "test/0000.mcap"


def listed(recording: Path, states: dict[str, str]) -> str:
    """What the check of a viewer prints, with other states than ok for some topics."""
    rows = [f"{states.get(topic, 'ok'):8} 1 6  {topic}  -" for topic in sorted(topics(recording))]
    return "\n".join(["Status  ID  Chunks  Topic  Issues", *rows])


def test_a_good_check_has_no_fault(recording: Path, tmp_path: Path) -> None:
    assert check_fault(program(tmp_path / "viewer", listed(recording, {})), recording, {}) is None


@pytest.mark.parametrize("state", ["warn", "error"])
def test_an_issue_of_a_topic_is_a_fault(recording: Path, tmp_path: Path, state: str) -> None:
    viewer = program(tmp_path / "viewer", listed(recording, {"/tf": state}))
    assert check_fault(viewer, recording, {}) == "/tf: -"


def test_a_topic_that_is_not_listed_is_a_fault(recording: Path, tmp_path: Path) -> None:
    text = "\n".join(line for line in listed(recording, {}).splitlines() if "/query" not in line)
    assert check_fault(program(tmp_path / "viewer", text), recording, {}) == "/query is not listed"


def test_a_check_without_a_table_is_a_fault(recording: Path, tmp_path: Path) -> None:
    fault = check_fault(program(tmp_path / "viewer", "error: damaged", status=1), recording, {})
    assert fault == "exit status 1: error: damaged"


def converted(recording: Path, drop: str = "", more: str = "") -> str:
    return "\n".join(["Entities: {", *(f"    {topic}," for topic in topics(recording) - {drop}), "}", more])


@pytest.mark.parametrize(
    ("drop", "more", "expected"),
    [
        ("", "", None),
        ("/tf", "", "/tf is not converted"),
        ("", "12:00 \x1b[31mERROR\x1b[0m two frames", "12:00 ERROR two frames"),
        ("", "12:00  WARN odd", "12:00  WARN odd"),
    ],
)
def test_a_conversion_is_whole_and_without_complaints(
    recording: Path, tmp_path: Path, drop: str, more: str, expected: str | None
) -> None:
    viewer = program(tmp_path / "viewer", converted(recording, drop, more))
    assert convert_fault(viewer, recording, tmp_path / "out.rrd", {}) == expected


@pytest.mark.parametrize(
    ("text", "status", "writes", "expected"),
    [
        ("INFO fine", 0, "--screenshot-to", None),
        ("ERROR two frames", 0, "--screenshot-to", "ERROR two frames"),
        ("fine", 0, None, "no screenshot: fine"),
        ("no display", 3, "--screenshot-to", "exit status 3: no display"),
    ],
)
def test_an_error_line_of_the_viewer_is_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, status: int, writes: str | None, expected: str | None
) -> None:
    program(tmp_path / "xvfb-run", text, status, writes)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    assert screenshot_fault(Path("rerun"), Path("a.mcap"), tmp_path / "a.png", {}) == expected


INFO = "size_x = 10.000\nsize_y = 20.000\nsize_z = 5.000\nmanifold = yes\nnumber_of_parts =  1"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (INFO, None),
        (INFO.replace("yes", "no"), "manifold = no, number_of_parts = 1, expected yes and 1"),
        (INFO.replace("1\n", "2\n").replace("parts =  1", "parts =  3"), "manifold = yes, number_of_parts = 3"),
        (INFO.replace("20.000", "20.100"), "size [10.  20.1  5. ] mm, expected [10. 20.  5.] mm"),
        (INFO + "\nfacets_reversed = 4", "the slicer repairs it: {'facets_reversed': '4'}"),
        ("cannot read", "exit status 0: cannot read"),
    ],
)
def test_the_slicer_has_to_find_one_body_of_the_right_size(tmp_path: Path, text: str, expected: str | None) -> None:
    slicer = program(tmp_path / "slicer", text)
    fault = info_fault(str(slicer), tmp_path / "a.stl", np.array((10.0, 20.0, 5.0)))
    assert fault == expected if expected is None else str(fault).startswith(expected)


def test_a_sliced_file_has_layers(tmp_path: Path) -> None:
    out = tmp_path / "a.gcode"
    assert slice_fault(str(program(tmp_path / "good", writes="--output")), tmp_path / "a.stl", out) is None
    assert (
        slice_fault(str(program(tmp_path / "bad", "no bed", 134)), tmp_path / "a.stl", out) == "exit status 134: no bed"
    )


def test_a_missing_program_is_named() -> None:
    assert run(["no-such-slicer"]) == (127, "no program no-such-slicer")


def test_a_report_counts_the_failed_checks(capsys: pytest.CaptureFixture[str]) -> None:
    report = Report()
    report.line("a")
    report.line("b", "wrong")
    assert report.failed == 1
    assert capsys.readouterr().out == "ok     a\nFAILED b: wrong\n"


def test_the_layout_shows_topics_that_recordings_have() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    page = ROOT / "docs/reference/recordings.md"
    documented = set(re.findall(r"`(/[a-z0-9/]+)`", page.read_text(encoding="utf-8")))
    panels = layout["configById"]
    modes = [panel["imageMode"] for panel in panels.values() if "imageMode" in panel]
    shown = {*panels["3D!scene"]["topics"], *(mode[key] for mode in modes for key in mode if key.endswith("Topic"))}
    assert shown <= documented
    assert panels["3D!scene"]["followTf"] == "world"
    used = json.dumps([layout["layout"], panels["Tab!images"]])
    assert all(name in used for name in panels)
