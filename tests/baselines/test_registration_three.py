"""Several images of one scene: what they show together, the labels that one lends the others, and registration."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.registration_three import FourCameras
from kit1000.camera import Camera, look_at
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError
from kit1000.mesh import mesh_from_solid
from kit1000.perception.observed.columns import MaskedView, observed_distance
from kit1000.perception.observed.parts import ObservedPart
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, Query, View
from kit1000.voxels import Grid, signed_distance, tsdf
from tests.samples.shapes import MM, box

CAMERA = Camera(width=400, height=300, fx=500.0, fy=500.0, cx=199.5, cy=149.5)
EYES = [look_at(eye, (0, 0, 0.01)) for eye in ((0.3, 0.1, 0.5), (-0.35, 0.2, 0.4), (0.05, -0.4, 0.35))]
VOXEL = 1e-3
TABLE = mesh_from_solid(box(600, 600, 20, (0, 0, -20))).scaled(MM)
TEE = mesh_from_solid(box(36, 30, 8, (0, 0, 22)) + box(10, 10, 24)).scaled(MM)
GRID = Grid.centred(Pose.from_translation((0, 0, 0.015)), (50, 50, 40), VOXEL)


def image_from(eye: Pose) -> LabelledDepth:
    rendered = render(CAMERA, eye, [(TABLE, Pose.identity()), (TEE, Pose.identity())], 1)
    labels = np.where(rendered.body_ids > 1, FIRST_PART_LABEL, 0).astype(np.uint8)
    return LabelledDepth(View(CAMERA, eye, rendered.depth), labels)


@cache
def images() -> list[LabelledDepth]:
    return [image_from(eye) for eye in EYES]


@cache
def masked() -> list[MaskedView]:
    return [MaskedView.of(image, FIRST_PART_LABEL) for image in images()]


@given(st.permutations(range(3)), st.integers(1, 3))
@settings(max_examples=10)
def test_images_show_together_what_any_of_them_shows(order: list[int], count: int) -> None:
    chosen = [masked()[i] for i in order[:count]]
    single = np.stack([tsdf(GRID, image.view, image.mask, threads=1).values for image in chosen])
    together = observed_distance(GRID, chosen).values
    assert (np.isnan(together) == np.isnan(single).all(0)).all()
    free = (single > 0).any(0)
    assert ((together > 0) == free).all()
    assert (together[free] == np.where(single > 0, single, np.inf).min(0)[free]).all()
    behind = ~free & ~np.isnan(together)
    assert (together[behind] == np.fmax.reduce(single)[behind]).all()


def test_more_images_leave_less_to_guess() -> None:
    part = ObservedPart(images()[0], FIRST_PART_LABEL, np.array([0, 0, 0.02]))
    several = replace(part, others=tuple(images()[1:]))
    wrong = []
    for observed in (part, several):
        volume = observed.volume(VOXEL)
        exact = signed_distance(volume.grid, [(TEE, Pose.identity())], threads=1)
        wrong.append(((volume.values < 0) != (exact.values < 0)).sum() / (exact.values < 0).sum())
    assert wrong[1] < 0.5 * wrong[0]  # below the wide top one image leaves all to guess


@pytest.fixture(scope="module")
def queries(mini: Path) -> list[Query]:
    return [query for query in Dataset(mini).split("test").queries() if query.track == "snap"]


def test_labels_of_other_cameras_are_those_of_the_bodies(mini: Path) -> None:
    """Rendered with the truth: pixels of the part and of the kits."""
    dataset = Dataset(mini)
    scene = next(iter(dataset.split("test-all", truth=True)))
    query = next(query for query in scene.queries if query.track == "snap")
    bodies = scene.bodies()
    for image in FourCameras(dataset).others(query):
        ids = render(image.view.camera, image.view.world_from_camera, bodies, 1).body_ids
        for label, body in ((FIRST_PART_LABEL + query.part, 2 + query.part), (ASSEMBLY_LABEL, 1)):
            found, true = image.labels == label, ids == 1 + body
            assert (found & true).sum() / (found | true).sum() > 0.9, (label, body)


def test_four_cameras_seat_the_parts_of_a_scene(mini: Path, queries: list[Query]) -> None:
    dataset = Dataset(mini)
    method = FourCameras(dataset)
    split = dataset.split("test-all", truth=True)
    query = queries[0]
    truth = split.scene(query.scene_id).truth_of(query.id)
    motion = method(query).goal_from_now
    moved = [pose.apply(query.pivot) for pose in (motion, truth.goal_drawn)]
    assert np.linalg.norm(moved[0] - moved[1]) < 1.5e-3


def test_a_scene_without_the_three_cameras_is_refused(mini: Path) -> None:
    dataset = Dataset(mini)
    with pytest.raises(InputError, match="three"):
        FourCameras(dataset)(next(dataset.split("val").queries()))
