"""The runner: a prediction for every query, the same however a run is stopped or split, in a complete submission."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.__main__ import main
from baselines.catalog import run_config
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, InternalError
from kit1000.pose import Pose
from kit1000.prediction import predict as runner
from kit1000.prediction.journal import Journal
from kit1000.prediction.predict import predict
from kit1000.predictor import PredictedMotion
from kit1000.queries.tracks import ALL_TRACKS, TRACKS
from kit1000.submission import Submission, check, read_submission
from kit1000.values import Prediction, Query, TrueGeometry
from tests.samples.checkout import ROOT

STOP = "KIT1000_TEST_STOP"


def stopping(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """Raises at the query that the environment names."""
    if query.id == os.environ.get(STOP):
        raise RuntimeError("out\nof luck")
    return PredictedMotion(Pose.from_translation(query.pivot), 0.25)


def slow(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    time.sleep(0.2)
    return stopping(query, geometry)


def refusing(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    raise InputError("no part in sight")


def peeking(query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
    """Confident when it is handed the true geometry."""
    return PredictedMotion(Pose.identity(), float(geometry is not None))


class UsesGeometry:
    """Sets `uses_true_geometry`."""

    uses_true_geometry = True
    tracks = ("snap",)

    def __init__(self, dataset: Dataset) -> None:
        pass

    def __call__(self, query: Query, geometry: TrueGeometry | None) -> PredictedMotion:
        return peeking(query, geometry)


def named(function: Any) -> str:
    return f"{__name__}:{function.__name__}"


def rows(submission: Submission) -> list[tuple[Any, ...]]:
    """All but the seconds, which differ between runs."""
    table = submission.predictions
    return [
        (query_id, *motion.wxyz.tolist(), *motion.xyz.tolist(), confidence)
        for query_id, motion, confidence in zip(table.query_ids, table.motions, table.confidence, strict=True)
    ]


def query_ids_of(mini: Path, split: str) -> list[str]:
    return [query.id for query in Dataset(mini).split(split).queries()]


def test_there_is_a_prediction_for_every_query_in_the_order_of_the_split(mini: Path, tmp_path: Path) -> None:
    submission = predict(run_config("chance"), mini, tmp_path / "chance", 1)
    assert list(submission.predictions.query_ids) == query_ids_of(mini, "test")
    assert submission.manifest.tracks == tuple(
        track for track in TRACKS if any(i.endswith(f"-{track}") for i in submission.predictions.query_ids)
    )
    assert (submission.predictions.seconds > 0).all()
    assert rows(read_submission(tmp_path / "chance")) == rows(submission)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["chance", "manifest.toml", "predictions.csv"]


def test_what_is_written_passes_the_check(mini: Path, tmp_path: Path) -> None:
    predict(run_config("guess", ("test", "curves")), mini, tmp_path / "guess", 1)
    report = check(tmp_path / "guess", mini)
    assert not [fault for fault in report.faults if fault.severity == "error"]


def test_one_process_and_two_give_the_same(mini: Path, tmp_path: Path) -> None:
    one, two = (predict(run_config("truth-noise", seed=5), mini, tmp_path / str(n), n) for n in (1, 2))
    assert rows(one) == rows(two)


def test_tracks_and_splits_added_one_by_one_are_what_one_run_gives(mini: Path, tmp_path: Path) -> None:
    whole = predict(run_config("guess", ("val", "test", "curves")), mini, tmp_path / "whole", 1)
    noisy = ("snap-d415", "snap-photoneo")
    for split, tracks in (("curves", None), ("test", noisy), ("val", None), ("test", ("snap-tilt", "snap"))):
        step = predict(run_config("guess", (split,), tracks), mini, tmp_path / "steps", 1)
    assert rows(step) == rows(whole)
    assert step.manifest.tracks == whole.manifest.tracks == ("snap", "snap-tilt", *noisy, "curves")
    assert step.manifest.reproduce.count("python -m baselines predict guess") == 4
    assert Counter(i.partition("-")[0] for i in step.predictions.query_ids)["curves"] == 48


def test_queries_of_test_appear_once_beside_test_all(mini: Path, tmp_path: Path) -> None:
    both = predict(run_config("guess", ("test", "test-all")), mini, tmp_path / "both", 1)
    assert len(set(both.predictions.query_ids)) == len(both.predictions)
    assert rows(both) == rows(predict(run_config("guess", ("test-all",)), mini, tmp_path / "all", 1))


def test_a_second_run_replaces_predictions_and_keeps_what_people_wrote(mini: Path, tmp_path: Path) -> None:
    out = tmp_path / "chance"
    zero = predict(run_config("chance", tracks=("snap",)), mini, out, 1)
    text = (out / "manifest.toml").read_text()
    (out / "manifest.toml").write_text(text.replace("The KIT1000 authors", "Ada Example"))
    one = predict(run_config("chance", tracks=("snap",), seed=1), mini, out, 1)
    assert one.predictions.query_ids == zero.predictions.query_ids
    assert rows(one) != rows(zero)
    assert one.manifest.authors == ("Ada Example",)


def test_another_method_or_dataset_is_not_mixed_in(mini: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    predict(run_config("guess", limit=1), mini, out, 1)
    with pytest.raises(InputError, match=r"method guess, not chance.*--out"):
        predict(run_config("chance"), mini, out, 1)
    manifest = (out / "manifest.toml").read_text()
    (out / "manifest.toml").write_text(manifest.replace(Dataset(mini).id, "0123456789abcdef"))
    with pytest.raises(InputError, match=r"holds predictions of dataset 0123456789abcdef"):
        predict(run_config("guess"), mini, out, 1)
    (tmp_path / "full").mkdir()
    (tmp_path / "full/notes.txt").touch()
    with pytest.raises(InputError, match=r"full: is not empty.*--out"):
        predict(run_config("guess"), mini, tmp_path / "full", 1)


def test_only_a_method_that_uses_true_geometry_gets_it(mini: Path, tmp_path: Path) -> None:
    blind = predict(run_config(named(peeking)), mini, tmp_path / "blind", 1)
    assert not blind.predictions.confidence.any()
    assert not blind.manifest.uses_true_geometry
    informed = predict(run_config(named(UsesGeometry)), mini, tmp_path / "informed", 1)
    assert informed.predictions.confidence.all()
    assert informed.manifest.uses_true_geometry
    assert informed.manifest.tracks == ("snap",)


def test_other_methods_open_no_file_of_the_truth(mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Dataset, "truth_file", lambda *_: pytest.fail("the truth was opened"))
    predict(run_config("guess"), mini, tmp_path / "guess", 1)


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_that_fails_names_the_query_and_resumes(
    workers: int, mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, out = run_config(named(stopping)), tmp_path / "mine"
    last = query_ids_of(mini, "test")[-1]
    monkeypatch.setenv(STOP, last)
    with pytest.raises(InternalError, match=rf"^{last}: RuntimeError: out of luck \(test_predict.py:\d+\)$"):
        predict(config, mini, out, workers)
    journal = out.with_name("mine.journal")
    kept = journal.read_text().splitlines()[1:]
    assert 0 < len(kept) < len(query_ids_of(mini, "test"))
    assert not out.exists()
    monkeypatch.delenv(STOP)
    whole = predict(config, mini, out, workers)
    assert list(whole.predictions.query_ids) == query_ids_of(mini, "test")
    assert not journal.exists()
    kept_seconds = {row[0]: row[-1] for row in map(json.loads, kept)}
    at = {i: float(s) for i, s in zip(whole.predictions.query_ids, whole.predictions.seconds, strict=True)}
    assert all(at[query_id] == seconds for query_id, seconds in kept_seconds.items())  # not computed again


def test_a_killed_run_resumes(mini: Path, tmp_path: Path) -> None:
    out, journal = tmp_path / "mine", tmp_path / "mine.journal"
    command = [sys.executable, "-m", "baselines", "predict", named(slow), "--data", str(mini), "--out", str(out)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([*command, "--workers", "1"], cwd=ROOT, env=environment, stderr=subprocess.DEVNULL)
    limit = time.monotonic() + 60
    while not (journal.is_file() and journal.read_text().count("\n") > 2):
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < limit, "the run never predicted anything"
        time.sleep(0.02)
    process.kill()
    process.wait()
    with open(journal, "a") as file:
        file.write('["half a li')  # as if it had been killed while writing
    whole = predict(run_config(named(slow)), mini, out, 1)
    assert list(whole.predictions.query_ids) == query_ids_of(mini, "test")


def test_an_error_of_a_method_names_the_query(mini: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"^{query_ids_of(mini, 'test')[0]}: no part in sight$"):
        predict(run_config(named(refusing)), mini, tmp_path / "mine", 1)


def test_an_unfinished_run_with_other_settings_is_not_resumed(
    mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "mine"
    monkeypatch.setenv(STOP, query_ids_of(mini, "test")[1])
    with pytest.raises(InternalError):
        predict(run_config(named(stopping)), mini, out, 1)
    monkeypatch.delenv(STOP)
    for config, difference in (
        (run_config(named(stopping), seed=1), "seed 0, now 1"),
        (run_config(named(stopping), ("val",)), r"splits \['test'\], now \['val'\]"),
        (run_config("guess"), f"method '{named(stopping)}', now 'guess'"),
    ):
        with pytest.raises(InputError, match=f"mine.journal: an unfinished run with {difference}; finish that one, or"):
            predict(config, mini, out, 1)
    monkeypatch.setattr(runner, "source_hash", lambda _: "changed")
    with pytest.raises(InputError, match="an unfinished run with source"):
        predict(run_config(named(stopping)), mini, out, 1)


def test_a_journal_returns_every_bit_and_is_locked_by_one_run(tmp_path: Path) -> None:
    rng, path = np.random.default_rng(0), tmp_path / "some.journal"
    predictions = [
        Prediction(f"q{i}", Pose(rng.normal(size=4), rng.normal(size=3)), rng.random(), 0.1) for i in range(5)
    ]
    with Journal(path, {"seed": 0}) as journal:
        for prediction in predictions:
            journal.add(prediction)
        with pytest.raises(InputError, match="is being written by another process"):
            Journal(path, {"seed": 0})
    with Journal(path, {"seed": 0}) as journal:
        for prediction in predictions:
            again = journal.done[prediction.query_id]
            assert again.goal_from_now.wxyz.tobytes() == prediction.goal_from_now.wxyz.tobytes()
            assert again.goal_from_now.xyz.tobytes() == prediction.goal_from_now.xyz.tobytes()
            assert (again.confidence, again.seconds) == (prediction.confidence, prediction.seconds)
        journal.delete()
    assert not path.exists()
    path.write_text("what is this\n")
    with pytest.raises(InputError, match="is no journal"):
        Journal(path, {"seed": 0})


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            run_config("guess", tracks=("place",)),
            "--tracks place: .*guess.*snap, snap-tilt, snap-d415, snap-photoneo, curves",
        ),
        (run_config("truth", tracks=("snapp",)), "--tracks snapp: did you mean snap[?] the tracks of truth are"),
        (run_config("guess", ("tests",)), "no split 'tests'; did you mean test"),
        (run_config("guess", ("test", "curves"), ("snap",)), "split curves has no query in snap"),
        (run_config("guess", ()), "--split: expected at least one"),
    ],
)
def test_a_run_without_queries_is_refused(config: runner.RunConfig, message: str, mini: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        predict(config, mini, tmp_path / "out", 1)
    assert not list(tmp_path.iterdir())


def test_the_command_predicts_and_prints_what_it_wrote(
    mini: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "truth"
    line = f"predict truth --data {mini} --out {out} --split test curves --tracks snap curves --limit 3 --workers 1"
    assert main(line.split()) == 0
    printed = capsys.readouterr()
    assert printed.err == ""  # no progress bar without a terminal
    assert printed.out.startswith(f"{out}: 3 predictions of truth (snap, curves), ")
    assert set(read_submission(out).manifest.tracks) <= set(ALL_TRACKS)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("", "predict"),
        ("predct truth", "predct"),
        ("predict truth --out o", "--data"),
        ("predict truth --data nowhere --out o", "nowhere"),
        ("predict guess --data . --out o --limit 0", "--limit: expected 1 or more, got 0"),
        ("predict guess --data . --out o --seed -1", "--seed: expected 0 or more, got -1"),
        ("predict nobody --data . --out o", "no method 'nobody'"),
    ],
)
def test_misuse_is_one_line_and_status_two(line: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("python -m baselines: ")
    assert message in printed
    assert printed.count("\n") == 1
