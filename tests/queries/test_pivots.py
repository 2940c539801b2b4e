"""Tests of pivots: what they are, that they move with the world, that noise at the border of a mask hardly matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.camera import Camera, look_at
from kit1000.pose import Pose
from kit1000.queries.pivots import part_pivots
from kit1000.sim.sensors import sense
from kit1000.values import FIRST_PART_LABEL, View

CAMERA = Camera(160, 120, 200.0, 200.0, 79.5, 59.5)
POSE = look_at((0.7, -0.1, 0.6), (0, 0, 0))
BOX = slice(30, 80), slice(40, 110)  # rows and columns of the part of `image`


def image(depth: float = 0.8) -> tuple[View, np.ndarray]:
    """A slanted part before a far background, and its masks."""
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[BOX] = FIRST_PART_LABEL
    rows, columns = np.indices(labels.shape)
    near = depth + 2e-4 * rows + 1e-4 * columns
    return View(CAMERA, POSE, np.where(labels > 0, near, near + 0.2).astype(np.float32)), labels


def pivot(view: View, labels: np.ndarray) -> np.ndarray:
    """The pivot of the first part."""
    return part_pivots(view, labels)[0]


def test_it_is_the_middle_between_the_outer_tenths_of_the_points_three_pixels_inside() -> None:
    view, labels = image()
    rng = np.random.default_rng(1)
    view = replace(view, depth=np.where(rng.random(labels.shape) < 0.2, 0, view.depth))
    points = []
    for v in range(33, 77):
        for u in range(43, 107):
            if view.depth[v, u] > 0:
                ray = np.array([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1])
                points.append((POSE.matrix() @ [*(view.depth[v, u] * ray), 1])[:3])
    ends = []
    for axis in range(3):
        ordered = sorted(point[axis] for point in points)
        outer = int((len(ordered) - 1) / 10)
        ends.append((ordered[outer] + ordered[-1 - outer]) / 2)
    assert np.abs(pivot(view, labels) - ends).max() <= 0.6e-4
    assert np.allclose(pivot(view, labels) * 1e4, np.round(pivot(view, labels) * 1e4), atol=1e-9)


def test_it_moves_with_the_camera() -> None:
    view, labels = image()
    moved_from_world = Pose.from_translation((0.0123, -0.0045, 0.1))
    moved = replace(view, world_from_camera=moved_from_world @ view.world_from_camera)
    assert np.allclose(pivot(moved, labels), moved_from_world.apply(pivot(view, labels)), atol=1e-12)


@pytest.mark.parametrize("border", [1, 2, 3])
def test_depths_of_the_background_at_the_border_of_the_mask_do_not_move_it(border: int) -> None:
    view, labels = image()
    rows, columns = BOX
    depth = view.depth.copy()
    depth[BOX] += 0.2
    inside = slice(rows.start + border, rows.stop - border), slice(columns.start + border, columns.stop - border)
    depth[inside] -= np.float32(0.2)
    assert np.allclose(pivot(replace(view, depth=depth), labels), pivot(view, labels), atol=1.1e-4)


def test_flying_pixels_anywhere_hardly_move_it() -> None:
    view, labels = image()
    rng = np.random.default_rng(2)
    flying = rng.random(labels.shape) < 0.04
    noisy = replace(view, depth=np.where(flying, view.depth + rng.uniform(-0.3, 0.3, labels.shape), view.depth))
    assert np.linalg.norm(pivot(noisy, labels) - pivot(view, labels)) < 6e-3


def test_the_noise_of_a_scanner_moves_it_by_millimetres() -> None:
    view, labels = image()
    for seed in range(5):
        noisy = sense("photoneo", view, np.random.default_rng(seed))
        calibrated = replace(noisy, world_from_camera=POSE)
        assert np.linalg.norm(pivot(calibrated, labels) - pivot(view, labels)) < 5e-3


@pytest.mark.parametrize("width", [1, 2, 5, 6, 30])
def test_a_thin_part_has_its_pivot_in_its_middle(width: int) -> None:
    labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    labels[20:100, 60 : 60 + width] = FIRST_PART_LABEL
    view = View(CAMERA, POSE, np.full(labels.shape, 0.8, np.float32))
    ray = np.array([(60 + (width - 1) / 2 - CAMERA.cx) / CAMERA.fx, (59.5 - CAMERA.cy) / CAMERA.fy, 1])
    assert np.abs(pivot(view, labels) - POSE.apply(0.8 * ray)).max() < 3e-4


def test_without_a_return_inside_the_border_counts_and_without_any_there_is_no_pivot() -> None:
    view, labels = image()
    border_only = view.depth.copy()
    border_only[33:77, 43:107] = 0
    assert list(part_pivots(replace(view, depth=border_only), labels)) == [0]
    assert part_pivots(replace(view, depth=np.where(labels > 0, 0, view.depth)), labels) == {}


def test_every_part_has_its_own_and_parts_that_are_hidden_none() -> None:
    view, labels = image()
    both = labels.copy()
    both[BOX[0], 80:110] = FIRST_PART_LABEL + 2
    both[:5] = FIRST_PART_LABEL - 1
    alone = np.where(both == FIRST_PART_LABEL + 2, both, 0).astype(np.uint8)
    assert list(part_pivots(view, both)) == [0, 2]
    assert np.array_equal(part_pivots(view, both)[2], part_pivots(view, alone)[2])
