"""Checking a submission against a dataset: ids, coverage, tracks, and mistaken conventions."""

from __future__ import annotations

import json
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
from kit1000.pose import Pose, quaternion_conjugate
from kit1000.queries.tracks import CURVES
from kit1000.submission import Manifest, Predictions, Report, check, write_predictions, write_submission
from kit1000.submission.check import CHECKSUM_2_0_0, coverage_faults
from kit1000.submission.conventions import IN_KIT, Sample, motion_faults
from kit1000.submission.expected_queries import ExpectedQueries
from kit1000.submission.faults import Fault
from kit1000.values import Prediction
from tests.samples import submissions as samples


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
    checksum = dataset.summary["checksum"]
    return samples.manifest(
        dataset.id, tracks=(*dict.fromkeys(tracks), CURVES), control=True, dataset_checksum=checksum
    )


@pytest.fixture
def checked(mini: Path, manifest: Manifest, truth: Predictions, tmp_path: Path) -> Callable[..., Report]:
    """Writes predictions, the truth if absent, with a changed manifest into tmp_path and checks them."""

    def report(predictions: Predictions = truth, data: Path = mini, split: str = "test", **fields: Any) -> Report:
        write_submission(tmp_path, replace(manifest, **fields), predictions)
        return check(tmp_path, data, split)

    return report


def chosen(truth: Predictions, kept: Callable[[str], bool], ids: dict[str, str] | None = None) -> Predictions:
    """The predictions for some queries, with some of the ids replaced."""
    rows = np.flatnonzero([kept(query_id) for query_id in truth.query_ids])
    names = tuple((ids or {}).get(name, name) for name in (truth.query_ids[i] for i in rows))
    return Predictions(names, truth.motions[rows], truth.confidence[rows], truth.seconds[rows])


def only(report: Report, code: str) -> Fault:
    """The only fault, which must have this code."""
    assert [fault.code for fault in report.faults] == [code], str(report)
    return report.faults[0]


