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

from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter
from kit1000.dataset.reader import Dataset
from kit1000.generation.presets import PRESETS
from kit1000.generation.withhold import withheld_preset
from kit1000.pictures.scene_preview import scene_picture
from kit1000.pose import Pose
from kit1000.queries.motions import error_of
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
