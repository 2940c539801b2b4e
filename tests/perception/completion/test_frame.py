"""The frame of the completion network: the same evidence wherever the scene stands, its mirror image, its packing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.perception.completion.parts import (
    CELL,
    CODE,
    SHAPE,
    TYPICAL,
    FramedPart,
    framed,
    grid_at,
    packed,
    pixel_box,
    scale_of,
    unpacked,
)
from kit1000.perception.observed.pixels import cropped
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import LabelledDepth, View
from tests.samples.shapes import MM, box, ell

CAMERA = Camera(width=500, height=400, fx=700.0, fy=700.0, cx=249.5, cy=199.5)
EYE = look_at((0.35, 0.1, 0.6), (0, 0, 0))
PART, NEIGHBOUR = 2, 3
LEVELS = 0.02  # of a truncation: rounding of poses may take a cell to the next pixel


def part_mesh() -> Mesh:
    return mesh_from_solid(ell()).scaled(MM)


def image_of(*moved: Pose, eye: Pose = EYE) -> LabelledDepth:
    """Equal parts at poses on a table, the first is the part."""
    table = mesh_from_solid(box(600, 600, 20, (0, 0, -20))).scaled(MM)
    bodies = [(table, moved[0] if eye is not EYE else Pose.identity()), *((part_mesh(), pose) for pose in moved)]
    image = render(CAMERA, eye, bodies, 1)
    labels = np.where(image.body_ids > 1, image.body_ids, 0).astype(np.uint8)
    return LabelledDepth(View(CAMERA, eye, image.depth), labels)


def evidence(image: LabelledDepth, *options: Any, **more: Any) -> FramedPart:
    """The evidence of an image that shows the part."""
    part = framed(image, PART, *options, **more)
    assert part is not None
    return part


@settings(max_examples=10)
@given(st.floats(-3.1, 3.1), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_a_scene_turned_about_the_vertical_with_its_camera_gives_the_same_evidence(
    yaw: float, x: float, y: float
) -> None:
    motion = Pose.from_rotvec((0, 0, yaw), (x, y, 0))
    here, there = evidence(image_of(Pose.identity())), evidence(image_of(motion, eye=motion @ EYE))
    differs = np.abs(here.codes.astype(int) - there.codes.astype(int)) > LEVELS * CODE
    assert differs.mean() < 2e-3  # cells between two pixels
    np.testing.assert_allclose(here.camera, there.camera, atol=1e-4)
    moved = (here.grid.moved(motion).world_from_grid.inverse() @ there.grid.world_from_grid).xyz
    assert np.abs(moved).max() < 1e-4


def test_the_frame_looks_away_from_the_camera_and_stands_on_the_table() -> None:
    part = evidence(image_of(Pose.identity()))
    away = part.grid.world_from_grid.rotate((1.0, 0.0, 0.0))
    assert away[2] == pytest.approx(0)
    assert away[:2] @ EYE.xyz[:2] < -0.99 * np.linalg.norm(EYE.xyz[:2])
    assert part.grid.world((0, 0, 0))[2] == pytest.approx(CELL / 2)
    low, high = part_mesh().bounds
    np.testing.assert_allclose(part.grid.world((np.array(SHAPE) - 1) / 2)[:2], (low + high)[:2] / 2, atol=6e-3)


def test_what_a_neighbour_hides_is_unknown_and_a_table_without_return_is_free() -> None:
    alone, neighbour = Pose.identity(), Pose.from_translation((0.045, 0.012, 0))
    free, hidden = evidence(image_of(alone)), evidence(image_of(alone, neighbour))
    assert (hidden.codes == -CODE).mean() > (free.codes == -CODE).mean() + 0.005
    image = image_of(alone)
    dropped = np.where(image.labels == 0, np.float32(0), image.view.depth)
    blind = evidence(LabelledDepth(replace(image.view, depth=dropped), image.labels))
    assert (np.abs(blind.codes.astype(int) - free.codes) > 2).mean() < 1e-3


@settings(max_examples=5)
@given(st.floats(1.2, 2.5), st.floats(0.0, 0.02))
def test_a_larger_scene_gives_the_same_evidence_at_its_scale(scale: float, table: float) -> None:
    image = image_of(Pose.identity())
    eye = Pose(EYE.wxyz, scale * EYE.xyz + (0, 0, table))
    larger = LabelledDepth(View(CAMERA, eye, scale * image.view.depth), image.labels)
    here, there = evidence(image), evidence(larger, table, scale=scale)
    assert (np.abs(here.codes.astype(int) - there.codes) > 1).mean() < 1e-3
    np.testing.assert_allclose(there.camera, here.camera, rtol=1e-5)
    np.testing.assert_allclose(there.grid.centres(), scale * here.grid.centres() + (0, 0, table), atol=1e-6)


def test_only_a_part_larger_than_those_learned_from_is_shrunk_and_then_to_their_size() -> None:
    image = image_of(Pose.identity())
    assert scale_of(image, PART) == 1.0
    assert scale_of(image, NEIGHBOUR) == 1.0  # which is not there
    sizes = []
    for factor in (2.0, 3.0):
        pose = Pose(EYE.wxyz, factor * EYE.xyz)
        larger = LabelledDepth(View(CAMERA, pose, factor * image.view.depth), image.labels)
        sizes.append(factor / scale_of(larger, PART))
        evidence(larger, scale=scale_of(larger, PART))
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-4)
    low, high = part_mesh().bounds
    assert sizes[0] * np.ptp([low, high], axis=0).max() == pytest.approx(TYPICAL, rel=0.15)


def test_a_mirrored_scene_gives_mirrored_evidence() -> None:
    eye = look_at((0.4, 0, 0.6), (0, 0, 0))
    image = image_of(Pose.identity(), eye=eye)
    mirrored = LabelledDepth(replace(image.view, depth=image.view.depth[:, ::-1]), image.labels[:, ::-1])
    here, there = evidence(image), evidence(mirrored)
    assert (np.abs(here.codes[:, ::-1].astype(int) - there.codes) > LEVELS * CODE).mean() < 5e-3


def test_a_part_without_a_return_has_no_evidence() -> None:
    image = image_of(Pose.identity())
    dropped = np.where(image.labels == PART, np.float32(0), image.view.depth)
    assert framed(LabelledDepth(replace(image.view, depth=dropped), image.labels), PART) is None
    assert framed(image, NEIGHBOUR) is None


def test_a_crop_that_holds_the_grid_gives_the_evidence_of_the_whole_image() -> None:
    image = image_of(Pose.identity())
    whole = evidence(image)
    crop = cropped(image, pixel_box(whole.grid, CAMERA, EYE, border=3))
    again = evidence(crop)
    np.testing.assert_array_equal(again.codes, whole.codes)


def test_all_of_an_image_is_kept_where_the_grid_reaches_behind_the_camera() -> None:
    rows, columns = pixel_box(grid_at(0.0, 0.0, 0.3), CAMERA, look_at((0.01, 0, 0.02), (0.2, 0, 0)))
    assert (rows, columns) == (slice(0, CAMERA.height), slice(0, CAMERA.width))


@given(st.integers(1, 4), st.integers(1, 4), st.integers(1, 5), st.integers(0, 1000))
def test_packing_keeps_each_cell_at_its_place(x: int, y: int, z: int, seed: int) -> None:
    volume = np.random.default_rng(seed).integers(-128, 128, (2 * x, 2 * y, z)).astype(np.int8)
    image = packed(volume)
    assert image.shape == (x, y, 4 * z)
    np.testing.assert_array_equal(unpacked(image), volume)
    i, j, k = 2 * x - 1, 2 * (y // 2), z - 1
    assert image[i // 2, j // 2, (2 * (i % 2) + j % 2) * z + k] == volume[i, j, k]
