"""The command line of the benchmark: its files and tables, and one line instead of a traceback for every error."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmark.__main__ import main
from kit1000 import Dataset
from kit1000.queries.tracks import CURVES
from kit1000.submission import Submission, read_submission
from tests.samples.submissions import ground_truth, predicted

MINI_TRACKS = ("snap", "snap-tilt", "snap-d415")  # of the one test scene of MINI


@pytest.fixture(autouse=True)
def _termination() -> Iterator[None]:
    """`main` handles SIGTERM for its process; here that is pytest."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.fixture(scope="module")
def dataset(mini: Path) -> Dataset:
    return Dataset(mini)


@pytest.fixture(scope="module")
def perfect(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Submission:
    folder = tmp_path_factory.mktemp("submissions") / "truth"
    predicted(folder, dataset, ground_truth, tracks=(*MINI_TRACKS, CURVES), control=True)
    return read_submission(folder)


def test_a_file_that_holds_no_scores_stays(
    perfect: Submission, dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(perfect.folder, tmp_path / "mine")
    words = ["score", str(folder), "--data", str(dataset.root), "--exact", "never"]
    for text in ("my notes", "[1]", '{"my": "numbers"}'):
        (folder / "scores.json").write_text(text)
        assert main(words) == 2
        assert "scores.json: exists and holds no scores" in capsys.readouterr().err
        assert (folder / "scores.json").read_text() == text
    (folder / "scores.json").write_text('{"protocol": "of last year"}')
    assert main(words) == 0
    assert "tracks" in json.loads((folder / "scores.json").read_text())


def test_the_command_writes_the_scores_and_a_row_per_query(
    perfect: Submission, dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["score", perfect.folder, "--data", dataset.root, "--breakdown"]
    assert main([*map(str, words), "--out", str(tmp_path / "a.json"), "--per-query", str(tmp_path / "a.csv")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert re.search(r"^snap-tilt +1 +100\.0 +0\.00 \[0\.00, 0\.00\]", out, re.M)
    assert json.loads((tmp_path / "a.json").read_text())["tracks"]["snap"]["n"] == 1
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 + 48
    assert {row["seated"] for row in rows if row["track"] != CURVES} == {"true"}
    assert {row["penetration_mm"] for row in rows if row["track"] == CURVES} == {""}
    assert {path.name for path in perfect.folder.iterdir()} == {"manifest.toml", "predictions.csv"}


WRONG = {  # by what is typed: facts of the answer
    "": "score|rescore|curves|compare|table1|table2|pages|--help",
    "scor": "scor|score",
    "score": "score|SUBMISSION|--data",
    "score {sub}": "score|--data",
    "score {sub} --data {data} --split tets": "--split|tets|test-all",
    "score {sub} --data {data} --workers 0": "--workers: expected 1 or more, got 0",
    "score {sub} --data {tmp}": "{tmp}: no dataset (no dataset.json in it)",
    "score {tmp}/none --data {data}": "{tmp}/none: no folder of a submission",
    "curves --out {tmp}": "SUBMISSIONS",
    "curves {tmp} --out {tmp}/out": "",
    "compare {sub} --data {data}": "compare|B",
    "compare {sub} {sub} --data {data} --tracks snp": "",
    "pages --submissions {tmp} --out {tmp}/out": "{tmp}: no scored submission",
}


@pytest.mark.parametrize("line", WRONG)
def test_wrong_usage_is_reported_in_one_line(
    line: str, perfect: Submission, dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"{tmp}": str(tmp_path), "{data}": str(dataset.root), "{sub}": str(perfect.folder)}
    typed, message = line, WRONG[line]
    for name, path in places.items():
        typed, message = typed.replace(name, path), message.replace(name, path)
    assert main(typed.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("python -m benchmark: ")
    assert all(fact in err for fact in message.split("|"))
    assert err.count("\n") == 1
