"""Tests of recorded scenes: found by id, and rendered again from the truth with images equal to the bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.json_rows import pose_row
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.sim.cameras import CAMERA, camera_set
from kit1000.sim.sensors import DEPTH_GRID, SENSORS
from kit1000.values import ASSEMBLY_LABEL, View
from tests.samples.mini import MINI


@pytest.fixture(scope="module")
def recorded(mini: Path) -> RecordedScene:
    return Dataset(mini).recorded_scene("test-s0000")


def assert_same(found: View, wanted: View) -> None:
    """Whether two views are equal to the bit, poses included."""
    assert found.camera == wanted.camera
    assert np.array_equal(found.depth, wanted.depth)
    assert np.array_equal(found.world_from_camera.wxyz, wanted.world_from_camera.wxyz)
    assert np.array_equal(found.world_from_camera.xyz, wanted.world_from_camera.xyz)


def test_a_scene_of_any_split_is_found_by_its_id(mini: Path) -> None:
    dataset = Dataset(mini)
    for scene_id in ("train-s0000", "train-s0001", "val-s0000", "test-s0000"):
        found = dataset.recorded_scene(scene_id)
        split = dataset.split("test-all" if scene_id.startswith("test") else scene_id.partition("-")[0])
        assert [query.id for query in found.queries] == [query.id for query in split.scene(scene_id).queries]
        assert found.truths.keys() == {query.id for query in found.queries}


def test_an_unknown_scene_is_answered_with_the_closest_one(mini: Path) -> None:
    with pytest.raises(InputError, match=r"no scene 'tets-s0000' among 4; did you mean test-s0000\?$"):
        Dataset(mini).recorded_scene("tets-s0000")
    with pytest.raises(InputError, match=r"no scene 'nothing' among 4$"):
        Dataset(mini).recorded_scene("nothing")


@pytest.mark.parametrize("scene_id", ["train-s0001", "val-s0000", "test-s0000"])
def test_rendering_the_primary_camera_gives_the_recorded_image(mini: Path, scene_id: str) -> None:
    again = Dataset(mini).recorded_scene(scene_id)
    views = again.render("primary")
    assert list(views) == ["primary"]
    assert_same(views["primary"], again.view("ideal"))


def test_rendering_the_three_cameras_gives_the_recorded_images(recorded: RecordedScene) -> None:
    views = recorded.render("three")
    assert list(views) == ["three/0", "three/1", "three/2"]
    for key, view in views.items():
        assert_same(view, recorded.view(f"{key}/ideal"))


def test_the_seed_of_the_dataset_gives_the_recorded_noise(recorded: RecordedScene) -> None:
    assert_same(recorded.render("three", "d415", MINI.seed)["three/2"], recorded.view("three/2/d415"))


def test_a_sensor_differs_from_the_ideal_one_and_follows_its_seed(recorded: RecordedScene) -> None:
    one, again, other = (recorded.render("primary", "d415", seed)["primary"] for seed in (3, 3, 4))
    assert_same(one, again)
    ideal = recorded.view("ideal").depth
    both = (one.depth > 0) & (other.depth > 0)
    for view in (one, other):
        assert np.mean(view.depth[both] != ideal[both]) > 0.9
        assert np.median(np.abs(view.depth - ideal)[both]) < 0.01
        assert not np.array_equal(view.world_from_camera.xyz, recorded.view("ideal").world_from_camera.xyz)
    assert np.mean(one.depth[both] != other.depth[both]) > 0.8


def test_the_top_camera_sees_both_halves_of_the_table(recorded: RecordedScene) -> None:
    (key, view), *others = recorded.render("top").items()
    assert (key, others) == ("top", [])
    assert_same(view, View(CAMERA, camera_set("top")["top"][1], view.depth))
    points = view.world_from_camera.apply(CAMERA.unproject(view.depth))
    raised = points[(points[..., 2] > 0.008) & (view.depth > 0)]
    for row, body in zip(recorded.truth.parts, recorded.scene.bodies[1:], strict=True):
        assert body.id == row["part_id"]
        near = np.linalg.norm(raised[:, :2] - body.world_from_body.xyz[:2], axis=1) < 0.02
        assert near.sum() > 100
        assert body.world_from_body.xyz[1] < 0
    standing = raised[raised[:, 1] > 0]
    assert len(standing) > 10_000
    assert standing[:, 1].min() > 0.02
    grid = view.depth.astype(np.float64) / DEPTH_GRID
    assert np.array_equal(grid, np.rint(grid))


def test_the_top_camera_agrees_with_the_recorded_image(recorded: RecordedScene) -> None:
    """Points of the kits from the primary camera are on the surface seen by the top camera, or below it."""
    seen, above = recorded.view("ideal"), recorded.render("top")["top"]
    kits = seen.world_from_camera.apply(CAMERA.unproject(seen.depth)[recorded.labels == ASSEMBLY_LABEL])
    local = above.world_from_camera.inverse().apply(kits)
    u, v = np.rint(CAMERA.project(local)).astype(int).T
    found = above.depth[v, u]
    flat = np.abs(found - local[:, 2]) < 2e-3
    assert flat.mean() > 0.5  # upward faces; walls fall between the pixels
    assert np.mean(found > local[:, 2] + 2e-3) < 0.03


def test_invalid_camera_sets_and_sensors_are_refused(mini: Path, recorded: RecordedScene) -> None:
    with pytest.raises(InputError, match="camera set 'tpo': expected one of primary, three, top"):
        recorded.render("tpo")
    with pytest.raises(InputError, match=f"no 'd435', expected one of {', '.join(SENSORS)}"):
        recorded.render("top", "d435")
    with pytest.raises(InputError, match=r"truth was not opened; use dataset.split\('test', truth=True\)"):
        Dataset(mini).split("test").scene("test-s0000").render("top")


def test_the_truth_of_one_query_is_that_of_all_and_reads_no_mesh(
    recorded: RecordedScene, mini: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("kit1000.dataset.geometry.read_glb")
    again = Dataset(mini).recorded_scene("test-s0000")
    assert list(again.truths) == [query.id for query in recorded.queries]
    for query_id, truth in again.truths.items():
        one = Dataset(mini).recorded_scene("test-s0000").truth_of(query_id)
        assert (one.query_id, one.part_id, one.visible) == (truth.query_id, truth.part_id, truth.visible)
        assert pose_row(one.goal_drawn) == pose_row(truth.goal_drawn)
        assert np.array_equal(one.anchor, truth.anchor)


def test_the_truth_of_other_queries_or_without_truth_is_refused(recorded: RecordedScene, mini: Path) -> None:
    with pytest.raises(InputError, match=r"'test-s0000-p9-snap' in test-s0000 of .*did you mean test-s0000"):
        recorded.truth_of("test-s0000-p9-snap")
    with pytest.raises(InputError, match="the truth was not opened"):
        Dataset(mini).split("test").scene("test-s0000").truth_of(recorded.queries[0].id)


def test_the_slot_of_a_part_is_that_of_its_kit(mini: Path) -> None:
    geometry = Dataset(mini).geometry
    for part_id in geometry.kits:
        slot, wanted = geometry.slot(part_id), geometry.kit(part_id).slot
        assert (slot.part_id, slot.clearance, slot.depth) == (wanted.part_id, wanted.clearance, wanted.depth)
        assert slot.goals.matrix().tobytes() == wanted.goals.matrix().tobytes()
