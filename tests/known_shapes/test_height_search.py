"""The search for places: true places have the highest scores, wherever the shape lies and however it is rotated."""

from __future__ import annotations

import numpy as np
import pytest

from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.height_search import CELL, HeightGrid, views_from_above
from kit1000.known_shapes.shapes import ShapeDistance, StandingShape
from kit1000.known_shapes.support import seen_support
from kit1000.perception.sensor_facts import SensorFacts
from tests.samples.labelled_scenes import sample_scene

SCENE = sample_scene()
IMAGE = DisparityImage.of(SCENE.image, SensorFacts(fattening_px=0.0), seen_support(SCENE.image))


@pytest.fixture(scope="module")
def grid() -> HeightGrid:
    found = HeightGrid.of(IMAGE, SCENE.image.labels)
    assert found is not None
    return found


def true_place(name: str) -> StandingShape:
    number = [part.id for part in SCENE.kits.parts].index(name)
    pose = SCENE.camera_from_world @ SCENE.world_from_parts[number]
    return StandingShape.by_pose(SCENE.kits.shape(name), IMAGE.support, pose)


@pytest.mark.parametrize("name", ["bracket", "tee"])
@pytest.mark.parametrize("masked", [True, False])
def test_the_true_place_is_among_the_best(grid: HeightGrid, name: str, masked: bool) -> None:
    true = true_place(name)
    number = [part.id for part in SCENE.kits.parts].index(name)
    searched = grid.of_mask(2 + number) if masked else grid
    assert searched is not None
    places = searched.places(true.shape, views_from_above(true.shape, 24), 40, 20, 8)
    assert places == sorted(places, key=lambda place: -place.score)
    distance = ShapeDistance(true.shape.mesh)
    nearest = min(distance.between(true.camera_from_body(), place.shape.camera_from_body()) for place in places)
    assert nearest < 3 * CELL
    assert places[0].score <= 1 + 1e-9


def test_what_is_taken_away_is_found_no_more(grid: HeightGrid) -> None:
    tee = true_place("tee")
    assert grid.footprint(tee).sum() * CELL**2 > 1e-4
    left = grid.without([tee])
    assert not (left.seen & grid.footprint(tee)).any()
    (middle,) = (np.round((tee.place[:2] - grid.corner) / CELL - 0.5).astype(int),)
    for place in left.places(tee.shape, views_from_above(tee.shape, 24), 40, 20, 8):
        assert np.hypot(*(place.shape.place[:2] - tee.place[:2])) > CELL or not grid.seen[tuple(middle)]
