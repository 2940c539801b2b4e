"""Table I: the paper's rows from the start, the others by label, numbers from scores.json; the committed table."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from benchmark.table1 import NOT_YET, PAPER_ROWS, as_html, as_markdown, read_table, sections
from kit1000.errors import InputError
from kit1000.queries.tracks import PAPER_TRACKS, TRACKS
from kit1000.submission.manifest import Manifest, write_manifest
from tests.samples.board import PREDICTIONS

DATASET = "91f0221d05e7d974"
PAPER_LABELS = [row.label for row in PAPER_ROWS.values()]


def mean(value: float) -> dict[str, Any]:
    return {"mean": value, "median": value / 2, "ci95": [value - 1, value + 1]}


def track(position: float | None, rotation: float, **given: Any) -> dict[str, Any]:
    """A track of scores.json, as far as the table reads it; its plain errors are 10 more."""
    positions = {"position_mm": None, "position_plain_mm": None}
    if position is not None:
        positions = {"position_mm": mean(position), "position_plain_mm": mean(position + 10)}
    rotations = {"rotation_deg": mean(rotation), "rotation_plain_deg": mean(rotation + 10)}
    return {"n": 200, "coverage": 1.0, "seated": None, **positions, **rotations, **given}


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
    put(folder, "c", {"snap": track(27, 14)}, GUESS)
    (folder / "unscored").mkdir()
    return folder


def cells(folder: Path, title: str) -> dict[str, dict[str, str]]:
    """The cells of a grid by method and heading."""
    grid = next(section.grid for section in sections(read_table(folder)) if section.title == title)
    return {row[0]: dict(zip(grid.header[1:], row[1:], strict=True)) for row in grid.rows}


def test_the_rows_of_the_paper_are_there_before_anything_is_scored(tmp_path: Path) -> None:
    table = read_table(tmp_path)
    assert [row.label for row in table.rows] == PAPER_LABELS
    assert as_markdown(table).startswith("No submission is scored yet.")
    for section in sections(table):
        assert all(NOT_YET in row for row in section.grid.rows), section.title


def test_other_methods_follow_by_label_and_controls_come_last(submissions: Path) -> None:
    put(submissions, "z", {"snap": track(1, 1)}, {"label": "A control", "control": True})
    put(submissions, "y", {"snap": track(1, 1)}, {"method": "no label"})
    labels = [row.label for row in read_table(submissions).rows]
    others = ["ICP from the guess", "no label", "Registration, from depth"]
    assert labels == [*PAPER_LABELS, *others, "A control", "Initial guess, unchanged"]


def test_a_submission_fills_the_row_that_its_manifest_names(submissions: Path) -> None:
    rows = {row.label: row for row in read_table(submissions).rows}
    assert (rows["SnapNet"].submission, rows["SnapNet"].kind) == ("ours", "paper")
    assert rows["TransporterNet"].submission is None
    assert "My SnapNet" not in rows


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
    found = {name: [*row.values()][::2][:4] for name, row in cells(tmp_path, "As in the paper").items()}
    assert {name: row for name, row in found.items() if row != ["–"] * 4} == {
        "KitNet": ["–", "–", "–", "49.2"],
        "TransporterNet": ["15.3", "18.3", "41.5", "45.1"],
        "SnapNet, partial volumes": ["5.1", "5.7", "49.4", "53.2"],
        "SnapNet": ["3.9", "4.9", "10.8", "29.6"],
        "SnapNet, true volumes": ["3.7", "4.61", "8.1", "28.9"],
    }


def test_our_mean_is_beside_the_papers_number(submissions: Path) -> None:
    row = cells(submissions, "As in the paper")["SnapNet"]
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


def test_a_track_has_plain_means_medians_and_counts(submissions: Path) -> None:
    assert cells(submissions, "place-paper")["SnapNet"] == {
        "n": "200, 98.5 % predicted",
        "mm, paper": "10.8",
        "mm, mean": "9.12 [8.12, 10.12]",
        "mm, plain mean": "19.12",
        "mm, median": "4.56",
        "°, paper": "29.6",
        "°, mean": "20.00 [19.00, 21.00]",
        "°, plain mean": "30.00",
        "°, median": "10.00",
    }


def test_every_track_has_the_numbers_of_that_track(submissions: Path) -> None:
    for i, name in enumerate(TRACKS):
        row = cells(submissions, name)["Registration, from depth"]
        assert (row["mm, median"], row["°, median"]) == (f"{(2 + i) / 2:.2f}", f"{(3 + i) / 2:.2f}")
        assert ("mm, paper" in row) == (name in PAPER_TRACKS.values())


def test_what_is_missing_is_told_apart(submissions: Path) -> None:
    """A missing submission, prediction, measurement and printed number; and no cell has a minus zero."""
    nothing = {"mean": None, "median": None, "ci95": None}
    put(submissions, "none", {"snap": track(1, 1, position_mm=nothing, position_plain_mm=nothing)}, {"label": "None"})
    put(submissions, "zero", {"snap": track(-0.001, 1)}, {"label": "Zero"})
    rotations, snap = cells(submissions, "place-paper")["KitNet"], cells(submissions, "snap")
    assert (rotations["mm, mean"], rotations["°, mean"]) == ("–", "40.00 [39.00, 41.00]")
    assert (snap["SnapNet"]["n"], snap["TransporterNet"]["n"]) == ("–", NOT_YET)
    assert [snap["None"][f"mm, {name}"] for name in ("mean", "plain mean", "median")] == ["–"] * 3
    assert snap["Zero"]["mm, median"] == "0.00"
    overview = cells(submissions, "As in the paper")
    assert [overview["KitNet"][key] for key in ("cameras", "without: mm")] == ["top", "–"]
    assert overview["TransporterNet"]["with: mm"] == NOT_YET
    assert "ICP from the guess" not in overview  # it predicts for neither of the paper's tracks


def test_found_masks_come_before_given_ones_on_noisy_depth_alone(submissions: Path) -> None:
    new = {"protocol": "kit1000-2026-12"}
    for path in submissions.glob("*/scores.json"):
        path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | new), encoding="utf-8")
    both = {name: track(9, 9) for name in ("snap", "snap-d415")}
    put(submissions, "found", both, {"label": "Z, found", "masks": "predicted"}, **new)
    put(submissions, "shapes", both, {"label": "Known", "reads": "shapes"}, **new)
    noisy, ideal = cells(submissions, "snap-d415"), cells(submissions, "snap")
    masks = {name: row["masks"] for name, row in noisy.items() if row["masks"] != "–"}
    assert list(masks.items()) == [("Z, found", "found"), ("Registration, from depth", "given, an ablation")]
    assert [*ideal][len(PAPER_ROWS) :][:3] == ["ICP from the guess", "Registration, from depth", "Z, found"]
    assert "masks" not in ideal["Z, found"]
    assert "Known" not in {**noisy, **ideal}


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
    del incomplete["rotation_plain_deg"]
    put(submissions, "c", {"snap": incomplete}, GUESS)
    with pytest.raises(InputError, match=r"c.scores\.json: .*no rotation_plain_deg of snap"):
        read_table(submissions)
    (submissions / "c" / "scores.json").write_text("[]", encoding="utf-8")
    with pytest.raises(InputError, match="there is no protocol, status"):
        read_table(submissions)


def test_every_markdown_line_of_a_table_has_as_many_cells(submissions: Path) -> None:
    text = as_markdown(read_table(submissions))
    assert text == as_markdown(read_table(submissions))
    for fact in ("kit1000-2026 (draft)", "91f0221d05e7d974", "split test", "position@v1", "rotation@v1"):
        assert fact in text.splitlines()[0]
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert [len(block) for block in blocks[1:]] == [len(PAPER_ROWS) + 3 + 2] * len(TRACKS)
    for block in blocks:
        assert len({line.count("|") for line in block}) == 1


def test_a_label_cannot_break_a_table(submissions: Path) -> None:
    put(submissions, "odd", {"snap": track(1, 1)}, {"label": "a | b <i>"})
    assert "| a \\| b \\<i> |" in as_markdown(read_table(submissions))


class Reader(HTMLParser):
    """Collects the texts of the cells of a page, and checks that every tag is closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("th", "td"):
            self.rows[-1][-1] += data


def test_html_shows_the_same_cells(submissions: Path) -> None:
    put(submissions, "chance", {}, {"label": "<b> & co", "control": True})
    table, page = read_table(submissions), Reader()
    page.feed(as_html(table))
    assert not page.open
    shown = sections(table)
    assert page.rows == [[*row] for section in shown for row in (section.grid.header, *section.grid.rows)]
    controls = sum(section.classes.count("control") for section in shown)
    assert as_html(table).count('<tr class="control">') == controls >= 2 * len(TRACKS)
