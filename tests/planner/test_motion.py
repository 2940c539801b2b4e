"""Motions of the robot: kinematics, speed profiles, lines and ways around walls."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

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
from kit1000.planner.robot import (
    ALPHA,
    ARM,
    CUPS,
    HOME,
    JOINT_LIMITS,
    JOINT_SPEED,
    TOOL_LENGTH,
    A,
    D,
    capsule_ends,
    inverse,
    shape,
    tool_pose,
)
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


ANGLES = st.lists(st.floats(-np.pi, np.pi), min_size=6, max_size=6).map(np.array)
RNG = np.random.default_rng(3)


def turn_distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The largest difference of two joint positions up to whole turns."""
    return np.abs(np.exp(1j * a) - np.exp(1j * b)).max(-1)


def test_ten_thousand_poses_are_reached_exactly_and_their_own_joints_are_among_the_answers() -> None:
    joints = RNG.uniform(-np.pi, np.pi, (10_000, 6))
    poses = tool_pose(joints)
    found = inverse(poses)
    valid = np.asarray(np.isfinite(found).all(-1))
    reached = tool_pose(np.where(valid[..., None], found, 0.0))
    assert np.linalg.norm(reached.xyz - poses.xyz[:, None], axis=-1)[valid].max() < 1e-9
    assert (reached.inverse() @ poses[:, None]).angle()[valid].max() < 1e-9
    assert np.nanmin(np.where(valid, turn_distance(found, joints[:, None]), np.inf), axis=1).max() < 1e-7
    assert valid.sum(1).mean() > 6


@given(ANGLES)
def test_every_answer_reaches_the_pose_also_near_singular_ones(joints: np.ndarray) -> None:
    pose = tool_pose(joints)
    found = inverse(pose)
    reached = tool_pose(found[np.isfinite(found).all(-1)])
    assert np.abs(reached.xyz - pose.xyz).max(initial=0) < 1e-6
    assert (reached.inverse() @ pose).angle().max(initial=0) < 1e-6


def test_out_of_reach_there_is_no_answer() -> None:
    assert np.isnan(inverse(Pose.from_translation([2.0, 0.0, 0.3]))).all()
    assert np.isnan(inverse(Pose.from_rotvec([np.pi, 0, 0], [0.05, 0.0, 0.2]))).all()  # within the column


def test_the_nozzle_ends_at_the_lip_of_the_cup() -> None:
    joints = RNG.uniform(-3, 3, (20, 6))
    for cup in CUPS:
        ends = capsule_ends(joints, cup)
        assert ends.shape == (20, len(ARM) + 1, 2, 3)
        tool = tool_pose(joints)
        lip = ends[:, -1, 1] + shape(cup)[-1].radius * tool.rotation_matrix()[..., 2]
        assert lip == pytest.approx(tool.xyz)


def urdf() -> str:
    """The arm as URDF text: what a joint turns stands before it, so that each origin is the fixed half of a link."""
    lines, parent = ['<robot name="arm"><link name="base"/>'], "base"
    inertia = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    for i in range(6):
        a, d, roll = (A[i - 1], D[i - 1], ALPHA[i - 1] * np.pi / 2) if i else (0.0, 0.0, 0.0)
        lines.append(
            f'<link name="link{i}">{inertia}</link><joint name="joint{i}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link{i}"/><origin xyz="{a:.6f} 0 {d:.6f}" rpy="{roll:.17g} 0 0"/><axis xyz="0 0 1"/>'
            f'<limit lower="-6.3" upper="6.3" effort="1" velocity="1"/></joint>'
        )
        parent = f"link{i}"
    lines.append(
        f'<link name="tool">{inertia}</link><joint name="cup" type="fixed"><parent link="{parent}"/>'
        f'<child link="tool"/><origin xyz="0 0 {D[5] + TOOL_LENGTH:.6f}"/></joint></robot>'
    )
    return "".join(lines)


def test_pybullet_agrees_on_the_forward_kinematics(tmp_path: Path) -> None:
    bullet = pytest.importorskip("pybullet")
    (tmp_path / "arm.urdf").write_text(urdf())
    client = bullet.connect(bullet.DIRECT)
    try:
        arm = bullet.loadURDF(str(tmp_path / "arm.urdf"), useFixedBase=True, physicsClientId=client)
        for joints in RNG.uniform(-np.pi, np.pi, (100, 6)):
            for i in range(6):
                bullet.resetJointState(arm, i, joints[i], physicsClientId=client)
            state = bullet.getLinkState(arm, 6, computeForwardKinematics=True, physicsClientId=client)
            tool = tool_pose(joints)
            assert np.abs(np.array(state[4]) - tool.xyz).max() < 1e-5
            judged = Pose(np.roll(state[5], 1), np.array(state[4]))
            assert (judged.inverse() @ tool).angle() < 1e-4
    finally:
        bullet.disconnect(client)
