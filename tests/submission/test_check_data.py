"""Checking a submission against a dataset: ids, coverage, and implausible motions."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kit1000.cli import main
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.queries.tracks import CURVES
from kit1000.submission import Manifest, Predictions, Report, check, write_predictions, write_submission
from kit1000.submission.check import CHECKSUM_2_0_0, coverage_faults
from kit1000.submission.expected_queries import ExpectedQueries
from kit1000.submission.faults import Fault
from kit1000.values import Prediction
from tests.samples.checkout import ROOT

DOCUMENT = ROOT / "docs/reference/submission.md"


@pytest.fixture(scope="module")
def truth(mini: Path) -> Predictions:
    """The drawn goal of every query of the test split and of the curves."""
    dataset = Dataset(mini)
    rows = [
        Prediction(query.id, scene.truths[query.id].goal_drawn, 1.0, 0.5)
        for name in ("test", CURVES)
        for scene in dataset.split(name, truth=True)
        for query in scene.queries
    ]
    return Predictions.of(rows)


@pytest.fixture(scope="module")
def manifest(mini: Path) -> Manifest:
    dataset = Dataset(mini)
    tracks = [query.track for query in dataset.split("test").queries()]
    return Manifest(
        method="truth",
        authors=("A. Name",),
        description="The ground truth.",
        date="2026-01-31",
        dataset_id=dataset.id,
        tracks=(*dict.fromkeys(tracks), CURVES),
        learned=False,
        uses_true_geometry=True,
        control=True,
        dataset_checksum=dataset.summary["checksum"],
    )


def changed(truth: Predictions, rows: np.ndarray | slice, ids: dict[str, str] | None = None) -> Predictions:
    """Some of the predictions, with some of the ids replaced."""
    names: list[str] = np.array(truth.query_ids)[rows].tolist()
    renamed = ids or {}
    kept = tuple(renamed.get(name, name) for name in names)
    return Predictions(kept, truth.motions[rows], truth.confidence[rows], truth.seconds[rows])


def only(report: Report, code: str) -> str:
    """The message of the only fault, which must have this code."""
    assert [fault.code for fault in report.faults] == [code], str(report)
    return str(report.faults[0])


def test_the_ground_truth_has_no_fault(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_submission(tmp_path, manifest, truth)
    report = check(tmp_path, mini)
    assert (report.faults, report.rows, report.against_data) == ((), len(truth), True)
    assert main(["check", str(tmp_path), "--data", str(mini)]) == 0
    assert capsys.readouterr().out == f"{tmp_path}: {len(truth)} rows checked against the dataset: no faults\n"


def test_no_ground_truth_and_no_mesh_is_read(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    whole = Path.open

    def watched(path: Path, *args: object, **options: object) -> object:
        opened.append(path.name)
        return whole(path, *args, **options)  # pyright: ignore[reportArgumentType, reportCallIssue]

    monkeypatch.setattr(Path, "open", watched)
    write_submission(tmp_path, manifest, truth)
    assert check(tmp_path, mini).good
    assert not [name for name in opened if "truth" in name or name.endswith(".glb")]


def test_missing_predictions_are_a_warning_with_their_number_by_track(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = [i for i, query_id in enumerate(truth.query_ids) if query_id.startswith("curves")][:5]
    snap = next(i for i, query_id in enumerate(truth.query_ids) if query_id.endswith("-snap"))
    rows = np.setdiff1d(np.arange(len(truth)), [*lost, snap])
    write_submission(tmp_path, manifest, changed(truth, rows))
    report = check(tmp_path, mini)
    assert (report.good, report.errors) == (True, ())
    assert main(["check", str(tmp_path), "--data", str(mini)]) == 0
    assert "0 errors, 2 warnings" in capsys.readouterr().out
    curves, first = sorted(str(fault) for fault in report.faults)
    names = ", ".join(truth.query_ids[i] for i in lost[:3])
    assert f"track curves: 5 of 48 queries have no row ({names} and 2 more)" in curves
    assert f"track snap: 1 of 1 queries have no row ({truth.query_ids[snap]})" in first


def test_curves_may_leave_out_scenes_but_not_single_queries() -> None:
    ids = tuple(f"curves-s{scene:04}-p0-pos{level}-rot1" for scene in range(3) for level in range(4))
    curves, zeros = (CURVES,) * 12, np.zeros((12, 3))
    expected = ExpectedQueries("id", None, ids, curves, curves, np.ones(12, bool), zeros, zeros, np.zeros((12, 4)))

    def coverage(query_ids: tuple[str, ...]) -> list[Fault]:
        rows: Any = SimpleNamespace(query_ids=query_ids, file="p.csv")
        return list(coverage_faults(rows, [CURVES], expected))

    assert coverage(ids) == []
    (partial,) = coverage(ids[4:8])
    assert partial.severity == "warning"
    assert "1 of 3 scenes have predictions" in partial.actual
    missing, partial = sorted(coverage(ids[:6]), key=lambda fault: fault.code)
    assert {missing.severity, partial.severity} == {"warning"}
    assert "2 of 8 queries have no row" in missing.actual


def test_a_file_without_a_manifest_needs_the_tracks_of_its_rows(mini: Path, truth: Predictions, tmp_path: Path) -> None:
    rows = np.flatnonzero([not query_id.startswith("curves") for query_id in truth.query_ids])
    write_predictions(tmp_path / "p.csv", changed(truth, rows))
    assert check(tmp_path / "p.csv", mini).faults == ()


NAMES: dict[str, Callable[[str], str]] = {
    "case": str.upper,
    "underscores": lambda name: name.replace("-", "_"),
    "leading zeros": lambda name: name.replace("s0000", "s0"),
}


@pytest.mark.parametrize("case", NAMES)
def test_the_closest_id_is_suggested_for_an_unknown_one(
    case: str, mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path
) -> None:
    known = next(query_id for query_id in truth.query_ids if query_id.endswith("-snap"))
    unknown = NAMES[case](known)
    write_submission(tmp_path, manifest, changed(truth, slice(None), {known: unknown}))
    fault = next(fault for fault in check(tmp_path, mini).faults if fault.code == "unknown-id")
    assert fault.actual == f'query_id = "{unknown}"'
    assert fault.repair == f"did you mean {known}?"


def test_an_id_without_a_close_one_is_reported(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path
) -> None:
    known = truth.query_ids[0]
    write_submission(tmp_path, manifest, changed(truth, slice(None), {known: "test-s7777-p0-snap"}))
    report = check(tmp_path, mini)
    assert [fault.code for fault in report.errors] == ["unknown-id"]
    assert [fault.code for fault in report.warnings] == ["missing-predictions"]


def test_rows_of_other_splits_are_ignored(mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path) -> None:
    dataset = Dataset(mini)
    rows = [Prediction(query.id, Pose.identity(), 1.0, 0.0) for query in dataset.split("val").queries()]
    both = Predictions.of(rows)
    both = Predictions(
        (*truth.query_ids, *both.query_ids),
        Pose(
            np.concatenate([truth.motions.wxyz, both.motions.wxyz]),
            np.concatenate([truth.motions.xyz, both.motions.xyz]),
        ),
        np.concatenate([truth.confidence, both.confidence]),
        np.concatenate([truth.seconds, both.seconds]),
    )
    write_submission(tmp_path, manifest, both)
    message = only(check(tmp_path, mini), "other-split")
    assert f"warning: {len(rows)} rows of split val" in message
    assert check(tmp_path, mini, "val").good  # val has no curves, and may lack rows of a track


def test_rows_of_unlisted_tracks(mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path) -> None:
    write_submission(tmp_path, replace(manifest, tracks=manifest.tracks[:-1]), truth)
    assert "48 rows of track curves, which manifest.toml does not list" in only(check(tmp_path, mini), "unlisted-track")


def test_another_dataset_is_refused_and_another_copy_is_a_warning(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path
) -> None:
    write_submission(tmp_path, replace(manifest, dataset_id="0123456789abcdef"), truth)
    report = check(tmp_path, mini)
    assert not report.good
    assert f'expected "{manifest.dataset_id}", that of --data' in only(report, "other-dataset")
    assert report.faults[0].line == 7
    write_submission(tmp_path, replace(manifest, dataset_checksum="0" * 64), truth)
    report = check(tmp_path, mini)
    assert report.good
    assert "built on another machine" in only(report, "other-checksum")
    write_submission(tmp_path, replace(manifest, dataset_checksum=CHECKSUM_2_0_0), truth)
    assert check(tmp_path, mini).faults == ()  # other files of equal content


def test_tracks_that_the_dataset_lacks_are_refused(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path
) -> None:
    data = tmp_path / "data"
    shutil.copytree(mini, data)
    summary = json.loads((data / "dataset.json").read_text())
    summary["config"]["curve_scenes"] = 0
    (data / "dataset.json").write_text(json.dumps(summary))
    rows = np.flatnonzero([not query_id.startswith("curves") for query_id in truth.query_ids])
    write_submission(tmp_path / "mine", manifest, changed(truth, rows))
    assert 'tracks has "curves"' in only(check(tmp_path / "mine", data), "unknown-track")


def test_the_fault_of_a_manifest_without_dataset_names_the_id(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path
) -> None:
    write_submission(tmp_path, manifest, truth)
    path = tmp_path / "manifest.toml"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith("dataset_id")) + "\n")
    (fault,) = check(tmp_path, mini).errors
    assert fault.repair == f'add a line dataset_id = "{Dataset(mini).id}"'


def test_no_position_and_no_motion_are_no_faults(
    mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path
) -> None:
    for motions, predicts in (
        (Pose(truth.motions.wxyz, np.zeros(3)), "rotation"),
        (Pose.identity((len(truth),)), "pose"),
    ):
        predictions = Predictions(truth.query_ids, motions, truth.confidence, truth.seconds)
        write_submission(tmp_path, replace(manifest, predicts=predicts), predictions)
        assert check(tmp_path, mini).faults == ()


def test_anything_but_a_dataset_is_refused(mini: Path, truth: Predictions, tmp_path: Path) -> None:
    write_predictions(tmp_path / "p.csv", truth)
    with pytest.raises(InputError, match="no dataset"):
        check(tmp_path / "p.csv", tmp_path)
    with pytest.raises(InputError, match="did you mean test"):
        check(tmp_path / "p.csv", mini, "tset")
    assert main(["check", str(tmp_path / "p.csv"), "--data", str(tmp_path)]) == 2


def test_any_file_can_be_checked_against_a_dataset(mini: Path, tmp_path: Path) -> None:
    for content in (b"", b"\xff", b"query_id,qw,qx,qy,qz,x,y,z,confidence,seconds\n", b"a,b\n1,2\n"):
        (tmp_path / "p.csv").write_bytes(content)
        assert not check(tmp_path / "p.csv", mini).good


def test_the_script_of_the_documentation_writes_a_valid_submission(
    mini: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data/kit1000").symlink_to(mini)
    monkeypatch.chdir(tmp_path)
    script = re.findall(r"^```py\n(.*?)^```", DOCUMENT.read_text("utf-8"), re.MULTILINE | re.DOTALL)[0]
    assert len(script.splitlines()) <= 25
    exec(script, {})
    assert check("submissions/mine", "data/kit1000").good
