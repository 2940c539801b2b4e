"""A public folder with a withheld test split leaves no two queries to combine, and no image beside those shown.

Several guesses about one part share its goal, so whoever combines them comes closer to it than each guess is.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from kit1000.dataset.mcap_io import ObservationFile, ObservationWriter
from kit1000.dataset.reader import Dataset
from kit1000.generation.presets import PRESETS
from kit1000.generation.withhold import withheld_preset
from kit1000.pictures.scene_preview import scene_picture
from kit1000.queries.tracks import TRACKS
from tests.samples.mini import Published


def test_a_withheld_folder_has_no_two_queries_about_a_part(withheld: Published) -> None:
    queries = list(Dataset(withheld.public).split("test-all").queries())
    parts = [(query.scene_id, query.part) for query in queries]
    assert parts
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
