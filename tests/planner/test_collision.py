"""Collisions of the arm: against brute force over points of the capsules, with the table, itself and a held part."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from kit1000.planner.collision import COLUMN, ROOM, SELF, TABLE, Cell, Held, segment_distance
from kit1000.planner.robot import CUPS, HOME, capsule_ends, inverse, shape, tool_pose
from kit1000.pose import Pose

pytest.importorskip("pybullet")
BASE = Pose.from_translation([-0.45, 0.0, 0.2])
CUBE = np.array(list(product((-0.5, 0.5), repeat=3)))
DOWN = Pose.from_rotvec([np.pi, 0, 0])
RNG = np.random.default_rng(11)
POINT = st.tuples(*[st.floats(-1, 1)] * 3)


def joints_above(xyz: ArrayLike) -> np.ndarray:
    """Joints (6,) that put the cup at a point [m] of the world, pointing down, the elbow up."""
    found = inverse(BASE.inverse() @ Pose(DOWN.wxyz, np.asarray(xyz)))
    free = [joints for joints in found if np.isfinite(joints).all()]
    with Cell(BASE) as cell:
        return next(joints for joints in free if cell.contact(joints[None]) is None)


def box_distance(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """[m] of points (..., 3) from a box, 0 inside."""
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=-1)


@given(POINT, POINT, POINT, POINT)
def test_the_distance_of_segments_is_that_of_their_nearest_points(a, b, c, d) -> None:
    first, second = np.array([a, b]), np.array([c, d])
    share = np.linspace(0, 1, 60)[:, None]
    p, q = (ends[0] + share * (ends[1] - ends[0]) for ends in (first, second))
    brute = np.linalg.norm(p[:, None] - q, axis=-1).min()
    found = segment_distance(first, second)
    assert found <= brute + 1e-8  # nearly parallel segments lose half of the digits
    steps = (np.linalg.norm(first[1] - first[0]) + np.linalg.norm(second[1] - second[0])) / 59
    assert found >= brute - steps


def test_contacts_of_the_arm_are_those_of_the_points_of_its_capsules() -> None:
    """Random boxes against random arms; cases within a tenth of a millimetre of ROOM may go either way."""
    share = np.linspace(0, 1, 400)[:, None, None]
    radii = np.array([capsule.radius for capsule in shape(CUPS[0])])
    seen = set()
    for _ in range(40):
        middle, size = RNG.uniform(-0.4, 0.4, 3) + [0.0, 0, 0.5], RNG.uniform(0.02, 0.3, 3)
        with Cell(BASE) as cell:
            cell.add("box", [CUBE * size], Pose.from_translation(middle))
            for joints in RNG.uniform(-2, 2, (10, 6)):
                ends = BASE.apply(capsule_ends(joints, CUPS[0]))
                points = ends[:, 0] + share * (ends[:, 1] - ends[:, 0])
                gap = (box_distance(points, middle - size / 2, middle + size / 2).min(0) - radii).min()
                found = cell.contact(joints[None])
                if abs(gap - ROOM) > 2e-4 and (found is None or found.what == "box"):
                    assert (found is not None) == (gap < ROOM)
                    seen.add(found is not None)
    assert seen == {True, False}


def test_the_first_contact_along_a_path_is_found() -> None:
    path = np.array([joints_above([0.0, y, 0.3]) for y in np.linspace(-0.2, 0.2, 41)])
    with Cell(BASE) as cell:
        cell.add("post", [CUBE * (0.02, 0.02, 0.5)], Pose.from_translation([0.0, 0.1, 0.25]))
        found = cell.contact(path)
        assert found is not None
        assert found.what == "post"
        assert cell.contact(path[: found.sample]) is None
        assert cell.contact(path, spare={"post"}) is None
        cell.move("post", None)
        assert cell.contact(path) is None


def test_the_arm_meets_the_table_its_column_and_itself() -> None:
    with Cell(BASE) as cell:
        assert cell.contact(HOME[None]) is None
        low = HOME + np.array([0, 0.6, 0, 0, 0, 0]) @ np.diag([0, -1, 0, 0, 0, 0])
        found = [cell.contact(joints[None]) for joints in (*RNG.uniform(-3, 3, (400, 6)), low)]
        assert {TABLE, COLUMN, SELF} <= {contact.what for contact in found if contact is not None}


def test_the_cup_reaches_the_table_and_no_deeper() -> None:
    with Cell(BASE) as cell:
        for height, free in ((0.5e-3, True), (-0.5e-3, False)):
            joints = inverse(BASE.inverse() @ Pose(DOWN.wxyz, np.array([0.0, -0.2, height])))
            contacts = [cell.contact(each[None]) for each in joints if np.isfinite(each).all()]
            assert any(contact is None for contact in contacts) == free


def test_a_held_part_meets_a_wall_where_its_side_does() -> None:
    """A cube of 40 mm held below the cup is carried towards a wall."""
    tool_from_part = Pose.from_translation([0, 0, 0.02])
    xs = np.linspace(0.04, 0.10, 31)
    with Cell(BASE) as cell:
        cell.add("wall", [CUBE * (0.02, 0.4, 0.06)], Pose.from_translation([0.11, -0.2, 0.03]))
        cell.add("cube", [CUBE * 0.04], Pose.from_translation([0, -0.2, 0.02]), movable=True)
        cell.move("cube", None)
        path = np.array([joints_above([x, -0.2, 0.12]) for x in xs])
        cell.move("cube", Pose.from_translation([0, 5, 0]))
        lower = np.array([joints_above([x, -0.2, 0.075]) for x in xs])
        held = Held("cube", tool_from_part)
        found = cell.contact(lower, held)
        assert found is not None
        assert found.what == "wall"
        gaps = 0.10 - (xs + 0.02)
        assert gaps[found.sample] < ROOM <= gaps[found.sample - 1] + 1e-4
        assert cell.contact(path, held) is None  # above the wall
        assert cell.contact(lower, held._replace(spare=frozenset({"wall"}))) is None


def test_a_held_part_may_touch_the_table_only_where_that_is_spared() -> None:
    with Cell(BASE) as cell:
        cell.add("cube", [CUBE * 0.04], Pose.from_translation([0, 5, 0.02]), movable=True)
        joints = joints_above([0.0, -0.2, 0.04])[None]
        held = Held("cube", Pose.from_translation([0, 0, 0.02]))
        found = cell.contact(joints, held)
        assert found is not None
        assert found.what == TABLE
        assert cell.contact(joints, held._replace(spare=frozenset({TABLE}))) is None


def test_the_tool_s_tip_is_where_the_kinematics_say() -> None:
    """A ball-sized block right under the lip is met, the same block 10 mm lower is not."""
    joints = joints_above([0.05, -0.15, 0.2])
    tip = (BASE @ tool_pose(joints)).xyz
    for drop, met in ((0.0, True), (0.01, False)):
        with Cell(BASE) as cell:
            cell.add("block", [CUBE * 0.004], Pose.from_translation(tip - [0, 0, 0.002 + drop]))
            assert (cell.contact(joints[None]) is not None) == met
