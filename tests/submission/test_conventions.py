"""Rows that are right in another convention: each likely mistake is named with the share of parts in their kits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.reader import Dataset
from kit1000.pose import Pose, quaternion_conjugate
from kit1000.queries.tracks import CURVES
from kit1000.submission import Predictions, check, write_predictions
from kit1000.submission.conventions import IN_KIT, Sample, motion_faults
from kit1000.submission.faults import Fault

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
