"""Refinement in the image: rendered cavities are those of the renderer, and a fit goes to where the image shows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.pose import Pose
from kit1000.registration.image_refine import ImageFit, refine_in_image
from kit1000.registration.search import Candidate
from kit1000.values import LabelledDepth
from kit1000.voxels import Volume
from tests.samples.registration_cases import CASES, CLEARANCE, Case, case
from tests.samples.registration_images import CAMERA, GAIN, NOISE, image_of, moved


def found_in(image: LabelledDepth, known: Case, candidate: Candidate) -> ImageFit:
    found = refine_in_image(image, GAIN, known.part, known.pivot, candidate, CLEARANCE)
    assert found is not None
    return found


def refined(name: str, image: LabelledDepth, candidate: Candidate) -> tuple[float, float]:
    """[mm] at the pivot and [degrees] from the goal."""
    return case(name).error_of(found_in(image, case(name), candidate).plate_from_now)


@pytest.mark.parametrize("polar_deg", [0.0, 25.0, 45.0])
@pytest.mark.parametrize("name", CASES)
def test_the_goal_stays(name: str, polar_deg: float) -> None:
    far, angle = refined(name, image_of(name, polar_deg), moved(case(name), 0, 0, 0))
    assert far < 0.4
    assert angle < 1.0


@settings(max_examples=10)
@given(
    name=st.sampled_from(sorted(CASES)),
    angle=st.floats(0, 2 * np.pi),
    yaw_deg=st.floats(-4, 4),
    noise_px=st.sampled_from((0.0, NOISE)),
)
def test_a_fit_goes_to_where_the_image_shows_it(name: str, angle: float, yaw_deg: float, noise_px: float) -> None:
    start = moved(case(name), 2 * np.cos(angle), 2 * np.sin(angle), yaw_deg)
    far, off = refined(name, image_of(name, 35.0, noise_px), start)
    assert far < 0.9  # of 2 mm
    assert off < 2.0


@pytest.mark.parametrize("name", CASES)
def test_a_face_that_is_off_is_no_matter_of_the_place(name: str) -> None:
    image = image_of(name)
    gain, depth = CAMERA.fx * 0.055, image.view.depth
    bent = np.where(depth > 0, gain / (gain / np.maximum(depth, 0.1) + 0.2 + 1e-3 * np.arange(CAMERA.width)), 0)
    view = replace(image.view, depth=bent.astype(np.float32))
    far, _ = refined(name, LabelledDepth(view, image.labels), moved(case(name), 1.5, -1.0, 2.0))
    assert far < 0.7


def test_the_world_may_be_elsewhere() -> None:
    known, image, start = case("an L"), image_of("an L"), moved(case("an L"), 1.0, 1.0, 2.0)
    here = found_in(image, known, start)
    move = Pose.from_rotvec((0.3, -0.2, 0.7), (0.1, 0.2, -0.3))
    view = replace(image.view, world_from_camera=move @ image.view.world_from_camera)
    grid = replace(known.part.grid, world_from_grid=move @ known.part.grid.world_from_grid)
    cavity = replace(start.cavity, world_from_plate=move @ start.cavity.world_from_plate)
    there = replace(start, cavity=cavity, plate_from_now=start.plate_from_now @ move.inverse())
    part, pivot = Volume(grid, known.part.values), move.apply(known.pivot)
    found = refine_in_image(LabelledDepth(view, image.labels), GAIN, part, pivot, there, CLEARANCE)
    assert found is not None
    np.testing.assert_allclose((found.plate_from_now @ move).matrix(), here.plate_from_now.matrix(), atol=2e-5)
    assert found.spread() == pytest.approx(here.spread(), rel=0.02)


@pytest.mark.parametrize("name", ["an L"])
def test_places_scatter_as_the_spread_says(name: str) -> None:
    start = moved(case(name), 0.5, 0.5, 1.0)
    found = [found_in(image_of(name, 35.0, NOISE, seed), case(name), start) for seed in range(16)]
    places = np.array([fit.plate_from_now.apply(case(name).pivot)[:2] for fit in found])
    scatter = np.sqrt(np.linalg.eigvalsh(np.cov(places.T)).max())
    spread = np.median([fit.spread() for fit in found])
    assert spread / 2.5 < scatter < 2.5 * spread


@pytest.mark.parametrize("what", ["no kit", "no return", "elsewhere"])
def test_without_the_plate_in_the_image_nothing_is_found(what: str) -> None:
    known, image, start = case("an L"), image_of("an L"), moved(case("an L"), 1.0, 0.0, 0.0)
    if what == "no kit":
        image = LabelledDepth(image.view, np.zeros_like(image.labels))
    elif what == "no return":
        image = LabelledDepth(replace(image.view, depth=np.zeros_like(image.view.depth)), image.labels)
    else:
        away = Pose.from_translation((2.0, 0.0, 0.0)) @ image.view.world_from_camera
        image = LabelledDepth(replace(image.view, world_from_camera=away), image.labels)
    assert refine_in_image(image, GAIN, known.part, known.pivot, start, CLEARANCE) is None