def test_the_ground_truth_has_no_fault_and_no_truth_is_read(
    mini: Path,
    checked: Callable[..., Report],
    truth: Predictions,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    opened: list[str] = []
    whole = Path.open

    def watched(path: Path, *args: object, **options: object) -> object:
        opened.append(path.name)
        return whole(path, *args, **options)  # pyright: ignore[reportArgumentType, reportCallIssue]

    monkeypatch.setattr(Path, "open", watched)
    report = checked()
    assert (report.faults, report.rows, report.against_data) == ((), len(truth), True)
    assert main(["check", str(tmp_path), "--data", str(mini)]) == 0
    assert capsys.readouterr().out == f"{tmp_path}: {len(truth)} rows checked against the dataset: no faults\n"
    assert not [name for name in opened if "truth" in name or name.endswith(".glb")]


def test_missing_predictions_are_a_warning_with_their_number_by_track(
    checked: Callable[..., Report], truth: Predictions
) -> None:
    lost = [query_id for query_id in truth.query_ids if query_id.startswith("curves")][:5]
    snap = next(query_id for query_id in truth.query_ids if query_id.endswith("-snap"))
    report = checked(chosen(truth, lambda name: name not in (*lost, snap)))
    assert (report.good, report.errors, len(report.warnings)) == (True, (), 2)
    curves, first = sorted(str(fault) for fault in report.faults)
    assert f"track curves: 5 of 48 queries have no row ({', '.join(lost[:3])} and 2 more)" in curves
    assert f"track snap: 1 of 1 queries have no row ({snap})" in first


def test_curves_may_leave_out_scenes_but_not_single_queries() -> None:
    ids = tuple(f"curves-s{scene:04}-p0-pos{level}-rot1" for scene in range(3) for level in range(4))
    curves, zeros = (CURVES,) * 12, np.zeros((12, 3))
    expected = ExpectedQueries("id", None, ids, curves, curves, np.ones(12, bool), zeros, zeros, np.zeros((12, 4)))

    def coverage(query_ids: tuple[str, ...]) -> list[Fault]:
        rows: Any = SimpleNamespace(query_ids=query_ids, file="p.csv")
        return sorted(coverage_faults(rows, [CURVES], expected), key=lambda fault: fault.code)

    assert coverage(ids) == []
    (partial,) = coverage(ids[4:8])
    assert partial.severity == "warning"
    assert "1 of 3 scenes have predictions" in partial.actual
    missing, partial = coverage(ids[:6])
    assert {missing.severity, partial.severity} == {"warning"}
    assert "2 of 8 queries have no row" in missing.actual


def test_a_file_without_a_manifest_needs_the_tracks_of_its_rows(mini: Path, truth: Predictions, tmp_path: Path) -> None:
    write_predictions(tmp_path / "p.csv", chosen(truth, lambda name: not name.startswith("curves")))
    assert check(tmp_path / "p.csv", mini).faults == ()


def test_an_unknown_id_is_an_error(checked: Callable[..., Report], truth: Predictions) -> None:
    known = next(query_id for query_id in truth.query_ids if query_id.endswith("-snap"))
    (fault,) = checked(chosen(truth, lambda _: True, {known: "test-s7-p0"})).errors
    assert (fault.code, fault.actual) == ("unknown-id", 'query_id = "test-s7-p0"')


def test_rows_of_other_splits_are_ignored(mini: Path, checked: Callable[..., Report], truth: Predictions) -> None:
    ids = [query.id for query in Dataset(mini).split("val").queries()]
    n = len(ids)
    both = Predictions(
        (*truth.query_ids, *ids),
        Pose.stack([*truth.motions, *[Pose.identity()] * n]),
        np.concatenate([truth.confidence, np.ones(n)]),
        np.concatenate([truth.seconds, np.ones(n)]),
    )
    assert f"{n} rows of split val" in only(checked(both), "other-split").actual
    assert checked(both, split="val").good  # val has no curves, and may lack rows of a track


def test_the_dataset_and_the_tracks_of_the_manifest_are_compared(
    mini: Path, checked: Callable[..., Report], manifest: Manifest, truth: Predictions, tmp_path: Path
) -> None:
    unlisted = only(checked(tracks=manifest.tracks[:-1]), "unlisted-track")
    assert "48 rows of track curves" in unlisted.actual
    other = only(checked(dataset_id="0123456789abcdef"), "other-dataset")
    assert (other.severity, other.line) == ("error", 7)
    assert manifest.dataset_id in other.expected
    assert only(checked(dataset_checksum="0" * 64), "other-checksum").severity == "warning"
    assert checked(dataset_checksum=CHECKSUM_2_0_0).faults == ()  # other files of equal content
    data = tmp_path / "data"
    shutil.copytree(mini, data)
    summary = json.loads((data / "dataset.json").read_text())
    summary["config"]["curve_scenes"] = 0
    (data / "dataset.json").write_text(json.dumps(summary))
    without = chosen(truth, lambda name: not name.startswith("curves"))
    assert only(checked(without, data), "unknown-track").actual == 'tracks has "curves"'


def test_no_position_and_no_motion_are_no_faults(checked: Callable[..., Report], truth: Predictions) -> None:
    for motions, predicts in ((Pose(truth.motions.wxyz, np.zeros((len(truth), 3))), "rotation"),
                              (Pose.identity((len(truth),)), "pose")):  # fmt: skip
        predictions = Predictions(truth.query_ids, motions, truth.confidence, truth.seconds)
        assert checked(predictions, predicts=predicts).faults == ()


def test_anything_but_a_dataset_is_refused(mini: Path, truth: Predictions, tmp_path: Path) -> None:
    write_predictions(tmp_path / "p.csv", truth)
    with pytest.raises(InputError, match="no dataset"):
        check(tmp_path / "p.csv", tmp_path)
    with pytest.raises(InputError, match="did you mean test"):
        check(tmp_path / "p.csv", mini, "tset")
    assert main(["check", str(tmp_path / "p.csv"), "--data", str(tmp_path)]) == 2
    for content in (b"", b"\xff", b"query_id,qw,qx,qy,qz,x,y,z,confidence,seconds\n", b"a,b\n1,2\n"):
        (tmp_path / "p.csv").write_bytes(content)
        assert not check(tmp_path / "p.csv", mini).good


N = 120
OPENGL = Pose(np.array([0.0, 1, 0, 0]), np.zeros(3))


def sample_and_motions(seed: int = 0) -> tuple[Sample, Pose]:
    """Parts on a table, their motions into kits, guesses of the usual error, and cameras that look down at them."""
    rng = np.random.default_rng(seed)
    pivots = rng.uniform((-0.15, -0.3, 0), (0.15, -0.03, 0.08), (N, 3))
    tilt = Pose.from_rotvec(rng.normal(0, 0.25, (N, 3)) * (1, 1, 0))
    turns = tilt @ Pose.from_rotvec(rng.uniform(-np.pi, np.pi, (N, 1)) * (0, 0, 1))
    targets = rng.uniform((-0.1, 0.08, 0), (0.1, 0.32, 0.2), (N, 3))
    motions = Pose(turns.wxyz, targets - turns.apply(pivots))
    guesses = (Pose.from_rotvec(rng.normal(0, 0.15, (N, 3))) @ motions).wxyz
    cameras = Pose.from_rotvec(rng.normal((2.4, 0, 0.3), 0.2, (N, 3)), rng.normal((0, -0.5, 0.8), 0.1, (N, 3)))
    guessed = targets + rng.uniform(-0.028, 0.028, (N, 3))
    return Sample(motions, pivots, guessed, guesses, lambda: cameras), motions


def cameras_of(sample: Sample) -> Pose:
    assert sample.cameras is not None
    return sample.cameras()


def faults_of(sample: Sample, motions: Pose, rotation_only: bool = False) -> list[Fault]:
    known = (sample.pivots, sample.guessed, sample.rotations, sample.cameras)
    return motion_faults(Sample(motions, *known), "p.csv", rotation_only)


def in_frame(motions: Pose, world_from_other: Pose) -> Pose:
    return world_from_other.inverse() @ motions @ world_from_other


def about_part(wxyz: np.ndarray, motions: Pose, sample: Sample) -> Pose:
    """Motions with other rotations about the pivots, which end where `motions` takes them."""
    return Pose(wxyz, motions.apply(sample.pivots) - Pose(wxyz, np.zeros((N, 3))).apply(sample.pivots))


MISTAKES: dict[str, Callable[[Pose, Sample], Pose]] = {
    "transposed-suspected": lambda m, s: Pose(quaternion_conjugate(m.wxyz), m.xyz),
    "inverse-suspected": lambda m, s: m.inverse(),
    "pose-suspected": lambda m, s: Pose(m.wxyz, m.apply(s.pivots)),
    "rotation-about-the-part-suspected": lambda m, s: Pose(m.wxyz, m.apply(s.pivots) - s.pivots),
    "scalar-last-suspected": lambda m, s: Pose(np.roll(m.wxyz, -1, axis=1), m.xyz),
    "camera-frame-suspected": lambda m, s: in_frame(m, cameras_of(s)),
    "shifted-rows-suspected": lambda m, s: m[np.roll(np.arange(N), 1)],
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("code", MISTAKES)
def test_each_mistake_is_found_with_the_share_after_its_correction(code: str, seed: int) -> None:
    sample, motions = sample_and_motions(seed)
    assert faults_of(sample, motions) == []
    (found,) = faults_of(sample, MISTAKES[code](motions, sample))
    assert (found.code, found.severity) == (code, "error"), found
    assert "100% lie in them" in found.actual


@pytest.mark.parametrize("rotation_only", [False, True])
@pytest.mark.parametrize(
    ("code", "change"),
    [("transposed-suspected", quaternion_conjugate), ("scalar-last-suspected", lambda q: np.roll(q, -1, axis=1))],
)
def test_wrong_rotations_with_right_positions_are_found_by_the_guesses(
    code: str, change: Callable[[np.ndarray], np.ndarray], rotation_only: bool
) -> None:
    sample, motions = sample_and_motions()
    assert faults_of(sample, Pose(motions.wxyz, np.zeros((N, 3))), rotation_only=True) == []
    (found,) = faults_of(sample, about_part(change(motions.wxyz), motions, sample), rotation_only)
    assert (found.code, found.severity) == (code, "error")


UNKNOWN: dict[str, Callable[[Pose, Sample], Pose]] = {
    "negated": lambda m, s: Pose(m.wxyz, -m.xyz),
    "y up": lambda m, s: in_frame(m, Pose(np.array([np.sqrt(0.5), np.sqrt(0.5), 0, 0]), np.zeros(3))),
    "camera of OpenGL": lambda m, s: in_frame(m, cameras_of(s) @ OPENGL),
    "one motion": lambda m, s: m[np.zeros(N, dtype=int)],
    "an offset": lambda m, s: Pose.from_translation((1.0, 0, 0)) @ m,
}


@pytest.mark.parametrize("case", UNKNOWN)
def test_motions_out_of_the_scene_without_an_explanation_are_a_warning(case: str) -> None:
    sample, motions = sample_and_motions()
    (found,) = faults_of(sample, UNKNOWN[case](motions, sample))
    assert (found.code, found.severity) == ("far-from-kits", "warning")


def test_a_bad_method_is_no_fault() -> None:
    sample, motions = sample_and_motions()
    rng = np.random.default_rng(8)
    places = rng.uniform((-0.1, 0.08, 0), (0.1, 0.32, 0.2), (N, 3))  # any kit
    anyhow = Pose(rng.standard_normal((N, 4)), np.zeros(3))
    assert faults_of(sample, Pose(anyhow.wxyz, places - anyhow.apply(sample.pivots))) == []
    slip = Pose.from_rotvec(rng.normal(0, 0.2, (N, 3)), rng.normal(0, 0.02, (N, 3)))
    assert faults_of(sample, slip @ motions) == []
    signs = np.where(np.arange(N) % 2, -1.0, 1.0)[:, None]
    assert faults_of(sample, Pose(motions.wxyz * signs, motions.xyz)) == []


def test_a_goal_is_within_the_distance_that_counts_as_a_kit() -> None:
    assert np.sqrt(3) * 0.028 < IN_KIT


def test_the_camera_of_each_image_is_read_from_the_dataset(mini: Path, tmp_path: Path) -> None:
    dataset = Dataset(mini)
    scenes = [scene for name in ("test", CURVES) for scene in dataset.split(name, truth=True)]
    pairs = [(query, scene.truths[query.id].goal_drawn) for scene in scenes for query in scene.queries]
    motions = Pose.stack([goal for _, goal in pairs])
    cameras = Pose.stack([query.view.world_from_camera for query, _ in pairs])
    ones, ids = np.ones(len(pairs)), tuple(query.id for query, _ in pairs)
    write_predictions(tmp_path / "p.csv", Predictions(ids, in_frame(motions, cameras), ones, ones))
    assert [fault.code for fault in check(tmp_path / "p.csv", mini).errors] == ["camera-frame-suspected"]
