"""Motions: times of trapezoids, lines of the tool, joint moves and paths around obstacles."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from kit1000.planner.motion import (
    LINE_STEP,
    MOVE_ACCELERATION,
    MOVE_SPACING,
    MOVE_SPEED,
    arrival_times,
    find_path,
    line_joints,
    line_leg,
    line_poses,
    move_joints,
    move_legs,
    turned_near,
)
from kit1000.planner.robot import HOME, JOINT_LIMITS, JOINT_SPEED, tool_pose
from kit1000.pose import Pose

JOINTS = st.lists(st.floats(-2.5, 2.5), min_size=6, max_size=6).map(np.array)
DOWN = Pose.from_rotvec([np.pi, 0, 0])


@given(st.floats(1e-3, 5.0), st.floats(0.05, 2.0), st.floats(0.05, 2.0))
def test_a_trapezoid_keeps_speed_and_acceleration_and_takes_as_long_as_the_closed_form(
    distance: float, speed: float, acceleration: float
) -> None:
    at = np.linspace(0, distance, 400)
    t = arrival_times(at, distance, speed, acceleration)
    assert t[0] == 0
    if distance >= speed**2 / acceleration:
        assert t[-1] == pytest.approx(distance / speed + speed / acceleration)
    else:
        assert t[-1] == pytest.approx(2 * np.sqrt(distance / acceleration))
    velocity = np.diff(at) / np.diff(t)
    assert velocity.max() <= speed * (1 + 1e-6)
    middle = (t[1:] + t[:-1]) / 2
    assert np.abs(np.diff(velocity) / np.diff(middle)).max() <= acceleration * (1 + 1e-3)


@given(st.floats(1e-3, 5.0), st.floats(0.05, 2.0))
def test_a_trapezoid_is_the_same_backwards(distance: float, speed: float) -> None:
    at = np.linspace(0, distance, 51)
    t = arrival_times(at, distance, speed, 0.3)
    assert t[-1] - t[::-1] == pytest.approx(arrival_times(distance - at[::-1], distance, speed, 0.3), abs=1e-9)


def test_a_line_is_straight_and_keeps_its_orientation_and_its_branch() -> None:
    start = Pose(DOWN.wxyz, np.array([0.45, 0.1, 0.15]))
    end = Pose(DOWN.wxyz, np.array([0.45, 0.1, 0.05]))
    joints = line_joints(line_poses(start, end))
    followed = np.isfinite(joints).all((1, 2))
    assert followed.sum() >= 4
    for line in joints[followed]:
        tool = tool_pose(line)
        assert tool.xyz == pytest.approx(start.xyz + np.linspace(0, 1, 51)[:, None] * (end.xyz - start.xyz))
        assert (tool.inverse() @ start).angle().max() < 1e-9
        assert np.abs(np.diff(line, axis=0)).max() <= LINE_STEP
        leg = line_leg("lower", line, 0.1)
        speeds = np.abs(np.diff(leg.joints, axis=0)) / np.diff(leg.seconds)[:, None]
        assert speeds.max() <= JOINT_SPEED


def test_a_line_that_leaves_the_reach_is_followed_by_no_branch() -> None:
    start, end = Pose(DOWN.wxyz, np.array([0.6, 0, 0.1])), Pose(DOWN.wxyz, np.array([1.2, 0, 0.1]))
    assert np.isnan(line_joints(line_poses(start, end))).all()


@given(JOINTS, JOINTS)
def test_a_joint_move_goes_from_end_to_end_in_small_steps_within_its_limits(start: np.ndarray, end: np.ndarray) -> None:
    joints = move_joints(start, end)
    np.testing.assert_array_equal(joints[0], start)
    assert joints[-1] == pytest.approx(end)
    assert np.abs(np.diff(joints, axis=0)).max() <= MOVE_SPACING * (1 + 1e-9)
    assume(np.abs(end - start).max() > 1e-3)
    (leg,) = move_legs("reach", np.stack([start, end]))
    velocity = np.diff(leg.joints, axis=0) / np.diff(leg.seconds)[:, None]
    assert np.abs(velocity).max() <= MOVE_SPEED * (1 + 1e-6)
    assert leg.duration >= 2 * np.sqrt(np.abs(end - start).max() / MOVE_ACCELERATION) * (1 - 1e-9)


@given(JOINTS, st.lists(st.floats(-6, 6), min_size=6, max_size=6).map(np.array))
def test_turns_bring_a_line_near_a_reference_within_the_limits(start: np.ndarray, reference: np.ndarray) -> None:
    line = start + np.linspace(0, 0.5, 9)[:, None]
    near = turned_near(line, reference)
    assert near is not None
    assert (np.abs(near) <= JOINT_LIMITS).all()
    assert np.abs(np.remainder(near - line + np.pi, 2 * np.pi) - np.pi).max() < 1e-9
    free = np.abs(reference[3:]) < 2.5  # where limits do not matter, half a turn at most is left
    assert (np.abs(near[0] - reference)[3:][free] <= np.pi + 1e-9).all()


def test_turns_that_break_the_limits_are_refused() -> None:
    assert turned_near(np.linspace(-4, 4, 9)[:, None] * np.ones(6), HOME) is None


def wall(joints: np.ndarray) -> bool:
    """Free but for a wall in the first two joints that is open above 0.6 rad."""
    return not ((np.abs(joints[:, 0]) < 0.2) & (joints[:, 1] < 0.6)).any()


def test_a_path_leads_around_a_wall_and_is_free_all_along() -> None:
    start, end = np.array([-1.0, 0, 0, 0, 0, 0]), np.array([1.0, 0, 0, 0, 0, 0])
    path = find_path(start, end, wall, np.random.default_rng(0))
    assert path is not None
    assert len(path) > 2
    np.testing.assert_array_equal(path[[0, -1]], [start, end])
    assert all(wall(move_joints(a, b)) for a, b in pairwise(path))
    again = find_path(start, end, wall, np.random.default_rng(0))
    np.testing.assert_array_equal(path, again)


def test_a_free_way_is_taken_straight_and_none_is_found_where_there_is_none() -> None:
    start, end = np.zeros(6), np.ones(6)
    assert len(find_path(start, end, lambda joints: True, np.random.default_rng(0))) == 2  # pyright: ignore[reportArgumentType]
    closed = lambda joints: not (np.abs(joints[:, 0] - 0.5) < 0.2).any()  # noqa: E731
    assert find_path(start, end, closed, np.random.default_rng(0)) is None
