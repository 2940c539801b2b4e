"""Measurements: what is written comes back, estimates agree with other computations, documents hold their tables."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.documents import NOISY, TABLES, filled, run, score_table
from benchmark.entries import read_entries
from benchmark.measurements import SETTING, Column, Measurement, estimate, read_measurement
from benchmark.protocol import ABLATION, FOUND
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from tests.samples.board import SNAPS, write_board, write_scored

ROOT = Path(__file__).resolve().parents[2]
FINITE = st.floats(-1e6, 1e6)


def measured() -> Measurement:
    measurement = Measurement.begin()
    table = measurement.table("errors", "Errors", Column("name", "name"), Column("n", "n"), Column("error", "mm", 2))
    table.add(name="ours", n=3, error=estimate([1.0, 2.0, 3.0]))
    table.add(name="a|b", n=np.int64(4), error=np.float64(0.5))
    table.add(name="none", n=0, error=float("nan"))
    return measurement


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    measured().write(tmp_path / "m.json")
    back = read_measurement(tmp_path / "m.json")
    assert set(back.setting) == set(SETTING)
    assert back.tables["errors"].grid() == measured().tables["errors"].grid()
    back.write(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "m.json").read_bytes()


def test_a_row_of_an_unknown_column_is_refused() -> None:
    with pytest.raises(InputError, match=r"errors.*median"):
        measured().tables["errors"].add(name="ours", median=1.0)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"tables": {}}', '{"tables": 3, "commit": 1}'])
def test_a_file_that_is_no_measurement_is_refused_by_name(text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.json").write_text(text, "utf-8")
    with pytest.raises(InputError, match=r"bad\.json.*--out"):
        read_measurement(tmp_path / "bad.json")


@given(st.lists(FINITE, min_size=1, max_size=30))
def test_an_estimate_holds_mean_and_median_and_an_interval_within_the_values(values: list[float]) -> None:
    found = estimate(values)
    low, high = found["ci95"]
    slack = 1e-9 * max(map(abs, values))
    assert found["n"] == len(values)
    assert found["mean"] == pytest.approx(sum(values) / len(values), abs=1e-6)
    assert min(values) - slack <= low <= high <= max(values) + slack


def test_the_command_names_the_program_and_neither_data_nor_target(mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = ROOT / "bench/quality/segmentation.py"
    monkeypatch.setattr(sys, "argv", [str(program), str(mini), "--scenes", "3", "--out", "/elsewhere/x.json"])
    setting = Measurement.begin(Dataset(mini)).setting
    assert setting["command"] == "python bench/quality/segmentation.py DATA --scenes 3"
    assert setting["dataset_id"] == Dataset(mini).id


def document(folder: Path, text: str) -> Path:
    (folder / "results").mkdir(exist_ok=True)
    measured().write(folder / "results/speed.json")
    (folder / "page.md").write_text(text, "utf-8")
    return folder / "page.md"


BLOCK = "Before.\n\n<!-- result: speed errors -->\nold\n<!-- end -->\n\nAfter.\n"


def test_a_document_is_filled_between_its_marks_and_once_is_enough(tmp_path: Path) -> None:
    page = document(tmp_path, BLOCK)
    assert run([page], tmp_path / "results", ROOT / "submissions") == [page]
    text = page.read_text("utf-8")
    assert text.startswith("Before.\n\n<!-- result: speed errors -->\n")
    assert text.endswith("<!-- end -->\n\nAfter.\n")
    assert "old" not in text
    assert "| ours | 3 | 2.00 [" in text
    assert "| a\\|b | 4 | 0.50 |" in text
    assert "| none | 0 | – |" in text
    assert run([page], tmp_path / "results", ROOT / "submissions") == []


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        ("<!-- result: speed errors -->\n", "page.md.*pair"),
        ("<!-- end -->\n<!-- result: speed errors -->\n", "page.md.*pair"),
        (BLOCK.replace("errors", "sizes"), "page.md.*'sizes'.*errors"),
        (BLOCK.replace("speed errors", "nothing errors"), r"page.md.*nothing\.json"),
        (BLOCK.replace("speed errors", "speed"), "page.md.*table"),
        (BLOCK.replace("speed errors", "submissions seatd"), "page.md.*'seatd'.*seated"),
        (BLOCK.replace("speed errors", "submissions seated registratio"), "page.md.*'registratio'.*registration"),
    ],
)
def test_marks_that_do_not_pair_or_name_nothing_are_refused_and_nothing_is_written(
    text: str, facts: str, tmp_path: Path
) -> None:
    page = document(tmp_path, text)
    with pytest.raises(InputError, match=f"(?s){facts}"):
        run([page], tmp_path / "results", ROOT / "submissions")
    assert page.read_text("utf-8") == text


def test_a_table_of_submissions_shows_what_scores_json_holds(tmp_path: Path) -> None:
    page = document(tmp_path, "<!-- result: submissions seated registration guess -->\n<!-- end -->\n")
    text = filled(page, tmp_path / "results", read_entries(ROOT / "submissions"))
    scores = json.loads((ROOT / "submissions/registration/scores.json").read_text("utf-8"))["tracks"]["snap"]
    row = next(line for line in text.splitlines() if "`registration`" in line)
    assert f"| {100 * scores['seated']['rate']:.1f} [" in row
    assert text.index("`registration`") < text.index("`guess`")


def test_figures_on_noisy_depth_are_first_those_by_found_masks_and_shapes_stand_apart(tmp_path: Path) -> None:
    folder = write_board(tmp_path / "submissions", ("guess", "snaps"))
    for name, kind in (("found", {"masks": "predicted"}), ("shapes", {"reads": "shapes"})):
        write_scored(folder / name, replace(SNAPS, method=name, **kind), 9.0, 9.0, 1.0)
    entries = read_entries(folder)
    rows = {
        name: [row["submission"] for row in score_table(name, entries, []).rows] for name in TABLES if name != "readme"
    }
    assert rows == {"seated": ["`found`", "`guess`", "`snaps`"], "noisy": ["`found`", "`snaps`"], "known": ["`shapes`"]}
    assert [row["masks"] for row in score_table("noisy", entries, []).rows] == [FOUND, ABLATION]
    assert not {column.key for column in score_table("seated", entries, []).columns} & set(NOISY)
