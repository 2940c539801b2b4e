"""Patches: an image and the cavity of a fit on one grid, wherever the scene stands, and moves in its frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from kit1000.perception.placement import CELL, CELLS, Channel
from kit1000.pose import Pose
from kit1000.registration.image_refine import PlatePatch, plate_patch
from kit1000.registration.prepared_image import RestoredImage
from kit1000.registration.search import Candidate
from kit1000.values import LabelledDepth
from kit1000.voxels import Volume
from tests.samples.registration_cases import CASES, CLEARANCE, case, known_shape
from tests.samples.registration_images import CAMERA, image_of, moved
from tests.samples.strategies import poses

DEEP = 0.4  # [px] below the face


def patch_in(
    image: LabelledDepth,
    part: Volume,
    middle: np.ndarray,
    candidate: Candidate,
    measured: LabelledDepth | None = None,
) -> PlatePatch | None:
    """The patch of a fit of a known part."""
    gain = CAMERA.fx * 0.055
    return plate_patch(
        known_shape(part, middle), RestoredImage(image, measured or image, gain), candidate, CLEARANCE, CELLS
    )


def patch_of(
    name: str, candidate: Candidate, image: LabelledDepth | None = None, measured: LabelledDepth | None = None
) -> PlatePatch:
    patch = patch_in(image or image_of(name), case(name).part, case(name).pivot, candidate, measured)
    assert patch is not None
    return patch


@pytest.mark.parametrize("name", CASES)
def test_at_the_goal_the_image_shows_the_cavity_of_the_fit(name: str) -> None:
    channels = patch_of(name, moved(case(name), 0, 0, 0)).channels
    shown, cavity = channels[Channel.RESTORED], channels[Channel.CAVITY]
    inside = cavity < -DEEP
    assert np.count_nonzero(inside) > 100
    assert np.median(np.abs(shown - cavity)[inside]) < 0.1
    plate = (channels[Channel.IS_RESTORED] == 1) & (cavity > -0.02)
    assert np.median(np.abs(shown[plate])) < 0.1
    np.testing.assert_array_equal(shown, channels[Channel.MEASURED])  # no other image is given


@pytest.mark.parametrize("name", CASES)
def test_a_moved_fit_moves_its_cavity_and_not_the_plate(name: str) -> None:
    here, there = (patch_of(name, moved(case(name), x, 0, 0)) for x in (0, 4))
    apart = np.abs(there.channels[Channel.CAVITY] - here.channels[Channel.CAVITY])
    assert apart.mean() < 0.03  # it lies in the middle of both
    about = np.linalg.norm(there.world_from_patch.xyz - here.world_from_patch.xyz)
    assert about == pytest.approx(4e-3, abs=1e-4)
    inside = here.channels[Channel.CAVITY] < -DEEP
    apart = np.abs(there.channels[Channel.RESTORED] - there.channels[Channel.CAVITY])[inside].mean()
    assert apart > 2 * np.abs(here.channels[Channel.RESTORED] - here.channels[Channel.CAVITY])[inside].mean()


@given(world=poses())
def test_a_patch_is_the_same_wherever_the_scene_stands(world: Pose) -> None:
    known, image, start = case("an L"), image_of("an L"), moved(case("an L"), 1.0, 1.0, 2.0)
    here = patch_of("an L", start)
    view = replace(image.view, world_from_camera=world @ image.view.world_from_camera)
    cavity = replace(start.cavity, world_from_plate=world @ start.cavity.world_from_plate)
    there = replace(start, cavity=cavity, plate_from_now=start.plate_from_now @ world.inverse())
    grid = replace(known.part.grid, world_from_grid=world @ known.part.grid.world_from_grid)
    moved_image, part = LabelledDepth(view, image.labels), Volume(grid, known.part.values)
    patch = patch_in(moved_image, part, world.apply(known.pivot), there)
    assert patch is not None
    assert (np.abs(patch.channels - here.channels) > 0.02).mean() < 1e-3
    np.testing.assert_allclose(patch.world_from_patch.matrix(), (world @ here.world_from_patch).matrix(), atol=1e-6)


@given(goal=poses(), fit=poses(), frame=poses())
def test_the_twist_of_a_fit_ends_at_the_truth(goal: Pose, fit: Pose, frame: Pose) -> None:
    patch, middle = PlatePatch(np.zeros((len(Channel), 1, 1), np.float32), frame), np.array([0.1, -0.2, 0.3])
    twist = patch.twist_to(goal, fit, middle)
    pivot = (frame.inverse() @ fit).apply(middle)
    there = Pose.from_rotvec(twist[:3], pivot + twist[3:]) @ Pose.from_translation(-pivot)
    np.testing.assert_allclose((frame @ there @ frame.inverse() @ fit).matrix(), goal.matrix(), atol=1e-8)


def test_a_shift_is_along_the_patch() -> None:
    known, start = case("an L"), moved(case("an L"), 0, 0, 0)
    patch = patch_of("an L", start)
    goal = start.cavity.world_from_plate @ start.plate_from_now
    there = patch.moved(goal, known.pivot, np.array([0, 1e-3, 0]))
    away = patch.world_from_patch.inverse().rotate(there.apply(known.pivot) - goal.apply(known.pivot))
    np.testing.assert_allclose(away, (1e-3, 0, 0), atol=1e-12)
    camera = patch.world_from_patch.inverse().apply(image_of("an L").view.world_from_camera.xyz)
    assert camera[0] < 0 < camera[2]  # in front, and above the plate
    assert abs(camera[1]) < 1e-9


def test_the_measured_image_is_read_beside_the_restored_one() -> None:
    restored, measured = image_of("an L"), image_of("an L", noise_px=0.3)
    channels = patch_of("an L", moved(case("an L"), 0, 0, 0), restored, measured).channels
    assert 0.05 < np.std(channels[Channel.MEASURED] - channels[Channel.RESTORED]) < 1.0


@pytest.mark.parametrize("what", ["no kit", "no return"])
def test_what_the_image_does_not_show_is_none_of_the_patch(what: str) -> None:
    image = image_of("an L")
    view, labels = image.view, image.labels
    if what == "no kit":
        labels = np.zeros_like(labels)
    else:
        view = replace(view, depth=np.zeros_like(view.depth))
    channels = patch_of("an L", moved(case("an L"), 0, 0, 0), LabelledDepth(view, labels)).channels
    assert not channels[: Channel.CAVITY].any()
    assert channels[Channel.CAVITY].any()


def test_a_plate_that_the_camera_sees_from_below_has_no_patch() -> None:
    known, image = case("an L"), image_of("an L")
    start = moved(known, 0, 0, 0)
    below = start.cavity.world_from_plate.apply(np.array([0.0, 0.0, -0.7]))
    pose = replace(image.view.world_from_camera, xyz=below)
    under = LabelledDepth(replace(image.view, world_from_camera=pose), image.labels)
    assert patch_in(under, known.part, known.pivot, start) is None


def test_the_relief_is_seen_from_above() -> None:
    start = moved(case("an L"), 0, 0, 0)
    relief = patch_of("an L", start).channels[Channel.HEIGHTS]
    assert relief.min() == pytest.approx(-start.cavity.depth, abs=2e-3)
    assert relief.max() == 0
    area = np.count_nonzero(relief < -1e-3) * CELL**2
    assert 1e-4 < area < 4e-3
