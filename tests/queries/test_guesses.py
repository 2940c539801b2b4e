"""Guesses, motions and pivots: stated ranges, exact inverses, and no trace of the true pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from kit1000.camera import Camera, look_at
from kit1000.dataset.scene_queries import GuessDraw
from kit1000.errors import InputError
from kit1000.kits.goals import nearest_about_axis
from kit1000.pose import Pose, quaternion_angle, random_quaternions
from kit1000.queries.guesses import (
    FIXED_LEVELS,
    LEVELS,
    MAX_ANGLE,
    MAX_OFFSET,
    draw_ball_error,
    draw_goal,
    draw_tilt_error,
    level_angle,
    level_offset,
)
from kit1000.queries.motions import apply_error, error_of, goal_motion, goal_pose
from kit1000.queries.pivots import extent_centre, part_pivots
from kit1000.queries.tracks import has_curves
from kit1000.sim.sensors import sense
from kit1000.values import FIRST_PART_LABEL, FreeAxis, Slot, View
from tests.samples.strategies import directions, poses, vectors

DRAWS = 2000
MIN_P_VALUE = 1e-3  # of a test of a distribution; the seed is fixed


def slot(goals: int = 1, free: bool = False) -> Slot:
    rng = np.random.default_rng(goals)
    stacked = Pose(random_quaternions(rng, goals), rng.uniform(-0.02, 0.02, (goals, 3)))
    axis = FreeAxis(np.array([0.003, -0.001, 0.0]), np.array([0.0, 0.0, 1.0])) if free else None
    return Slot("p", stacked[0], 2.5e-3, 8e-3, stacked, axis)


@cache
def errors(draw: Callable) -> tuple[np.ndarray, np.ndarray]:
    """(DRAWS, 3) offsets and (DRAWS, 3) rotation vectors."""
    rng = np.random.default_rng(5)
    offsets, rotvecs = zip(*(draw(rng) for _ in range(DRAWS)), strict=True)
    return np.array(offsets), np.array(rotvecs)


def is_uniform(samples: np.ndarray, low: float, high: float) -> bool:
    """Whether samples are uniform between two numbers (Kolmogorov-Smirnov test)."""
    return stats.kstest(samples, stats.uniform(low, high - low).cdf).pvalue > MIN_P_VALUE


def is_close(a: Pose, b: Pose, tolerance: float = 1e-12) -> bool:
    return bool(np.abs(a.xyz - b.xyz).max() < tolerance and quaternion_angle(a.wxyz, b.wxyz) < tolerance)


@given(poses(), vectors(), vectors(0.05), directions(), st.floats(0, 3))
def test_error_of_reads_back_an_applied_error(
    goal: Pose, pivot: np.ndarray, offset: np.ndarray, axis: np.ndarray, angle: float
) -> None:
    found = error_of(apply_error(goal, pivot, offset, angle * axis), goal, pivot)
    assert np.abs(found[0] - offset).max() < 1e-12
    assert np.abs(found[1] - angle * axis).max() < 1e-12


@given(poses(), vectors(), vectors(0.05), directions(), st.floats(0, 3))
def test_a_guess_is_the_product_in_the_docs(
    goal: Pose, pivot: np.ndarray, offset: np.ndarray, axis: np.ndarray, angle: float
) -> None:
    home = goal.apply(pivot)
    turn = Pose.from_rotvec(angle * axis)
    product = Pose.from_translation(home + offset) @ turn @ Pose.from_translation(-home) @ goal
    assert is_close(apply_error(goal, pivot, offset, angle * axis), product)


@given(poses(), poses(), vectors(), vectors(0.05), directions(), st.floats(0, 3))
def test_a_guess_moves_with_the_world(
    moved_from_world: Pose, goal: Pose, pivot: np.ndarray, offset: np.ndarray, axis: np.ndarray, angle: float
) -> None:
    # Everything moves, with the directions of the error: in the moved world, goal and guess are conjugates.
    world_from_moved = moved_from_world.inverse()
    guess = apply_error(goal, pivot, offset, angle * axis)
    moved = apply_error(
        moved_from_world @ goal @ world_from_moved,
        moved_from_world.apply(pivot),
        moved_from_world.rotate(offset),
        moved_from_world.rotate(angle * axis),
    )
    assert is_close(moved, moved_from_world @ guess @ world_from_moved, 1e-11)


@given(poses(), vectors(), vectors(), directions())
def test_the_offset_at_the_pivot_does_not_depend_on_the_rotation(
    goal: Pose, pivot: np.ndarray, offset: np.ndarray, rotvec: np.ndarray
) -> None:
    pivot_offset = apply_error(goal, pivot, offset, rotvec).apply(pivot) - goal.apply(pivot)
    assert np.abs(pivot_offset - offset).max() < 1e-12


@pytest.mark.parametrize("draw", [draw_ball_error, draw_tilt_error])
def test_errors_are_uniform_in_the_ranges_of_the_paper(draw: Callable) -> None:
    offsets, rotvecs = errors(draw)
    angles = np.linalg.norm(rotvecs, axis=1)
    assert np.abs(offsets).max() <= MAX_OFFSET
    assert angles.max() <= MAX_ANGLE
    assert np.mean(np.linalg.norm(offsets, axis=1)) == pytest.approx(26.9e-3, abs=0.5e-3)
    assert np.degrees(angles.mean()) == pytest.approx(13.75, abs=0.5)
    assert all(is_uniform(column, -MAX_OFFSET, MAX_OFFSET) for column in offsets.T)
    assert is_uniform(angles, 0, MAX_ANGLE)


def test_axes_of_ball_errors_are_uniform_on_the_sphere() -> None:
    _, rotvecs = errors(draw_ball_error)
    axes = rotvecs / np.linalg.norm(rotvecs, axis=1, keepdims=True)
    assert all(is_uniform(column, -1, 1) for column in axes.T)  # Archimedes: each coordinate is uniform
    assert is_uniform(np.arctan2(axes[:, 1], axes[:, 0]), -np.pi, np.pi)


def test_axes_of_tilt_errors_are_horizontal_and_uniform() -> None:
    _, rotvecs = errors(draw_tilt_error)
    assert not rotvecs[:, 2].any()
    assert is_uniform(np.arctan2(rotvecs[:, 1], rotvecs[:, 0]), -np.pi, np.pi)
    up = np.array([0.0, 0.0, 1.0])
    tilted = Pose.from_rotvec(rotvecs).rotate(up)
    shortest = np.arctan2(np.linalg.norm(tilted[:, :2], axis=1), tilted[:, 2])
    assert np.allclose(shortest, np.linalg.norm(rotvecs, axis=1), atol=1e-12)


def test_every_goal_is_equally_likely() -> None:
    rng = np.random.default_rng(6)
    symmetric = slot(goals=8)
    drawn = [draw_goal(rng, symmetric) for _ in range(DRAWS)]
    counts = np.bincount([goal for goal, _ in drawn], minlength=8)
    assert stats.chisquare(counts).pvalue > MIN_P_VALUE
    assert {angle for _, angle in drawn} == {0.0}


def test_angles_about_a_free_axis_are_uniform() -> None:
    rng, round_slot = np.random.default_rng(7), slot(free=True)
    assert is_uniform(np.array([draw_goal(rng, round_slot)[1] for _ in range(DRAWS)]), 0, 2 * np.pi)


@given(st.floats(-7, 7))
def test_a_goal_at_an_angle_is_that_goal_rotated_about_the_axis(angle: float) -> None:
    round_slot = slot(free=True)
    axis = round_slot.free_axis
    assert axis is not None
    goal = goal_pose(round_slot, 0, angle)
    assert is_close(nearest_about_axis(goal, round_slot.goals[0], axis), goal, 1e-9)  # the search finds it
    line = axis.point + np.outer([-0.1, 0.2], axis.direction)
    part_points = round_slot.goals[0].inverse().apply(line)  # points of the part on the axis do not move
    assert np.allclose(goal.apply(part_points), line, atol=1e-12)


def test_a_slot_without_an_axis_rejects_an_angle() -> None:
    with pytest.raises(InputError, match="angle: the slot of p has no free axis"):
        goal_pose(slot(), 0, 0.1)


@given(poses(), poses())
def test_a_goal_motion_moves_the_part_to_its_goal(world_from_part: Pose, world_from_kit: Pose) -> None:
    kit_from_part = slot().kit_from_part
    goal_from_now = goal_motion(world_from_part, world_from_kit, kit_from_part)
    assert is_close(goal_from_now @ world_from_part, world_from_kit @ kit_from_part)


def test_levels_are_evenly_spaced_from_zero_to_the_maximum() -> None:
    assert [round(1e3 * level_offset(k), 9) for k in range(LEVELS)] == [0, 4, 8, 12, 16, 20, 24, 28]
    assert np.allclose(np.diff([level_angle(k) for k in range(LEVELS)]), np.radians(27.5) / 7)
    assert (level_angle(0), level_angle(LEVELS - 1)) == (0, MAX_ANGLE)
    assert set(np.diff(FIXED_LEVELS)) == {3}
    assert FIXED_LEVELS[-1] == LEVELS - 1


def test_the_row_of_a_draw_is_plain_json() -> None:
    row = GuessDraw(2, 0.5, np.array([1e-3, 0, 0]), np.array([0, 0, 0.1])).row
    assert row == {"goal": 2, "turn": 0.5, "offset": [1e-3, 0.0, 0.0], "rotvec": [0.0, 0.0, 0.1]}


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


def test_the_centre_of_extents_is_that_of_all_points_that_returned() -> None:
    view, labels = image(0.6)
    assert extent_centre(view, labels == FIRST_PART_LABEL + 1) is None
    rows, columns = np.nonzero(labels == FIRST_PART_LABEL)
    points = POSE.apply(CAMERA.unproject_pixels(np.stack([columns, rows], -1), view.depth[rows, columns]))
    found = extent_centre(view, labels == FIRST_PART_LABEL)
    assert found is not None
    np.testing.assert_allclose(found, (points.min(0) + points.max(0)) / 2, atol=1e-9)


def test_the_first_test_scenes_alone_have_curves() -> None:
    scenes = [f"{split}-s{number:04}" for split in ("train", "val", "test") for number in range(4)]
    assert [scene for scene in scenes if has_curves(scene, 2)] == ["test-s0000", "test-s0001"]
