"""Scoring: the truth is perfect, what is missing or invalid counts as no motion, equal input gives equal bytes."""

from __future__ import annotations

import csv
import json
import math
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark import evaluate as module
from benchmark import provenance
from benchmark.__main__ import main
from benchmark.evaluate import PerQuery, align, evaluate
from benchmark.protocol import read_protocol
from benchmark.queries import ScoredQueries
from benchmark.report import Grid, json_text, rounded
from benchmark.rescore import rescore
from benchmark.score import Scores, read_checked, score
from benchmark.summary import TITLES, binned, groups, histogram, risk_coverage, summarise
from kit1000 import Dataset
from kit1000.errors import InputError
from kit1000.metrics import Seatings
from kit1000.pose import Pose
from kit1000.queries.tracks import CURVES
from kit1000.submission import (
    HEADER,
    Submission,
    check,
    read_predictions,
    read_submission,
    write_manifest,
    write_predictions,
    write_submission,
)
from tests.samples.submissions import SECONDS, goal_of, ground_truth, made_up, manifest, predicted, predictions

PROTOCOL = read_protocol()
ERRORS = ("position_mm", "rotation_deg", "mssd_mm", "position_plain_mm", "rotation_plain_deg")


@pytest.fixture(scope="module")
def perfect(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Submission:
    """The ground truth, through a file."""
    folder = tmp_path_factory.mktemp("submissions") / "truth"
    tracks = ("snap", "snap-tilt", "snap-d415", "snap-photoneo", CURVES)  # of the one test scene of MINI
    predicted(folder, data, ground_truth, method="truth", control=True, tracks=tracks)
    return read_submission(folder)


@pytest.fixture(scope="module")
def perfect_score(perfect: Submission, data: Dataset) -> Scores:
    return score(perfect, data)


@pytest.fixture
def seating_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Instead of the seating test: every third part is seated, and is 0.5 mm too deep."""

    def seatings(predicted: Pose, truths: list[Any], *_: Any) -> Seatings:
        n = len(truths)
        third = np.arange(n) % 3 == 0
        none, depth = np.zeros(n, bool), np.full(n, 0.5e-3)
        return Seatings(third, none, depth, depth, depth, third, none)

    monkeypatch.setattr(module, "seatings", seatings)


def rows_of(queries: ScoredQueries, motions: list[Pose], rotation_only: bool = False) -> PerQuery:
    given = predictions(queries.query_ids, motions)
    return evaluate(queries, align(given, queries), rotation_only)


def near_goals(queries: ScoredQueries, seed: int = 1) -> list[Pose]:
    """Motions to the first goals with small errors."""
    rng = np.random.default_rng(seed)
    errors = [Pose.from_rotvec(rng.normal(0, 0.05, 3), rng.normal(0, 3e-3, 3)) for _ in queries.truths]
    return [error @ goal_of(truth) for error, truth in zip(errors, queries.truths, strict=True)]


def test_the_ground_truth_scores_perfectly(perfect_score: Scores) -> None:
    tracks = perfect_score.summary["tracks"]
    assert set(tracks) == {"snap", "snap-tilt", "snap-d415", "snap-photoneo"}
    for row in tracks.values():
        assert (row["n"], row["coverage"], row["loose_fits"]) == (1, 1, 0)
        for name in ERRORS:
            assert row[name]["mean"] <= 1e-9
            assert row[name]["ci95"][1] <= 1e-9
        assert row["seated"]["rate"] == row["seated_strict"]["rate"] == 1
        assert row["beyond"]["rate"] == 0
        assert row["seconds"] == {"mean": SECONDS, "median": SECONDS, "ci95": [SECONDS, SECONDS]}
    curves = perfect_score.summary["curves"]
    assert {kind: sum(row["n"] for row in rows) for kind, rows in curves.items()} == {"position": 24, "rotation": 24}
    assert all(row["p80"] <= 1e-9 for rows in curves.values() for row in rows)
    assert perfect_score.summary["curve_scenes"] == 1


def test_every_goal_scores_as_the_ground_truth_also_from_a_file(tmp_path: Path) -> None:
    queries, rng = made_up(30, CURVES), np.random.default_rng(3)
    motions = []
    for truth in queries.truths:
        angle = rng.uniform(-4, 4) if truth.slot.free_axis is not None else 0.0
        motions.append(goal_of(truth, int(rng.integers(len(truth.slot.goals))), angle))
    write_predictions(tmp_path / "predictions.csv", predictions(queries.query_ids, motions))
    rows = evaluate(queries, align(read_predictions(tmp_path / "predictions.csv"), queries))
    for name in ("position_mm", "mssd_mm", "rotation_deg"):
        assert rows.quantities[name].max() <= 1e-9
    assert set(rows.symmetry.tolist()) == {"one goal", "several goals", "free axis"}
    assert rows.quantities["rotation_plain_deg"].max() > 1  # the plain error is to one goal only


def test_a_missing_prediction_counts_as_no_motion(seating_results: None) -> None:
    queries = made_up(12)
    motions = near_goals(queries)
    some = predictions(queries.query_ids[::2], motions[::2])
    rows = evaluate(queries, align(some, queries))
    still = rows_of(queries, [motion if i % 2 == 0 else Pose.identity() for i, motion in enumerate(motions)])
    assert rows.covered.tolist() == [True, False] * 6
    for name in (*ERRORS, "seated", "penetration_mm"):
        assert np.array_equal(rows.quantities[name], still.quantities[name]), name
    assert rows.confidence[1] == 0
    assert np.isnan(rows.quantities["seconds"][1])
    summary = summarise(rows, PROTOCOL, False)["tracks"]["snap"]
    assert (summary["n"], summary["coverage"]) == (12, 0.5)
    assert summary["seconds"]["mean"] == SECONDS


def test_left_out_queries_are_told_by_the_check_and_stay_in_n(
    perfect: Submission, data: Dataset, tmp_path: Path
) -> None:
    chosen = [i for i, query_id in enumerate(perfect.predictions.query_ids) if not query_id.endswith("-snap")]
    some = predictions(
        [perfect.predictions.query_ids[i] for i in chosen], [perfect.predictions.motions[i] for i in chosen]
    )
    write_submission(tmp_path / "some", perfect.manifest, some)
    report = check(tmp_path / "some", data.root)
    assert report.good
    assert "missing-predictions" in {warning.code for warning in report.warnings}
    tracks = score(read_checked(tmp_path / "some", data.root, "test"), data).summary["tracks"]
    assert (tracks["snap"]["n"], tracks["snap"]["coverage"], tracks["snap"]["seated"]["rate"]) == (1, 0, 0)
    assert tracks["snap"]["position_mm"]["mean"] > 50
    assert tracks["snap"]["seconds"] is None
    assert tracks["snap-tilt"]["coverage"] == 1


def test_a_method_of_rotations_has_no_position_errors(data: Dataset, tmp_path: Path) -> None:
    def rotation_alone(*query: Any) -> Pose:
        return Pose(ground_truth(*query).wxyz, np.zeros(3))

    submission = predicted(tmp_path / "rotation", data, rotation_alone, predicts="rotation")
    summary = score(submission, data).summary
    row = summary["tracks"]["snap"]
    assert row["rotation_deg"]["mean"] <= 1e-9
    for name in ("position_mm", "mssd_mm", "position_plain_mm", "penetration_mm", "seated", "seated_strict", "beyond"):
        assert row[name] is None
    assert row["risk_coverage"]["mssd_mm"] is row["risk_coverage"]["seated"] is None
    assert row["histograms"]["position_mm"] is None
    assert row["worst"][0]["mssd_mm"] is row["worst"][0]["seated"] is None
    assert summary["curves"]["position"][0]["mean"] is None
    assert summary["curves"]["rotation"][0]["mean"] <= 1e-9
    json_text(summary)


def test_rotations_alone_choose_their_nearest_goal() -> None:
    queries = made_up(30, CURVES)
    motions = [Pose(goal_of(truth, len(truth.slot.goals) - 1, 0.0).wxyz, np.ones(3)) for truth in queries.truths]
    rows = rows_of(queries, motions, rotation_only=True)
    assert rows.quantities["rotation_deg"].max() <= 1e-9


def test_golden_numbers_of_made_up_queries(seating_results: None) -> None:
    """History: set on 2026-07-01 with the draft of kit1000-2026; 2026-11-22: intervals by assembly and part."""
    queries = made_up(12)
    row = rounded(summarise(rows_of(queries, near_goals(queries)), PROTOCOL, False)["tracks"]["snap"])
    assert row["position_mm"] == {"mean": 11.7331, "median": 8.33873, "ci95": [6.80106, 17.1264]}
    assert row["rotation_deg"] == {"mean": 4.17586, "median": 3.33423, "ci95": [2.85099, 5.84112]}
    assert row["mssd_mm"] == {"mean": 13.1633, "median": 9.46969, "ci95": [7.78631, 19.2468]}
    assert row["beyond"] == {"rate": 0.833333, "ci95": [0.551969, 0.953035]}
    assert row["seated"] == {"rate": 0.333333, "ci95": [0.13812, 0.609378]}
    assert row["seated_strict"] == {"rate": 0.0, "ci95": [0.0, 0.489891]}
    assert row["penetration_mm"] == {"mean": 0.5, "median": 0.5, "ci95": [0.5, 0.5]}
    assert (row["exact_tests"], row["exact_disagreements"]) == (4, 0)


def test_the_counts_of_a_summary_add_up(seating_results: None) -> None:
    queries = made_up(12)
    rows = rows_of(queries, near_goals(queries))
    summary = summarise(rows, PROTOCOL, False)
    row = summary["tracks"]["snap"]
    for histogram_ in row["histograms"].values():
        assert sum(histogram_["counts"]) == 12
        assert len(histogram_["edges"]) == len(histogram_["counts"]) + 1
        assert histogram_["edges"][-1] is None
    for key, named in summary["breakdown"]["snap"].items():
        assert sum(group["n"] for group in named.values()) == 12, key
        means = [group["n"] * group["mssd_mm"]["mean"] for group in named.values()]
        assert sum(means) / 12 == pytest.approx(row["mssd_mm"]["mean"])
    assert row["worst"][0]["mssd_mm"] == rows.quantities["mssd_mm"].max()
    assert [case["mssd_mm"] for case in row["worst"]] == sorted(rows.quantities["mssd_mm"], reverse=True)[:10]
    far = [abs(case["mssd_mm"] - np.median(rows.quantities["mssd_mm"])) for case in row["middle"]]
    assert far == pytest.approx(sorted(far))
    assert summary["curves"] is None


def test_groups_are_by_properties_of_the_queries(seating_results: None) -> None:
    queries = made_up(12)
    found = groups(rows_of(queries, near_goals(queries)), PROTOCOL)
    counts = {key: {name: int(mask.sum()) for name, mask in named.items()} for key, named in found.items()}
    assert counts["rest_mode"] == {"tumbled": 6, "upright": 6}
    assert list(counts["tilt"].items()) == [("0-5", 1), ("5-15", 2), ("15-30", 2), ("30+", 7)]
    assert counts["kits"] == {"2": 4, "3": 4, "4": 4}
    assert counts["parts"] == {"apart": 10, "pushed together": 2}
    assert counts["family"] == {"held out": 3, "seen": 9}
    assert counts["noise"] == {"0-0.1": 4, "0.1-0.14": 2, "0.14-0.2": 2, "0.2-0.25": 2, "0.25+": 2}
    assert counts["symmetry"] == {"free axis": 4, "one goal": 4, "several goals": 4}
    assert list(counts) == list(TITLES)


def test_a_bin_holds_its_lower_end() -> None:
    assert binned(np.array([0.0, 4.999, 5.0, 15.0, 80.0]), (0, 5, 15)).tolist() == ["0-5", "0-5", "5-15", "15+", "15+"]
    assert histogram(np.array([0.0, 0.5, 1.0, 99.0]), (0, 1, 2)) == {"edges": [0, 1, 2, None], "counts": [2, 1, 1]}
    assert histogram(np.array([0.0, np.nan]), (0, 1)) is None


def test_risk_over_coverage_is_the_mean_of_the_most_confident(seating_results: None) -> None:
    queries = made_up(12)
    rows = rows_of(queries, near_goals(queries))
    confidence = np.random.default_rng(5).permutation(12) / 12
    found = risk_coverage(replace(rows, confidence=confidence), 4, False)
    order = np.argsort(-confidence)
    assert found["coverage"] == [0.25, 0.5, 0.75, 1.0]
    assert found["mssd_mm"] == pytest.approx([rows.quantities["mssd_mm"][order[:k]].mean() for k in (3, 6, 9, 12)])
    assert found["seated"] == pytest.approx([rows.quantities["seated"][order[:k]].mean() for k in (3, 6, 9, 12)])


def test_scores_have_their_provenance(perfect_score: Scores, data: Dataset, perfect: Submission) -> None:
    summary = json.loads(json_text(perfect_score.summary))
    assert summary["dataset_id"] == data.id
    assert (summary["protocol"], summary["status"], summary["split"]) == (PROTOCOL.name, PROTOCOL.status, "test")
    assert summary["metric_versions"] == PROTOCOL.metric_versions
    assert (summary["commit"], summary["evaluator"]) == (provenance.commit(), provenance.evaluator())
    assert summary["method"] == "truth"
    assert summary["manifest"] == json.loads(json.dumps(asdict(perfect.manifest)))
    assert len(summary["predictions_sha256"]) == 64


def test_other_splits_can_be_scored(data: Dataset, tmp_path: Path) -> None:
    submission = predicted(tmp_path / "val", data, ground_truth, splits=("val",))
    summary = score(submission, data, split="val").summary
    assert summary["split"] == "val"
    assert summary["curves"] is None
    assert summary["tracks"]["snap"]["seated"]["rate"] == 1
    with pytest.raises(InputError, match="no prediction for a query of split test"):
        score(submission, data)


def test_only_the_tracks_of_the_manifest_are_scored(perfect: Submission, data: Dataset) -> None:
    one = replace(perfect, manifest=replace(perfect.manifest, tracks=("snap",)))
    summary = score(one, data).summary
    assert list(summary["tracks"]) == ["snap"]
    assert summary["curves"] is None
    nothing = replace(perfect, manifest=replace(perfect.manifest, tracks=("place",)))
    with pytest.raises(InputError, match="split test has no query of place"):
        score(nothing, data)


def test_another_dataset_and_unknown_queries_are_refused(perfect: Submission, data: Dataset) -> None:
    other = replace(perfect, manifest=manifest("0123456789abcdef"))
    with pytest.raises(InputError, match=f"predictions for dataset 0123456789abcdef, and .* is {data.id}"):
        score(other, data)
    ids = [*perfect.predictions.query_ids[:-1], "test-s0099-p0-snap"]
    odd = predictions(ids, list(perfect.predictions.motions))
    with pytest.raises(InputError, match=r"test-s0099-p0-snap is not in .*kit1000 check "):
        score(replace(perfect, predictions=odd), data)


def test_json_is_short_and_round() -> None:
    value = {"b": [1.23456789, -0.0, 3e-14, None], "a": {"n": 3}, "c": True}
    assert json_text(value) == '{"a": {"n": 3}, "b": [1.23457, 0.0, 0.0, null], "c": true}\n'
    long = {"key": list(range(100))}
    assert json.loads(json_text(long)) == long
    assert max(map(len, json_text({"rows": [{"x": 1 / 3, "y": 2 / 3}] * 40}).splitlines())) <= 150
    with pytest.raises(ValueError, match="JSON compliant"):
        json_text({"a": math.nan})


def test_a_table_is_aligned() -> None:
    grid = Grid(("track", "n"), [["snap", "5"], ["place-paper", "10"]])
    assert grid.text() == "track         n\nsnap          5\nplace-paper  10"
    assert grid.markdown().splitlines()[1:3] == ["| --- | ---: |", "| snap | 5 |"]


@pytest.fixture(autouse=True)
def _termination() -> Iterator[None]:
    """`main` handles SIGTERM for its process; here that is pytest."""
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def test_a_file_that_holds_no_scores_stays(
    perfect: Submission, data: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(perfect.folder, tmp_path / "mine")
    words = ["score", str(folder), "--data", str(data.root), "--exact", "never"]
    for text in ("my notes", "[1]", '{"my": "numbers"}'):
        (folder / "scores.json").write_text(text)
        assert main(words) == 2
        assert "scores.json: exists and holds no scores" in capsys.readouterr().err
        assert (folder / "scores.json").read_text() == text
    (folder / "scores.json").write_text('{"protocol": "of last year"}')
    assert main(words) == 0
    assert "tracks" in json.loads((folder / "scores.json").read_text())


def test_the_command_writes_the_scores_and_a_row_per_query(
    perfect: Submission, data: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["score", perfect.folder, "--data", data.root, "--breakdown"]
    assert main([*map(str, words), "--out", str(tmp_path / "a.json"), "--per-query", str(tmp_path / "a.csv")]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert re.search(r"^snap-tilt +1 +100\.0 +0\.00 \[0\.00, 0\.00\]", out, re.M)
    assert json.loads((tmp_path / "a.json").read_text())["tracks"]["snap"]["n"] == 1
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 + 48
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
    line: str, perfect: Submission, data: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    places = {"{tmp}": str(tmp_path), "{data}": str(data.root), "{sub}": str(perfect.folder)}
    typed, message = line, WRONG[line]
    for name, path in places.items():
        typed, message = typed.replace(name, path), message.replace(name, path)
    assert main(typed.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("python -m benchmark: ")
    assert all(fact in err for fact in message.split("|"))
    assert err.count("\n") == 1


@pytest.fixture
def mine(perfect: Submission, tmp_path: Path) -> Submission:
    """The ground truth in a folder that a test may change."""
    return read_submission(shutil.copytree(perfect.folder, tmp_path / "mine"))


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
    "long quaternion": (with_field("qw", "3"), "quaternion-norm"),
    "no id": (with_field("query_id", ""), "invalid-id"),
    "too short": (lambda line: line.rpartition(",")[0], "fields"),
}


@pytest.mark.parametrize("case", INVALID)
def test_an_invalid_prediction_counts_as_no_motion(case: str, mine: Submission, data: Dataset) -> None:
    change, code = INVALID[case]
    folder, line = mine.folder, line_of_snap(mine.folder)
    edit(folder, line, change)
    assert [(error.line, error.code) for error in check(folder).errors] == [(line, code)]
    with pytest.raises(InputError, match=rf"predictions\.csv:{line}:"):
        read_submission(folder)
    submission = read_checked(folder, data.root, "test")
    first = submission.invalid.first
    assert first is not None
    assert (submission.invalid.count, first.line, first.code) == (1, line, code)
    tracks = score(submission, data, exact="never").summary["tracks"]
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
    "a duplicate": (duplicate, "line 2 has the same id"),
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
    case: str, mine: Submission, data: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, expected = FORM[case]
    spoil(mine.folder)
    with pytest.raises(InputError, match=f"mine: .*{expected}"):
        read_checked(mine.folder, data.root, "test")
    assert main(["score", str(mine.folder), "--data", str(data.root)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert not (mine.folder / "scores.json").exists()


def test_a_file_of_invalid_rows_alone_is_not_scored(mine: Submission, data: Dataset) -> None:
    path = mine.folder / "predictions.csv"
    head, *rows, _ = path.read_text().split("\n")
    path.write_text("\n".join([head, *(with_field("qw", "nan")(row) for row in rows), ""]))
    with pytest.raises(InputError, match=r"no row is.* valid.*predictions\.csv:2:"):
        read_checked(mine.folder, data.root, "test")


def test_the_command_says_how_many_rows_are_invalid_and_shows_the_coverage(
    mine: Submission, data: Dataset, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, line = mine.folder, line_of_snap(mine.folder)
    edit(folder, line, with_field("qw", "nan"))
    edit(folder, line + 1, with_field("confidence", "2"))
    words = ["score", str(folder), "--data", str(data.root), "--exact", "never"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    begins = f"python -m benchmark: {folder}: 2 rows are no valid predictions; their queries count as no motion;"
    assert err.startswith(f"{begins} the first: {folder}/predictions.csv:{line}:")
    assert err.count("\n") == 1
    assert any(row.split()[:3] == ["snap", "1", "0.0"] for row in out.split("\n"))
    written: dict[str, Any] = json.loads((folder / "scores.json").read_text())
    assert written["tracks"]["snap"]["coverage"] == 0
    ((_, differences),) = rescore([folder], data.root)
    assert differences == []
