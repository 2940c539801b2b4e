"""The method registration-known: it reads shapes and no pose, and seats parts whose images are exact."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.own_scenes import OWN
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.known_shapes import predictor as module
from kit1000.known_shapes.predictor import KnownShapeRegistration
from kit1000.metrics import seatings
from kit1000.pose import Pose
from kit1000.prediction.making import method_of
from kit1000.prediction.predict import RunConfig, predict
from kit1000.registration.predictor import stated_clearances
from kit1000.values import FIRST_PART_LABEL, SceneShapes
from tests.samples.labelled_scenes import own_folder, shapes_folder
from tests.samples.own_images import box


def test_a_method_gets_meshes_without_poses(mini: Path) -> None:
    scene = next(iter(Dataset(mini).split("test", truth=True)))
    shapes = scene.shapes
    assert sorted(shapes.parts) == list(shapes.parts)
    assert set(shapes.parts) == {body.id for body in scene.scene.bodies[1:]}
    assert [field.name for field in fields(SceneShapes)] == ["assembly", "parts", "clearances", "goals"]
    assert not shapes.clearances
    assert not shapes.goals
    assert method_of("registration-known").reads == "shapes"


def test_parts_are_seated_by_exact_images(mini: Path) -> None:
    dataset = Dataset(mini)
    split, predictor = dataset.split("test", truth=True), KnownShapeRegistration(dataset)
    queries = list(split.queries("snap"))[:3]
    scenes = [split.scene(query.scene_id) for query in queries]
    found = [predictor(query, scene.shapes) for query, scene in zip(queries, scenes, strict=True)]
    truths = [scene.truth_of(query.id) for query, scene in zip(queries, scenes, strict=True)]
    seated = seatings(Pose.stack([each.goal_from_now for each in found]), truths, dataset.geometry).seated
    assert seated.mean() > 0.6
    assert all(0 < each.confidence <= 1 for each in found)


def test_the_page_gets_the_same_insertion_and_the_shapes_where_they_are(mini: Path) -> None:
    dataset = Dataset(mini)
    split, predictor = dataset.split("test", truth=True), KnownShapeRegistration(dataset)
    query = next(iter(split.queries("snap")))
    scene = split.scene(query.scene_id)
    proposed = predictor.propose(query, scene.shapes)
    assert np.array_equal(proposed[0].goal_from_now.matrix(), predictor(query, scene.shapes).goal_from_now.matrix())
    assert all(each.confidence <= proposed[0].confidence for each in proposed)
    found = predictor.find([query], scene.shapes)
    kits, true = found.kits.mesh, scene.bodies()[1]
    assert np.abs(kits.bounds - true[0].moved(true[1]).bounds).max() < 2e-3
    names = {shape.name for shape in found.parts.values()}
    assert names | {*found.missing} == {*scene.shapes.parts}
    assert len(found.parts) + len(found.missing) == len(scene.shapes.parts)
    elsewhere = replace(query, pivot=query.pivot + (0.0, 0.0, 0.3))
    unmasked = predictor.find([elsewhere], scene.shapes).parts  # no shape is there
    assert {shape.name for shape in unmasked.values()} == names
    assert min(unmasked) == query.image.labels.max() - FIRST_PART_LABEL + 1
    more = replace(scene.shapes, parts={**scene.shapes.parts, "crate": box((0.1, 0.1, 0.1), (0.0, 0.0))})
    assert KnownShapeRegistration(dataset).find([query], more).missing == ("crate",)


def test_a_part_goes_where_the_files_of_its_kit_show_it(mini: Path) -> None:
    """Whatever face it lies on, and by the goal nearest to the guess; without one by the shortest way in the camera."""
    dataset = Dataset(mini)
    split, predictor = dataset.split("test", truth=True), KnownShapeRegistration(dataset)
    query = next(iter(split.queries("snap")))
    scene = split.scene(query.scene_id)
    slot = Pose.from_rotvec((0.0, 0.0, 0.3), (0.01, 0.02, 0.03))
    both = Pose.stack([slot, slot @ Pose.from_rotvec((0.0, 0.0, np.pi), (0.0, 0.0, 0.0))])
    shapes = replace(scene.shapes, goals=dict.fromkeys(scene.shapes.parts, both))
    motions = predictor.propose(replace(query, guess=None), shapes)
    for k, (motion, _) in enumerate(motions):
        again = predictor.propose(replace(query, guess=motion), shapes)[0].goal_from_now
        assert np.allclose(again.matrix(), motion.matrix()), k
    camera = query.image.view.world_from_camera
    lengths = [np.linalg.norm((camera.inverse() @ motion @ camera).xyz) for motion, _ in motions]
    assert lengths == sorted(lengths)
    found = predictor.find([query], shapes)
    name, seated = found.parts[query.part].name, found.parts[query.part].mesh.moved(motions[0].goal_from_now)
    world_from_kits = scene.bodies()[1][1]
    wanted = [scene.shapes.parts[name].moved(world_from_kits @ goal) for goal in both]
    assert min(np.abs(each.vertices - seated.vertices).max() for each in wanted) < 2e-3


def test_a_stated_clearance_is_the_only_one_that_is_tried(mini: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[tuple[float, ...]] = []
    monkeypatch.setattr(module, "fits_in", lambda scene, clearances: tried.append(clearances) or [])
    dataset = Dataset(mini)
    split, predictor = dataset.split("test", truth=True), KnownShapeRegistration(dataset)
    query = next(iter(split.queries("snap")))
    shapes = split.scene(query.scene_id).shapes
    predictor(query, replace(shapes, clearances=dict.fromkeys(shapes.parts, 0.4e-3)))
    predictor(query, shapes)
    assert tried == [(0.4e-3,), stated_clearances(dataset)]


def test_an_image_that_shows_nothing_gets_the_guess_and_is_told_once(
    mini: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = Dataset(mini)
    split = dataset.split("test", truth=True)
    query = next(iter(split.queries("snap")))
    image = query.image
    view = type(image.view)(image.view.camera, image.view.world_from_camera, np.zeros_like(image.view.depth))
    blind = replace(query, read_image=lambda: type(image)(view, image.labels))
    predictor, shapes = KnownShapeRegistration(dataset), split.scene(query.scene_id).shapes
    motion, confidence = [predictor(blind, shapes) for _ in range(2)][1]
    assert confidence == 0
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith(f"{query.scene_id}: ")
    with pytest.raises(InputError):
        predictor.propose(blind, shapes)  # a person at the page sees why
    assert query.guess is not None
    assert np.array_equal(motion.matrix(), query.guess.matrix())
    with pytest.raises(InputError, match="--shapes"):
        KnownShapeRegistration(dataset)(query, None)


def test_the_runner_hands_over_the_shapes(mini: Path, tmp_path: Path) -> None:
    config = RunConfig.of("registration-known", "given", ("test",), ("snap",), limit=1)
    submission = predict(config, mini, tmp_path / "out", workers=1)
    assert submission.manifest.reads == "shapes"
    assert not submission.manifest.uses_true_geometry


def test_rows_on_own_scenes_state_found_masks(tmp_path: Path) -> None:
    root = own_folder(tmp_path / "mine")
    shapes_folder(tmp_path / "shapes")
    path = root / "dataset.json"
    path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | {OWN: {}}), encoding="utf-8")
    config = RunConfig.of("registration-known", "given", ("test",), None, limit=1, shapes=tmp_path / "shapes")
    submission = predict(config, root, tmp_path / "out", workers=1)
    assert (submission.manifest.reads, submission.manifest.masks) == ("shapes", "predicted")
