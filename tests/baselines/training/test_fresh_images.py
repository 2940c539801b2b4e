"""Images of recorded scenes measured anew: what they show stays where it is."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from baselines.training.tasks.placement.fresh_images import measured_query, recorded_query, rendered_from
from baselines.training.tasks.placement.placed_fits import IMAGES, TRACK, PlacedFits
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.registration.method import Registration
from kit1000.rng import stream
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query, Truth


class Known(NamedTuple):
    scene: RecordedScene
    query: Query
    truth: Truth


@pytest.fixture(scope="module")
def asked(mini: Path) -> Known:
    split = Dataset(mini).split("train", truth=True)
    query = next(query for query in split.queries() if query.track == TRACK)
    scene = split.scene(query.scene_id)
    return Known(scene, query, scene.truth_of(query.id))


def points_of(image: LabelledDepth, label: int) -> np.ndarray:
    """(k, 3) [m] world, where an image shows a label."""
    rows, columns = np.nonzero((image.labels == label) & (image.view.depth > 0))
    seen = image.view.camera.unproject_pixels(np.stack([columns, rows], 1), image.view.depth[rows, columns])
    return image.view.world_from_camera.apply(seen)


@pytest.mark.parametrize("distance", [0.5, 0.7])
def test_a_camera_nearer_shows_the_same_surfaces(asked: Known, distance: float) -> None:
    scene, query, truth = asked
    recorded, image = scene.labelled_depth("ideal"), rendered_from(scene, query, truth, distance)
    assert image is not None
    middle = (truth.anchor + truth.goal_drawn.apply(truth.anchor)) / 2
    there = image.view.world_from_camera
    np.testing.assert_allclose(np.linalg.norm(there.xyz - middle), distance, atol=1e-9)
    axis = (0.0, 0.0, 1.0)
    assert there.rotate(axis) @ recorded.view.world_from_camera.rotate(axis) > 1 - 1e-9
    mesh, world_from_part = scene.bodies()[FIRST_PART_LABEL + query.part]
    part = world_from_part.inverse().apply(points_of(image, FIRST_PART_LABEL + query.part))
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    assert (part > low - 1e-4).all()
    assert (part < high + 1e-4).all()


def test_from_nearer_the_kits_are_larger(asked: Known) -> None:
    images = [rendered_from(*asked, distance) for distance in (0.5, 0.7)]
    nearer, farther = ((image.labels == ASSEMBLY_LABEL).sum() for image in images if image is not None)
    assert nearer > 1.5 * farther


def test_from_too_near_nothing_is_shown(asked: Known) -> None:
    scene, query, truth = asked
    assert rendered_from(scene, query, truth, 0.06) is None


def test_a_query_is_asked_about_its_own_image(asked: Known) -> None:
    scene, query, truth = asked
    asked_eight_times = [measured_query(query, scene, truth, stream(0, "test", str(k))) for k in range(8)]
    drawn = [each.query for each in asked_eight_times]
    again = measured_query(query, scene, truth, stream(0, "test", "0")).query
    np.testing.assert_array_equal(again.view.depth, drawn[0].view.depth)
    assert len({each.view.depth.tobytes() for each in drawn}) == len(drawn)
    assert len({each.view.world_from_camera.xyz.round(2).tobytes() for each in drawn}) > 2
    recorded = recorded_query(query, scene)
    assert recorded.query is query
    for each in (recorded, *asked_eight_times):  # the recorded pose has the error of a hand-eye calibration
        off = each.query.view.world_from_camera.inverse() @ each.world_from_camera
        assert 0 < np.linalg.norm(off.xyz) < 6e-3
        assert off.angle() < np.radians(0.6)
    mesh, world_from_part = scene.bodies()[FIRST_PART_LABEL + query.part]
    off = np.array([each.pivot for each in drawn]) - world_from_part.apply(mesh.vertices).mean(0)
    assert np.linalg.norm(off, axis=1).max() < np.linalg.norm(np.ptp(mesh.vertices, axis=0)) / 2
    assert {(each.sensor, each.id, each.part) for each in drawn} == {("d415", query.id, query.part)}


def test_queries_for_training_are_asked_about_fresh_images_too(mini: Path, tmp_path: Path) -> None:
    registration = Registration(Dataset(mini))
    training, validation = (PlacedFits(registration, split, tmp_path).queries for split in ("train", "val"))
    recorded = [name for name, query in training.items() if name == query.id]
    assert len(training) == IMAGES * len(recorded) > 0
    assert all(name == query.id for name, query in validation.items())
