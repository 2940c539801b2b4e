"""The method registration-known: it reads shapes and no pose, and seats parts whose images are exact."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.known_shapes.predictor import KnownShapeRegistration
from kit1000.metrics import seatings
from kit1000.pose import Pose
from kit1000.prediction.making import method_of
from kit1000.prediction.predict import RunConfig, predict
from kit1000.values import SceneShapes


def test_a_method_gets_meshes_without_poses(mini: Path) -> None:
    scene = next(iter(Dataset(mini).split("test", truth=True)))
    shapes = scene.shapes
    assert sorted(shapes.parts) == list(shapes.parts)
    assert set(shapes.parts) == {body.id for body in scene.scene.bodies[1:]}
    assert [field.name for field in fields(SceneShapes)] == ["assembly", "parts"]
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


def test_an_image_that_shows_nothing_gets_the_guess(mini: Path) -> None:
    dataset = Dataset(mini)
    split = dataset.split("test", truth=True)
    query = next(iter(split.queries("snap")))
    image = query.image
    view = type(image.view)(image.view.camera, image.view.world_from_camera, np.zeros_like(image.view.depth))
    blind = replace(query, read_image=lambda: type(image)(view, image.labels))
    motion, confidence = KnownShapeRegistration(dataset)(blind, split.scene(query.scene_id).shapes)
    assert confidence == 0
    assert query.guess is not None
    assert np.array_equal(motion.matrix(), query.guess.matrix())
    with pytest.raises(InputError, match="--shapes"):
        KnownShapeRegistration(dataset)(query, None)


def test_the_runner_hands_over_the_shapes(mini: Path, tmp_path: Path) -> None:
    config = RunConfig.of("registration-known", "given", ("test",), ("snap",), limit=1)
    submission = predict(config, mini, tmp_path / "out", workers=1)
    assert submission.manifest.reads == "shapes"
    assert not submission.manifest.uses_true_geometry
