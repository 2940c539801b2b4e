"""Invalid predictions count as no motion and are counted; faults of form stop the scoring, by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.__main__ import main
from benchmark.rescore import rescore
from benchmark.score import read_checked, score
from kit1000 import Dataset
from kit1000.errors import InputError
from kit1000.queries.tracks import CURVES
from kit1000.submission import HEADER, Submission, check, read_submission, write_manifest
from tests.samples.submissions import ground_truth, predicted


@pytest.fixture
def dataset(mini: Path) -> Dataset:
    return Dataset(mini)


@pytest.fixture
def perfect(dataset: Dataset, tmp_path: Path) -> Submission:
    return predicted(tmp_path / "mine", dataset, ground_truth, tracks=("snap", "snap-tilt", "snap-d415", CURVES))


def line_of_snap(folder: Path) -> int:
    """The line, from 1, of the only prediction of the track snap."""
    lines = (folder / "predictions.csv").read_text().split("\n")
    return 1 + next(i for i, line in enumerate(lines) if line.partition(",")[0].endswith("-snap"))


def edit(folder: Path, line: int, change: Callable[[str], str]) -> None:
    path = folder / "predictions.csv"
    lines = path.read_text().split("\n")
    lines[line - 1] = change(lines[line - 1])
    path.write_text("\n".join(lines))


def with_field(field: str, value: str) -> Callable[[str], str]:
    def change(line: str) -> str:
        cells = line.split(",")
        cells[HEADER.index(field)] = value
        return ",".join(cells)

    return change


INVALID: dict[str, tuple[Callable[[str], str], str]] = {
    "not a number": (with_field("qw", "nan"), "not-a-number"),
    "overflow": (with_field("z", "1e999"), "not-a-number"),
    "unknown confidence": (with_field("confidence", "high"), "not-a-number"),
    "a control character": (lambda line: line + "\x01", "not-a-number"),
    "long quaternion": (with_field("qw", "3"), "quaternion-norm"),
    "far away": (with_field("x", "1e12"), "position-range"),
    "percent": (with_field("confidence", "90"), "confidence-range"),
    "negative seconds": (with_field("seconds", "-7"), "seconds-range"),
    "no id": (with_field("query_id", ""), "invalid-id"),
    "a comment": (lambda line: "# " + line, "invalid-id"),
    "too short": (lambda line: line.rpartition(",")[0], "fields"),
    "too long": (lambda line: line + ",7", "fields"),
    "an open quote": (lambda line: '"' + line, "fields"),
}


@pytest.mark.parametrize("case", INVALID)
def test_an_invalid_prediction_counts_as_no_motion(case: str, perfect: Submission, dataset: Dataset) -> None:
    change, code = INVALID[case]
    folder, line = perfect.folder, line_of_snap(perfect.folder)
    edit(folder, line, change)
    assert [(error.line, error.code) for error in check(folder).errors] == [(line, code)]
    with pytest.raises(InputError, match=rf"predictions\.csv:{line}:"):
        read_submission(folder)
    submission = read_checked(folder, dataset.root, "test")
    first = submission.invalid.first
    assert first is not None
    assert (submission.invalid.count, first.line, first.code) == (1, line, code)
    tracks = score(submission, dataset, exact="never").summary["tracks"]
    assert (tracks["snap"]["n"], tracks["snap"]["coverage"], tracks["snap"]["seated"]["rate"]) == (1, 0, 0)
    assert tracks["snap"]["position_mm"]["mean"] > 50
    assert (tracks["snap-tilt"]["coverage"], tracks["snap-tilt"]["seated"]["rate"]) == (1, 1)


def replaced(old: str, new: str, name: str = "predictions.csv") -> Callable[[Path], object]:
    """Replaces a text in a file of a folder."""
    return lambda folder: (folder / name).write_text((folder / name).read_text().replace(old, new))


def duplicate(folder: Path) -> None:
    path = folder / "predictions.csv"
    path.write_text(path.read_text() + path.read_text().split("\n")[1] + "\n")


def other_dataset(folder: Path) -> None:
    write_manifest(folder / "manifest.toml", replace(read_submission(folder).manifest, dataset_id="0123456789abcdef"))


FORM: dict[str, tuple[Callable[[Path], object], str]] = {
    "no header": (replaced(",".join(HEADER) + "\n", ""), "query_id,qw,qx,qy,qz"),
    "a duplicate": (duplicate, "line 2 has the same id"),
    "another file": (lambda folder: (folder / "predictions.csv").write_bytes(b"PK\x03\x04"), "query_id,qw,qx,qy,qz"),
    "semicolons": (replaced(",", ";"), "query_id,qw,qx,qy,qz"),
    "an unknown id": (
        lambda folder: edit(folder, 2, with_field("query_id", "test-s7777-p0-snap")),
        "test-s7777-p0-snap",
    ),
    "a broken manifest": (replaced("learned = false", 'learned = "no"', "manifest.toml"), "learned = .*true or false"),
    "another dataset": (other_dataset, "dataset_id = .*0123456789abcdef"),
}


@pytest.mark.parametrize("case", FORM)
def test_a_fault_of_form_stops_the_scoring_by_name(
    case: str, perfect: Submission, dataset: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, expected = FORM[case]
    spoil(perfect.folder)
    with pytest.raises(InputError, match=f"mine: .*{expected}"):
        read_checked(perfect.folder, dataset.root, "test")
    assert main(["score", str(perfect.folder), "--data", str(dataset.root)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert not (perfect.folder / "scores.json").exists()


def test_a_file_of_invalid_rows_alone_is_not_scored(perfect: Submission, dataset: Dataset) -> None:
    path = perfect.folder / "predictions.csv"
    head, *rows, _ = path.read_text().split("\n")
    path.write_text("\n".join([head, *(with_field("qw", "nan")(row) for row in rows), ""]))
    with pytest.raises(InputError, match=r"no row is.* valid.*predictions\.csv:2:"):
        read_checked(perfect.folder, dataset.root, "test")


def test_the_command_says_how_many_rows_are_invalid_and_shows_the_coverage(
    perfect: Submission, dataset: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, line = perfect.folder, line_of_snap(perfect.folder)
    edit(folder, line, with_field("qw", "nan"))
    edit(folder, line + 1, with_field("confidence", "2"))
    words = ["score", str(folder), "--data", str(dataset.root), "--exact", "never"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    begins = f"python -m benchmark: {folder}: 2 rows are no valid predictions; their queries count as no motion;"
    assert err.startswith(f"{begins} the first: {folder}/predictions.csv:{line}:")
    assert err.count("\n") == 1
    assert any(row.split()[:3] == ["snap", "1", "0.0"] for row in out.split("\n"))
    written: dict[str, Any] = json.loads((folder / "scores.json").read_text())
    assert written["tracks"]["snap"]["coverage"] == 0
    ((_, differences),) = rescore([folder], dataset.root)
    assert differences == []
