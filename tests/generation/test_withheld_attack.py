"""Attacks on withheld goals: what can be learned from several queries, and from everything else in a public folder.

The attacker knows this code, all public files and the distribution of every draw, and lacks the seed. Each attack is
run where it must succeed, to show its strength; a dataset with a withheld test split leaves it nothing to work on.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter
from kit1000.dataset.reader import Dataset
from kit1000.generation.presets import PRESETS
from kit1000.generation.withhold import withheld_preset
from kit1000.pictures.scene_preview import scene_picture
from kit1000.pose import Pose, random_quaternions
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET, draw_ball_error, draw_tilt_error
from kit1000.queries.motions import apply_error, error_of
from kit1000.queries.tracks import CURVES, TRACKS, curve_levels
from kit1000.values import Query
from tests.samples.mini import Published


@dataclass(frozen=True)
class Clue:
    """What one query tells about the goal of its part."""

    query: Query
    goal: Pose | None = None
    """goal_from_now that the guess misses, where the test knows it."""

    @property
    def guess(self) -> Pose:
        assert self.query.guess is not None
        return self.query.guess

    @property
    def levels(self) -> tuple[int, int] | None:
        """Levels of the offset and of the rotation of a query of the curves."""
        if self.query.track != CURVES:
            return None
        varied, level, fixed = curve_levels(self.query.id)
        return (level, fixed) if varied == "pos" else (fixed, level)


def clues_by_part(root: Path, truth: bool, splits: Iterable[str]) -> dict[tuple[str, int], list[Clue]]:
    """The queries of a folder with a guess, by scene and part; with their goals if `truth`."""
    found = defaultdict(list)
    for split in splits:
        for scene in Dataset(root).split(split, truth=truth):
            for query in scene.queries:
                if query.guess is not None:
                    goal = scene.truths[query.id].goal_drawn if truth else None
                    found[query.scene_id, query.part].append(Clue(query, goal))
    return found


def groups(clues: Sequence[Clue]) -> list[tuple[Clue, ...]]:
    """All pairs and triples of queries about a part, of whatever tracks, sensors and levels."""
    return [group for size in (2, 3) for group in combinations(clues, size)]


def from_shared_error(pivots: np.ndarray, guesses: Sequence[Pose]) -> Rotation:
    """Attack on guesses that share an error: the images of three pivots, all off alike, show the goal's rotation."""
    images = np.array([guess.apply(pivot) for guess, pivot in zip(guesses, pivots, strict=True)])
    return Rotation.align_vectors(images - images[0], pivots - pivots[0])[0]


def from_levels(one: Clue, other: Clue) -> Pose | None:
    """Attack on two queries of the curves: along one direction and about one axis, back to the level without error."""
    assert one.levels is not None
    assert other.levels is not None
    (k, j), (other_k, other_j) = one.levels, other.levels
    if (k == other_k) == (j == other_j):
        return None
    pivot = one.query.pivot
    if j == other_j:  # the offset varies; the rotation stays
        target = one.guess.apply(pivot) - (other.guess.apply(pivot) - one.guess.apply(pivot)) * k / (other_k - k)
        return Pose(one.guess.wxyz, target - one.guess.rotate(pivot))
    turn = Pose.from_rotvec((other.guess @ one.guess.inverse()).rotvec() * -j / (other_j - j))
    return Pose((turn @ Pose(one.guess.wxyz, np.zeros(3))).wxyz, np.zeros(3))


def angle_deg(a: np.ndarray | Pose, b: Pose) -> float:
    """The angle [deg] between the rotations of two poses."""
    first = a if isinstance(a, Pose) else Pose(a, np.zeros(3))
    return float(np.degrees(np.linalg.norm((first @ b.inverse()).rotvec())))


def test_a_withheld_folder_has_no_two_queries_to_combine(withheld: Published) -> None:
    clues = clues_by_part(withheld.public, False, ["test-all"])
    assert clues
    assert [group for part in clues.values() for group in groups(part)] == []
    queries = list(Dataset(withheld.public).split("test-all").queries())
    parts = [(query.scene_id, query.part) for query in queries]
    assert len(parts) == len(set(parts))  # also none without a guess beside one with a guess


def test_a_withheld_scene_has_one_track_and_the_images_of_its_sensor_alone(withheld: Published) -> None:
    # A guess about one part would show a track without guesses which slot is left for another part.
    public, full = Dataset(withheld.public), Dataset(withheld.full)
    tracks = {scene.id: {query.track for query in scene.queries} for scene in public.split("test-all")}
    assert {len(names) for names in tracks.values()} == {1}
    for shard in {*public.shards("test").values()}:
        for camera_set in (None, "three"):
            file, whole = public.observation_file(shard, camera_set), full.observation_file(shard, camera_set)
            for scene_id in file.scene_ids:
                (track,) = tracks[scene_id]
                assert {key.rpartition("/")[2] for key in file.view_keys(scene_id)} == {TRACKS[track].sensor}
                assert {key.rpartition("/")[2] for key in whole.view_keys(scene_id)} == {"ideal", "d415", "photoneo"}
    assert len({track for (track,) in tracks.values()}) > 1


