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

INVALID = {  # by description: the field, its value, and the code of the fault
    "not a number": ("qw", "nan", "not-a-number"),
    "infinite": ("x", "inf", "not-a-number"),
    "overflow": ("z", "1e999", "not-a-number"),
    "text": ("qx", "abc", "not-a-number"),
    "empty": ("y", "", "not-a-number"),
    "long quaternion": ("qw", "3", "quaternion-norm"),
    "far away": ("x", "1e12", "position-range"),
    "percent": ("confidence", "90", "confidence-range"),
    "unknown confidence": ("confidence", "high", "not-a-number"),
    "negative seconds": ("seconds", "-7", "seconds-range"),
    "no id": ("query_id", "", "invalid-id"),
    "id with a blank": ("query_id", "test s0000", "invalid-id"),
}


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


def check_missing(folder: Path, dataset: Dataset, line: int, code: str) -> None:
    """The prediction for snap counts as no motion, all others are perfect; the check reports an error."""
    errors = check(folder).errors
    assert [(error.line, error.code) for error in errors] == [(line, code)]
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


@pytest.mark.parametrize("case", INVALID)
def test_an_invalid_prediction_counts_as_no_motion(case: str, perfect: Submission, dataset: Dataset) -> None:
    field, value, code = INVALID[case]
    line = line_of_snap(perfect.folder)
    edit(perfect.folder, line, with_field(field, value))
    check_missing(perfect.folder, dataset, line, code)


LINES: dict[str, tuple[Callable[[str], str], str]] = {
    "too short": (lambda line: line.rpartition(",")[0], "fields"),
    "too long": (lambda line: line + ",7", "fields"),
    "a comment": (lambda line: "# " + line, "invalid-id"),
    "a zero quaternion": (
        lambda line: ",".join([line.split(",")[0], "0,0,0,0", *line.split(",")[5:]]),
        "quaternion-norm",
    ),
    "an open quote": (lambda line: '"' + line, "fields"),
    "a control character": (lambda line: line + "\x01", "not-a-number"),
}


@pytest.mark.parametrize("case", LINES)
def test_a_line_that_is_no_prediction_counts_as_no_motion(case: str, perfect: Submission, dataset: Dataset) -> None:
    change, code = LINES[case]
    line = line_of_snap(perfect.folder)
    edit(perfect.folder, line, change)
    check_missing(perfect.folder, dataset, line, code)


def no_header(folder: Path) -> str:
    path = folder / "predictions.csv"
    path.write_text(path.read_text().partition("\n")[2])
    return "insert the header"


def duplicate(folder: Path) -> str:
    path = folder / "predictions.csv"
    path.write_text(path.read_text() + path.read_text().split("\n")[1] + "\n")
    return "one row per query, but line 2 has the same id"


def another_file(folder: Path) -> str:
    (folder / "predictions.csv").write_bytes(b"PK\x03\x04 and so on")
    return "the first line is"


def semicolons(folder: Path) -> str:
    path = folder / "predictions.csv"
    path.write_text(path.read_text().replace(",", ";"))
    return "expected the header"


def unknown_id(folder: Path) -> str:
    edit(folder, 2, with_field("query_id", "test-s7777-p0-snap"))
    return "expected the id of a query of this dataset"


def broken_manifest(folder: Path) -> str:
    path = folder / "manifest.toml"
    path.write_text(path.read_text().replace("learned = false", 'learned = "no"'))
    return "learned = .* expected true or false"


def other_dataset(folder: Path) -> str:
    write_manifest(folder / "manifest.toml", replace(read_submission(folder).manifest, dataset_id="0123456789abcdef"))
    return "dataset_id = .*0123456789abcdef.* expected"


FORM = (no_header, duplicate, another_file, semicolons, unknown_id, broken_manifest, other_dataset)


@pytest.mark.parametrize("spoil", FORM, ids=lambda spoil: spoil.__name__)
def test_a_fault_of_form_stops_the_scoring_by_name(
    spoil: Callable[[Path], str], perfect: Submission, dataset: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    expected = spoil(perfect.folder)
    with pytest.raises(InputError, match=f"mine: .*{expected}"):
        read_checked(perfect.folder, dataset.root, "test")
    assert main(["score", str(perfect.folder), "--data", str(dataset.root), "--no-cache"]) == 2
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
    words = ["score", str(folder), "--data", str(dataset.root), "--no-cache", "--exact", "never"]
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
