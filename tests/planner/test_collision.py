"""Collisions and grasps of the robot: closed forms, points of its capsules, and rays from above."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold
from numpy.typing import ArrayLike

from kit1000.camera import look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.planner.collision import COLUMN, ROOM, SELF, TABLE, Cell, Held, segment_distance
from kit1000.planner.grasp import CUPS, FLATNESS, Grasp, find_grasps, is_held, touch
from kit1000.planner.robot import HOME, capsule_ends, inverse, shape
from kit1000.pose import Pose
from kit1000.sim.cameras import CAMERA
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View
from tests.samples.shapes import box

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


EYE = (0.35, -0.1, 0.55)


def seen(mesh: Mesh, world_from_part: Pose, eye: tuple[float, float, float] = EYE) -> LabelledDepth:
    """A rendered image of a part on the table."""
    pose = look_at(eye, (0, 0, 0.01))
    image = render(CAMERA, pose, [(table(), Pose.identity()), (mesh, world_from_part)], threads=1)
    labels = np.where(image.body_ids == 2, FIRST_PART_LABEL, 0).astype(np.uint8)
    return LabelledDepth(View(CAMERA, pose, image.depth), labels)


def block(x: float, y: float, z: float) -> Mesh:
    """A block [mm] on z = 0."""
    return mesh_from_solid(box(x * 1e-3, y * 1e-3, z * 1e-3))


def ring(outer: float, inner: float, height: float) -> Mesh:
    """A ring [mm] on z = 0."""
    solid = Manifold.cylinder(height, outer, circular_segments=64) - Manifold.cylinder(
        height * 3, inner, circular_segments=64
    ).translate((0, 0, -height))
    return mesh_from_solid(solid.scale((1e-3, 1e-3, 1e-3)))


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0])
def test_on_a_block_the_largest_cup_goes_near_the_middle(yaw: float) -> None:
    pose = Pose.from_rotvec([0, 0, yaw], [0.02, -0.01, 0.0])
    mesh = block(50, 40, 20)
    best = find_grasps(seen(mesh, pose), 0)[0]
    assert best.cup == CUPS[0]
    assert best.point[2] == pytest.approx(mesh.bounds[1, 2], abs=3e-4)
    inside = pose.inverse().apply(best.point)
    assert (mesh.bounds[0, :2] + best.cup <= inside[:2]).all()
    assert (inside[:2] <= mesh.bounds[1, :2] - best.cup).all()
    assert best.margin >= 3e-3
    assert touch(mesh, pose, best) == pytest.approx(mesh.bounds[1, 2])


@pytest.mark.parametrize(("wall", "cup"), [(13.5, CUPS[0]), (9.0, CUPS[1]), (5.5, CUPS[2]), (3.0, None)])
def test_a_ring_takes_the_largest_cup_that_its_wall_carries(wall: float, cup: float | None) -> None:
    mesh = ring(24, 24 - wall, 10)
    grasps = find_grasps(seen(mesh, Pose.identity()), 0)
    assert (grasps[0].cup if grasps else None) == cup
    assert cup is None or touch(mesh, Pose.identity(), grasps[0]) == pytest.approx(10e-3)


@pytest.mark.parametrize(("tilt_deg", "seals"), [(6, True), (11, False)])
def test_a_surface_may_be_tilted_by_eight_degrees(tilt_deg: float, seals: bool) -> None:
    pose = Pose.from_rotvec([0, np.radians(tilt_deg), 0], [0, 0, 0.01])
    assert bool(find_grasps(seen(block(50, 40, 20), pose), 0)) == seals


def test_what_is_not_seen_is_not_grasped() -> None:
    image = seen(block(50, 40, 20), Pose.identity())
    assert find_grasps(image, 1) == []
    blind = LabelledDepth(
        View(image.view.camera, image.view.world_from_camera, np.zeros_like(image.view.depth)), image.labels
    )
    assert find_grasps(blind, 0) == []


def test_noise_beyond_the_flatness_leaves_no_spot() -> None:
    image = seen(block(50, 40, 20), Pose.identity())
    noise = np.random.default_rng(0).normal(0, 2e-3, image.view.depth.shape).astype(np.float32)
    noisy = View(image.view.camera, image.view.world_from_camera, image.view.depth + noise * (image.view.depth > 0))
    assert find_grasps(LabelledDepth(noisy, image.labels), 0, FLATNESS) == []
    assert find_grasps(LabelledDepth(noisy, image.labels), 0, 0.02)


def test_a_cup_leaks_over_a_hole_beside_the_rim_and_on_a_step() -> None:
    mesh = ring(24, 8, 10)
    at = lambda x: Grasp(np.array([x, 0.0, 0.0]), CUPS[0], 0.0, 0.0)  # noqa: E731
    assert touch(mesh, Pose.identity(), at(16e-3)) == pytest.approx(10e-3)
    for x in (0.0, 10e-3, 22e-3, 60e-3):
        assert touch(mesh, Pose.identity(), at(x)) is None
    low, high = Manifold.cube((40, 40, 10), center=True), Manifold.cube((20, 40, 14), center=True).translate((10, 0, 0))
    step = mesh_from_solid((low + high).scale((1e-3, 1e-3, 1e-3)))
    assert touch(step, Pose.identity(), at(0.0)) is None
    assert touch(step, Pose.identity(), at(10e-3)) == pytest.approx(7e-3)


def test_a_small_cup_carries_50_grams_and_not_100() -> None:
    grasp = Grasp(np.zeros(3), CUPS[-1], 0.0, 0.0)
    assert is_held(grasp, 0.05 * 9.81)
    assert not is_held(grasp, 0.10 * 9.81)
    assert is_held(Grasp(np.zeros(3), CUPS[0], 0.0, 0.0), 0.3 * 9.81)
