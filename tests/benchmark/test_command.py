"""The command line of the benchmark: its files and tables, and one line instead of a traceback for every error."""

from __future__ import annotations

import csv
import json
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
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
    words = ["score", str(folder), "--data", str(dataset.root), "--no-cache", "--exact", "never"]
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
    words = ["score", perfect.folder, "--data", dataset.root, "--cache", tmp_path / "cache", "--breakdown"]
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
    "score {sub} --data {data} --cache {tmp} --no-cache": "--cache and --no-cache: give one of them",
    "score {sub} --data {tmp}": "{tmp}: no dataset (no dataset.json in it)",
    "score {tmp}/none --data {data}": "{tmp}/none: no folder of a submission",
    "curves --out {tmp}": "SUBMISSIONS",
    "curves {tmp} --out {tmp}/out": "",
    "compare {sub} --data {data}": "compare|B",
    "compare {sub} {sub} --data {data} --no-cache --tracks snp": "",
    "pages --submissions {tmp} --rescored": "--rescored: expected --data too",
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


def mutants(data: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    """A file with one fault of a kind that files have."""
    lines = data.split(b"\n")
    i, j = (int(k) for k in rng.integers(1, len(lines) - 1, 2))
    cell = lines[i].split(b",")
    yield data[: int(rng.integers(len(data)))]
    yield b"\n".join([*lines[:i], *lines[i + 1 :]])
    yield b"\n".join([*lines, lines[j]])
    yield data.replace(b",", b";")
    for value in (b"nan", b"", b"1e999", b"abc", b"-1", "µ".encode(), b'"'):
        cell[int(rng.integers(len(cell)))] = value
        yield b"\n".join([*lines[:i], b",".join(cell), *lines[i + 1 :]])
    flipped = bytearray(data)
    flipped[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
    yield bytes(flipped)


@pytest.mark.parametrize("name", ["manifest.toml", "predictions.csv"])
def test_a_broken_submission_gives_one_line_and_no_traceback(
    name: str, perfect: Submission, dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, rng = tmp_path / "broken", np.random.default_rng(11)
    shutil.copytree(perfect.folder, folder)
    whole = (folder / name).read_bytes()
    words = ["score", str(folder), "--data", str(dataset.root), "--exact", "never", "--cache", str(tmp_path / "cache")]
    for data in (mutant for _ in range(2) for mutant in mutants(whole, rng)):
        (folder / name).write_bytes(data)
        status = main(words)
        out, err = capsys.readouterr()
        assert status in (0, 2), err
        assert bool(out) == (status == 0)
        assert err.count("\n") == 1 if status == 2 or err else not err, err