def test_scenes_for_training_and_validation_keep_all_tracks_and_sensors(withheld: Published) -> None:
    for split in ("train", "val"):
        scenes = list(Dataset(withheld.public).split(split))
        scanner = {"photoneo"} if split == "val" else set()
        assert {sensor for scene in scenes for sensor in scene.sensors} == {"ideal", "d415"} | scanner
        assert {"snap", "snap-tilt", "snap-d415"} <= {query.track for scene in scenes for query in scene.queries}


def test_a_recording_holds_nothing_but_its_observations(withheld: Published, tmp_path: Path) -> None:
    paths = sorted((withheld.public / "test").glob("*.mcap"))
    assert paths
    for path in paths:
        file = ObservationFile(path)
        with ObservationWriter(tmp_path / path.name) as writer:
            for scene_id in file.scene_ids:
                writer.add(file.observation(scene_id))
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_a_preview_is_drawn_from_the_images_that_are_shown(withheld: Published) -> None:
    file = Dataset(withheld.public).observation_file("test/0000")
    for observation in map(file.observation, file.scene_ids):
        assert observation.preview is not None
        assert np.array_equal(scene_picture(replace(observation, preview=None)), observation.preview)


def test_a_withheld_dataset_has_no_curves() -> None:
    for preset in PRESETS.values():
        assert (withheld_preset(preset).curve_scenes, withheld_preset(preset).one_track) == (0, True)
        assert not preset.one_track


def test_two_queries_of_the_curves_would_give_the_goal_away(mini: Path) -> None:
    (clues,) = clues_by_part(mini, True, ["curves"]).values()
    positions = rotations = 0
    for one, other in combinations(clues, 2):
        found, goal = from_levels(one, other), one.goal
        if found is None or goal is None or one.levels is None or other.levels is None:
            continue
        if one.levels[1] == other.levels[1]:
            pivot = one.query.pivot
            assert np.linalg.norm(found.apply(pivot) - goal.apply(pivot)) < 1e-9
            positions += 1
        else:
            assert angle_deg(found, goal) < 1e-6
            rotations += 1
    assert min(positions, rotations) > 100


def test_three_guesses_that_share_an_error_would_give_the_rotation_away() -> None:
    rng = np.random.default_rng(3)
    for draw in (draw_ball_error, draw_tilt_error):
        goal = Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.1, 0.1, 3))
        pivots, error = rng.uniform(-0.02, 0.02, (3, 3)), draw(rng)
        found = from_shared_error(pivots, [apply_error(goal, pivot, *error) for pivot in pivots])
        assert angle_deg(found.as_quat()[[3, 0, 1, 2]], goal) < 1e-6


def test_no_two_guesses_share_an_error_or_its_direction(mini: Path) -> None:
    tracks = set()
    for clues in clues_by_part(mini, True, ["train", "val", "test-all"]).values():
        errors = []
        for clue in clues:
            assert clue.goal is not None
            errors.append(error_of(clue.guess, clue.goal, clue.query.pivot))
            tracks.add(clue.query.track)
        for (one, turn), (other, other_turn) in combinations(errors, 2):
            assert np.linalg.norm(np.cross(one, other)) > 1e-3 * np.linalg.norm(one) * np.linalg.norm(other)
            assert np.linalg.norm(turn - other_turn) > 1e-4
            assert np.abs(one - other).min() > 1e-6
        for group in groups(clues):
            assert len({tuple(np.round(clue.guess.wxyz, 6)) for clue in group}) == len(group)
    assert tracks == {"snap", "snap-tilt", "snap-d415", "snap-photoneo"}


@pytest.mark.parametrize(("guesses", "position_mm", "rotation_deg"), [(1, 26.9, 13.8), (2, 18.5, 10.2), (3, 15.1, 8.4)])
def test_the_mean_of_several_guesses_would_lie_nearer_than_one(
    guesses: int, position_mm: float, rotation_deg: float
) -> None:
    rng = np.random.default_rng(4)
    draws = [[draw_ball_error(rng) for _ in range(guesses)] for _ in range(1000)]
    offsets = np.array([np.mean([offset for offset, _ in group], axis=0) for group in draws])
    turns = np.array([np.mean([rotvec for _, rotvec in group], axis=0) for group in draws])  # to first order
    assert np.abs(offsets).max() <= MAX_OFFSET
    assert np.linalg.norm(turns, axis=1).max() <= MAX_ANGLE
    assert 1e3 * np.linalg.norm(offsets, axis=1).mean() == pytest.approx(position_mm, rel=0.05)
    assert np.degrees(np.linalg.norm(turns, axis=1).mean()) == pytest.approx(rotation_deg, rel=0.05)
