"""Submissions are reproduced: predictions by running the method again, scores by scoring again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.__main__ import main as baselines
from baselines.catalog import run_config
from baselines.rerun import rerun
from benchmark.__main__ import main as benchmark
from benchmark.rescore import rescore
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.prediction.predict import predict
from kit1000.submission import read_submission, write_predictions


@pytest.fixture(scope="module")
def made(mini: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Predictions of a method that draws, also for the curves."""
    out = tmp_path_factory.mktemp("made") / "chance"
    predict(run_config("chance", ("test", "curves")), mini, out, 1)
    assert benchmark(["score", str(out), "--data", str(mini)]) == 0
    return out


def copied(made: Path, out: Path) -> Path:
    out.mkdir()
    for file in made.iterdir():
        (out / file.name).write_bytes(file.read_bytes())
    return out


@pytest.mark.parametrize("workers", [1, 2])
def test_a_method_predicts_the_same_again(
    made: Path, mini: Path, workers: int, capsys: pytest.CaptureFixture[str]
) -> None:
    again = rerun(made, mini, 10_000, workers)
    assert again.query_ids == read_submission(made).predictions.query_ids
    assert {query_id.partition("-")[0] for query_id in again.query_ids} == {"test", "curves"}
    assert again.same.all()
    np.testing.assert_allclose(again.position_mm, 0, atol=1e-6)
    assert baselines(["rerun", str(made), "--data", str(mini), "--first", "3", "--workers", "1"]) == 0
    assert capsys.readouterr().out == f"{made}: 3 predictions, the same to the last digit\n"


def test_a_changed_prediction_is_named(
    made: Path, mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, table = copied(made, tmp_path / "chance"), read_submission(made).predictions
    nudges = np.zeros((len(table), 3))
    nudges[2, 1] = 2e-5
    write_predictions(out / "predictions.csv", replace(table, motions=Pose.from_translation(nudges) @ table.motions))
    again = rerun(out, mini, 5, 1)
    np.testing.assert_allclose(again.position_mm, [0, 0, 0.02, 0, 0], atol=1e-6)
    assert again.same.tolist() == [True, True, False, True, True]
    assert baselines(["rerun", str(out), "--data", str(mini), "--first", "5", "--workers", "1"]) == 1
    assert again.identical.tolist() == [True, True, False, True, True]
    line = capsys.readouterr().out
    assert line.startswith(f"{out}: 5 predictions, 4 of them the same to the last digit; at most 0.02 mm and ")
    assert line.endswith(f"; 1 beyond the allowed 0.01 mm or 0.05°, the first {table.query_ids[2]}\n")


@pytest.mark.parametrize("changed", ["position", "confidence"])
def test_a_difference_within_the_tolerance_is_not_the_same_to_the_last_digit(
    made: Path, mini: Path, tmp_path: Path, changed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, table = copied(made, tmp_path / "chance"), read_submission(made).predictions
    if changed == "position":
        motions = Pose.from_translation((np.arange(len(table)) == 1)[:, None] * (5e-6, 0, 0)) @ table.motions
        table = replace(table, motions=motions)
    else:
        table = replace(table, confidence=np.where(np.arange(len(table)) == 1, 0.123, table.confidence))
    write_predictions(out / "predictions.csv", table)
    assert baselines(["rerun", str(out), "--data", str(mini), "--first", "3", "--workers", "1"]) == 0
    line = capsys.readouterr().out
    assert line.startswith(f"{out}: 3 predictions, 2 of them the same to the last digit; at most ")
    assert line.endswith("from those submitted, within the 0.01 mm and 0.05° allowed for networks\n")


def test_a_submission_that_cannot_be_rerun_is_bad_input(made: Path, mini: Path, tmp_path: Path) -> None:
    out = copied(made, tmp_path / "chance")
    manifest = (out / "manifest.toml").read_text()
    (out / "manifest.toml").write_text(manifest.replace('method = "chance"', 'method = "chanse"'))
    with pytest.raises(InputError, match="no method 'chanse'; did you mean chance"):
        rerun(out, mini, 1, 1)
    assert baselines(["rerun", str(made), "--data", str(mini), "--first", "0"]) == 2
    table = read_submission(made).predictions
    (out / "manifest.toml").write_text(manifest)
    write_predictions(out / "predictions.csv", replace(table, query_ids=("test-s9999-p0-snap", *table.query_ids[1:])))
    with pytest.raises(InputError, match="has no query test-s9999-p0-snap"):
        rerun(out, mini, 1, 1)


@pytest.mark.slow
def test_scores_come_out_again_to_the_last_digit(made: Path, mini: Path, tmp_path: Path) -> None:
    assert list(rescore([made], mini)) == [(made, [])]
    assert benchmark(["rescore", str(made), "--data", str(mini)]) == 0
    out = copied(made, tmp_path / "chance")
    scores = json.loads((out / "scores.json").read_text())
    scores["tracks"]["snap"]["position_mm"]["mean"] += 0.0001
    scores["commit"] = "another"
    (out / "scores.json").write_text(json.dumps(scores))
    for workers in (1, 2):  # each submission is told apart, whoever scored it
        again = dict(rescore([made, out], mini, workers))
        assert again[made] == []
        (line,) = again[out]
        assert line.startswith("tracks.snap.position_mm.mean: ")
    assert benchmark(["rescore", str(out), "--data", str(mini)]) == 1
