"""Rows that are right in another convention: each known mistake is named with the share that would lie in the kits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kit1000.cli import main
from kit1000.dataset.reader import Dataset
from kit1000.pose import Pose, quaternion_conjugate
from kit1000.queries.tracks import CURVES
from kit1000.submission import Predictions, check, read_predictions, write_predictions
from kit1000.submission.conventions import IN_KIT, OPENGL, Z_UP, Finding, Sample, convention_findings
from tests.samples.foreign_files import cases

N = 120
ROWS = np.arange(N)
HEADER = "query_id,qw,qx,qy,qz,x,y,z,confidence,seconds"


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
    return Sample(motions, pivots, guessed, guesses, ROWS, ROWS, lambda rows: cameras[rows]), motions


def read(sample: Sample, motions: Pose) -> list[Finding]:
    known = (sample.pivots, sample.guessed, sample.rotations, sample.parts, sample.rows, sample.read_cameras)
    return list(convention_findings(Sample(motions, *known)))


def in_frame(motions: Pose, world_from_other: Pose) -> Pose:
    return world_from_other.inverse() @ motions @ world_from_other


def mirrored(motions: Pose, matrix: np.ndarray) -> Pose:
    return Pose.from_rotation_matrix(matrix @ motions.rotation_matrix() @ matrix, motions.xyz @ matrix.T)


MISTAKES: dict[str, Callable[[Pose, Sample], Pose]] = {
    "transposed-suspected": lambda m, s: Pose(quaternion_conjugate(m.wxyz), m.xyz),
    "inverse-suspected": lambda m, s: m.inverse(),
    "pose-suspected": lambda m, s: Pose(m.wxyz, m.apply(s.pivots)),
    "rotation-about-the-part-suspected": lambda m, s: Pose(m.wxyz, m.apply(s.pivots) - s.pivots),
    "scalar-last-suspected": lambda m, s: Pose(np.roll(m.wxyz, -1, axis=1), m.xyz),
    "negated-suspected": lambda m, s: Pose(m.wxyz, -m.xyz),
    "y-up-suspected": lambda m, s: in_frame(m, Z_UP),
    "camera-frame-suspected": lambda m, s: in_frame(m, s.cameras),
    "opengl-camera-suspected": lambda m, s: in_frame(m, s.cameras @ OPENGL),
    "camera-pose-suspected": lambda m, s: Pose(m.wxyz, s.cameras.inverse().apply(m.apply(s.pivots))),
    "left-handed-suspected": lambda m, s: mirrored(m, np.eye(3)[[0, 2, 1]]),
    "shifted-rows-suspected": lambda m, s: m[np.roll(ROWS, 1)],
    "offset-suspected": lambda m, s: Pose.from_translation((1.0, 0, 0)) @ m,
    "other-origin-suspected": lambda m, s: in_frame(m, Pose.from_translation((0.4, -0.1, 0.7))),
    "degrees-suspected": lambda m, s: Pose.from_rotvec(np.degrees(m.rotvec()), m.xyz),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("code", MISTAKES)
def test_each_mistake_is_found_alone_with_the_share_that_would_fit(code: str, seed: int) -> None:
    sample, motions = sample_and_motions(seed)
    assert read(sample, motions) == []
    (found,) = read(sample, MISTAKES[code](motions, sample))
    assert (found.code, found.is_error) == (code, True), found
    assert "(100% lie in them then)" in found.actual
    assert found.repair


@pytest.mark.parametrize("axis", range(3))
def test_any_reversed_axis_is_found(axis: int) -> None:
    sample, motions = sample_and_motions()
    matrix = np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))
    (found,) = read(sample, mirrored(motions, matrix))
    assert found.code == "left-handed-suspected"
    assert f"{'xyz'[axis]} reversed" in found.actual


def test_rotations_that_are_transposed_about_the_part_are_found_by_the_guesses() -> None:
    sample, motions = sample_and_motions()
    back = quaternion_conjugate(motions.wxyz)
    wrong = Pose(back, motions.apply(sample.pivots) - Pose(back, np.zeros(3)).apply(sample.pivots))
    (found,) = read(sample, wrong)
    assert (found.code, found.is_error) == ("transposed-suspected", True)
    assert "degrees from the guesses" in found.actual


def test_one_motion_for_all_rows_is_a_warning() -> None:
    sample, motions = sample_and_motions()
    (found,) = read(sample, motions[np.zeros(N, dtype=int)])
    assert (found.code, found.is_error) == ("same-motion", False)


def test_motions_out_of_the_scene_without_an_explanation_are_a_warning() -> None:
    sample, _ = sample_and_motions()
    rng = np.random.default_rng(7)
    (found,) = read(sample, Pose(rng.normal(size=(N, 4)), rng.normal(size=(N, 3))))
    assert (found.code, found.is_error) == ("far-from-kits", False)


def test_a_bad_method_is_no_fault() -> None:
    sample, motions = sample_and_motions()
    rng = np.random.default_rng(8)
    places = rng.uniform((-0.1, 0.08, 0), (0.1, 0.32, 0.2), (N, 3))  # any kit
    anyhow = Pose(rng.standard_normal((N, 4)), np.zeros(3))
    assert read(sample, Pose(anyhow.wxyz, places - anyhow.apply(sample.pivots))) == []
    assert read(sample, Pose.identity((N,))) == []
    slip = Pose.from_rotvec(rng.normal(0, 0.2, (N, 3)), rng.normal(0, 0.02, (N, 3)))
    assert read(sample, slip @ motions) == []


def test_a_goal_is_within_the_distance_that_counts_as_a_kit() -> None:
    assert np.sqrt(3) * 0.028 < IN_KIT


@pytest.mark.parametrize("line", ["sep=,", '"sep=,"', "SEP=,", "sep=;", "sep=,,,,,,,,,"])
def test_the_line_of_a_spreadsheet_is_skipped_with_a_warning(line: str, tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text(f"{line}\n{HEADER}\ntest-s0000-p0-snap,1.0,0.0,0.0,0.0,0.1,-0.25,0.05,0.9,0.5\n")
    report = check(path)
    assert [(fault.code, fault.line, fault.severity) for fault in report.faults] == [("separator-line", 1, "warning")]
    assert report.rows == 1
    assert len(read_predictions(path)) == 1


def test_the_cases_of_the_shared_folder_are_found() -> None:
    folder = cases()
    if folder is None:
        pytest.skip("the folder of cases is absent")
    report = check(folder / "sep-line.csv")
    assert (report.rows, report.good) == (30, True)
    assert "separator-line" in [fault.code for fault in report.faults]


def test_the_camera_of_each_image_is_read_from_the_dataset(mini: Path, tmp_path: Path) -> None:
    dataset = Dataset(mini)
    scenes = [scene for name in ("test", CURVES) for scene in dataset.split(name, truth=True)]
    pairs = [(query, scene.truths[query.id].goal_drawn) for scene in scenes for query in scene.queries]
    motions = Pose.stack([goal for _, goal in pairs])
    cameras = Pose.stack([query.view.world_from_camera for query, _ in pairs])
    ones = np.ones(len(pairs))
    ids = tuple(query.id for query, _ in pairs)
    write_predictions(tmp_path / "p.csv", Predictions(ids, in_frame(motions, cameras), ones, ones))
    report = check(tmp_path / "p.csv", mini)
    assert "camera-frame-suspected" in [fault.code for fault in report.errors], str(report)
    assert main(["check", str(tmp_path / "p.csv"), "--data", str(mini)]) == 1
