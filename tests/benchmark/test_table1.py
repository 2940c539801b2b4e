"""Table I: the paper's rows from the start, the others by label, numbers from scores.json; the committed table."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from benchmark.table1 import NOT_YET, PAPER_ROWS, as_markdown, read_table
from kit1000.errors import InputError
from kit1000.queries.tracks import TRACKS
from kit1000.submission.manifest import Manifest, write_manifest
from tests.samples.board import PREDICTIONS

DATASET = "91f0221d05e7d974"
PAPER_LABELS = [row.label for row in PAPER_ROWS.values()]


def mean(value: float) -> dict[str, Any]:
    return {"mean": value, "median": value / 2, "ci95": [value - 1, value + 1]}


def track(position: float | None, rotation: float, **given: Any) -> dict[str, Any]:
    """A track of scores.json, as far as the table reads it."""
    errors = {"position_mm": None if position is None else mean(position), "rotation_deg": mean(rotation)}
    return {"n": 200, "coverage": 1.0, "seated": None, **errors, **given}


def put(folder: Path, name: str, tracks: dict[str, Any], manifest: dict[str, Any] | None = None, **scores: Any) -> None:
    """Write the manifest, a predictions file and the scores.json of a submission."""
    defaults: dict[str, Any] = {
        "method": name,
        "authors": ("A. Name",),
        "description": "Made for a test.",
        "date": "2026-01-31",
        "dataset_id": DATASET,
        "tracks": tuple(tracks) or ("snap",),
        "learned": False,
        "uses_true_geometry": False,
    }
    setting = {
        "protocol": "kit1000-2026",
        "status": "draft",
        "metric_versions": {"rotation": 1, "position": 1},
        "dataset_id": DATASET,
        "split": "test",
        "evaluator": "0" * 16,
        "commit": "1" * 40,
    }
    (folder / name).mkdir(parents=True, exist_ok=True)
    described = Manifest(**defaults | (manifest or {}))
    write_manifest(folder / name / "manifest.toml", described)
    (folder / name / "predictions.csv").write_bytes(PREDICTIONS)
    files = {"manifest": asdict(described), "predictions_sha256": hashlib.sha256(PREDICTIONS).hexdigest()}
    content = {
        **setting,
        **files,
        "method": described.method,
        "tracks": tracks,
        "breakdown": {},
        "curves": None,
        "curve_scenes": None,
        **scores,
    }
    (folder / name / "scores.json").write_text(json.dumps(content), encoding="utf-8")


GUESS = {"label": "Initial guess, unchanged", "control": True}


@pytest.fixture
def submissions(tmp_path: Path) -> Path:
    """Two methods of the paper, one of them for rotations alone, two others and a control."""
    folder = tmp_path / "submissions"
    snapnet = {"label": "My SnapNet", "paper_row": "snapnet"}
    put(folder, "ours", {"snap-tilt": track(3.4, 4.0), "place-paper": track(9.123, 20, coverage=0.985)}, snapnet)
    put(folder, "kits", {"place-paper": track(None, 40)}, {"camera_set": "top", "paper_row": "kitnet"})
    every = {name: track(2 + i, 3 + i) for i, name in enumerate(TRACKS)}
    put(folder, "a", every, {"label": "Registration, from depth"})
    put(folder, "b", {"snap": track(1, 1)}, {"label": "ICP from the guess"})
    put(folder, "c", {"snap-tilt": track(27, 14)}, GUESS)
    (folder / "unscored").mkdir()
    return folder


def cells(folder: Path) -> dict[str, dict[str, str]]:
    """The cells by method and heading."""
    grid = read_table(folder).grid
    return {row[0]: dict(zip(grid.header[1:], row[1:], strict=True)) for row in grid.rows}


def test_the_rows_of_the_paper_are_there_before_anything_is_scored(tmp_path: Path) -> None:
    table = read_table(tmp_path)
    assert [row[0] for row in table.grid.rows] == PAPER_LABELS
    assert as_markdown(table).startswith("No submission is scored yet.")
    assert all(NOT_YET in row for row in table.grid.rows)


def test_other_methods_follow_by_label_and_controls_come_last(submissions: Path) -> None:
    put(submissions, "z", {"place-paper": track(1, 1)}, {"label": "A control", "control": True})
    put(submissions, "y", {"snap-tilt": track(1, 1)}, {"method": "no label"})
    put(submissions, "shapes", {"snap-tilt": track(9, 9)}, {"label": "Known", "reads": "shapes"})
    table = read_table(submissions)
    others = ["no label", "Registration, from depth"]  # ICP predicts for neither of the paper's tracks
    controls = ["A control", "Initial guess, unchanged"]
    assert [row[0] for row in table.grid.rows] == [*PAPER_LABELS, *others, *controls]
    assert table.controls == {*controls}


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ({"paper_row": "snapnet"}, "theirs: paper_row 'snapnet' is that of ours too"),
        ({"method": "ours"}, "theirs: method 'ours' is that of ours too"),
        ({"label": "My SnapNet"}, "theirs: label 'My SnapNet' is that of ours too"),
        ({"paper_row": "snapnett"}, "theirs: paper_row 'snapnett': did you mean snapnet.*kitnet"),
    ],
)
def test_two_submissions_for_one_row_or_of_one_name_are_refused(
    submissions: Path, manifest: dict[str, Any], message: str
) -> None:
    put(submissions, "theirs", {}, manifest)
    with pytest.raises(InputError, match=message):
        read_table(submissions)


def test_the_papers_numbers_are_in_their_columns(tmp_path: Path) -> None:
    found = {name: [*row.values()][::2][:4] for name, row in cells(tmp_path).items()}
    assert {name: row for name, row in found.items() if row != ["–"] * 4} == {
        "KitNet": ["–", "–", "–", "49.2"],
        "TransporterNet": ["15.3", "18.3", "41.5", "45.1"],
        "SnapNet, partial volumes": ["5.1", "5.7", "49.4", "53.2"],
        "SnapNet": ["3.9", "4.9", "10.8", "29.6"],
        "SnapNet, true volumes": ["3.7", "4.61", "8.1", "28.9"],
    }


def test_our_mean_is_beside_the_papers_number(submissions: Path) -> None:
    row = cells(submissions)["SnapNet"]
    assert row == {
        "with: mm, paper": "3.9",
        "with: mm": "3.40 [2.40, 4.40]",
        "with: °, paper": "4.9",
        "with: °": "4.00 [3.00, 5.00]",
        "without: mm, paper": "10.8",
        "without: mm": "9.12 [8.12, 10.12]",
        "without: °, paper": "29.6",
        "without: °": "20.00 [19.00, 21.00]",
        "cameras": "primary",
    }


def test_what_is_missing_is_told_apart(submissions: Path) -> None:
    """A missing submission, prediction, measurement and printed number; and no cell has a minus zero."""
    nothing = {"mean": None, "median": None, "ci95": None}
    put(submissions, "none", {"snap-tilt": track(1, 1, position_mm=nothing)}, {"label": "None"})
    put(submissions, "zero", {"snap-tilt": track(-0.001, 1)}, {"label": "Zero"})
    table = cells(submissions)
    assert [table["KitNet"][key] for key in ("without: mm", "without: °", "cameras")] == [
        "–",
        "40.00 [39.00, 41.00]",
        "top",
    ]
    assert "My SnapNet" not in table
    assert table["TransporterNet"]["with: mm"] == NOT_YET
    assert table["None"]["with: mm"] == table["Zero"]["without: mm"] == "–"
    assert table["Zero"]["with: mm"].startswith("0.00 ")


@pytest.mark.parametrize(
    ("key", "value"),
    [("protocol", "other"), ("dataset_id", "other"), ("split", "val"), ("metric_versions", {"position": 2})],
)
def test_scores_of_different_settings_share_no_table(submissions: Path, key: str, value: Any) -> None:
    put(submissions, "c", {}, GUESS, **{key: value})
    with pytest.raises(InputError, match=f"c: .*{key} .*score both"):
        read_table(submissions)


def test_a_file_without_scores_is_refused_by_name(submissions: Path) -> None:
    incomplete = track(1, 1)
    del incomplete["rotation_deg"]
    put(submissions, "c", {"snap-tilt": incomplete}, GUESS)
    with pytest.raises(InputError, match=r"c.scores\.json: .*no rotation_deg of snap-tilt"):
        read_table(submissions)
    (submissions / "c" / "scores.json").write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="there is no protocol, status"):
        read_table(submissions)


def test_every_markdown_line_has_as_many_cells(submissions: Path) -> None:
    put(submissions, "odd", {"snap-tilt": track(1, 1)}, {"label": "a | b <i>"})
    text = as_markdown(read_table(submissions))
    assert text == as_markdown(read_table(submissions))
    for fact in ("kit1000-2026 (draft)", "91f0221d05e7d974", "split test", "position@v1", "rotation@v1"):
        assert fact in text.splitlines()[0]
    assert "| a \\| b \\<i> |" in text
    lines = [line.replace("\\|", "") for line in text.splitlines() if line.startswith("|")]
    assert len(lines) == len(PAPER_ROWS) + 3 + 2
    assert len({line.count("|") for line in lines}) == 1
