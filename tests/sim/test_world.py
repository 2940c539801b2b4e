"""The physics world: closed forms of mechanics, reproducible bytes, pybullet's memory leaks and errors."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from kit1000.errors import InputError, ShapeError
from kit1000.mesh import mesh_from_solid
from kit1000.pose import Pose
from kit1000.sim.world import GRAVITY, MARGIN, MAX_HULL_VERTICES, STEP_RATE, World, hull_vertices
from tests.samples.shapes import box, cylinder, standing
from tests.samples.strategies import poses

CUBE = (np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.01).astype(float)
MOMENTS = np.full(3, 0.05 / 6 * 0.02**2)


def dropped(height: float, steps: int) -> Pose:
    with World() as world:
        world.add_ground()
        cube = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_rotvec([0.3, 0.2, 0.1], [0, 0, height]))
        world.step(steps)
        return world.pose(cube)


def test_a_body_in_the_air_is_in_free_fall() -> None:
    with World() as world:
        cube = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_translation([0, 0, 10.0]), linearDamping=0.0)
        world.step(STEP_RATE // 2)
        assert world.pose(cube).xyz[2] == pytest.approx(10 - GRAVITY * 0.5**2 / 2, abs=GRAVITY * 0.5 / STEP_RATE)
        assert world.speeds(cube) == pytest.approx((GRAVITY * 0.5, 0.0), rel=1e-6)


@given(pose=poses())
@settings(max_examples=10)
def test_a_pose_is_read_back_as_it_was_set(pose: Pose) -> None:
    with World() as world:
        back = world.pose(world.add_hull(CUBE, 0.05, MOMENTS, pose))
    assert (back.inverse() @ pose).angle() < 1e-7
    assert back.xyz == pytest.approx(pose.xyz, abs=1e-12)


def test_a_cube_rests_within_the_margin_of_the_ground() -> None:
    with World() as world:
        world.add_ground()
        cube = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_translation([0, 0, 0.012]))
        world.step(STEP_RATE)
        assert abs(world.pose(cube).xyz[2] - 0.01) < 1.2 * MARGIN


def test_a_sliding_cube_stops_after_the_distance_of_its_friction() -> None:
    """The coefficient is the product of those of both surfaces; from an initial speed v: v^2 = 2 mu g s."""
    with World() as world:
        world.add_ground(friction=1.0)
        cube = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_translation([0, 0, 0.01]), lateralFriction=0.3)
        world.push(cube, force=np.array([0.05 * 0.5 * STEP_RATE, 0, 0]), torque=np.zeros(3))
        world.step(STEP_RATE)
        assert world.pose(cube).xyz[0] == pytest.approx(0.5**2 / (2 * 0.3 * GRAVITY), rel=0.05)


def test_bodies_that_do_not_meet_do_not_disturb_each_other() -> None:
    with World() as world:
        world.add_ground()
        cube = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_rotvec([0.3, 0.2, 0.1], [0, 0, 0.05]))
        world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_translation([0.2, 0, 0.02]))
        world.step(100)
        assert world.pose(cube).xyz.tobytes() == dropped(0.05, 100).xyz.tobytes()


def memory() -> int:
    """Bytes of main memory that this process uses."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="reads memory use from /proc")
def test_many_worlds_leak_no_memory() -> None:
    points = mesh_from_solid(standing(cylinder(30, 10, segments=200))).vertices - [0, 0, 0.005]

    def use() -> None:
        with World() as world:
            world.add_ground()
            for i in range(5):
                world.add_hull(points, 0.05, MOMENTS, Pose.from_translation([0.1 * i, 0, 0.1]))
            world.step()

    for _ in range(5):
        use()
    before = memory()
    for _ in range(60):  # each would leak 300 kB if the rows of points were allocated anew
        use()
    assert memory() - before < 9e6


def test_a_world_ends_with_its_block_also_after_an_error() -> None:
    world = World()

    def fail() -> None:
        with world:
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    with pytest.raises(InputError, match="inside its `with` block"):
        world.step()
    with world:  # and can be opened again, empty
        assert world.add_ground() == 0


def test_without_pybullet_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(InputError, match=r"pip install 'kit1000\[sim\]'"), World():
        pass


def test_an_error_reports_that_no_further_world_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        DIRECT = 2

        def connect(self, _: int) -> int:
            return -1

    monkeypatch.setitem(sys.modules, "pybullet", Full())
    with pytest.raises(InputError, match="opens no further world"), World():
        pass


def test_points_that_span_no_solid_are_rejected() -> None:
    with pytest.raises(ShapeError, match="span a solid"):
        hull_vertices(CUBE * (1, 1, 0))
    with pytest.raises(ShapeError, match="span a solid"):
        hull_vertices(CUBE[:3])


def test_a_hull_keeps_its_vertices_and_drops_interior_points() -> None:
    inside = np.random.default_rng(0).uniform(-0.009, 0.009, (50, 3))
    assert np.array_equal(hull_vertices(np.concatenate([inside, CUBE])), CUBE)


@given(seed=st.integers(0, 100))
@settings(max_examples=3)
def test_a_round_hull_is_simplified_but_keeps_its_shape(seed: int) -> None:
    ball = np.random.default_rng(seed).standard_normal((4000, 3))
    ball *= 0.02 / np.linalg.norm(ball, axis=1, keepdims=True)
    thin = hull_vertices(ball)
    assert len(thin) <= MAX_HULL_VERTICES
    assert -ConvexHull(thin).equations[:, 3].max() > 0.02 * (1 - 0.01)  # the nearest facet
    assert {tuple(corner) for corner in thin} <= {tuple(corner) for corner in ball}


def test_a_block_rests_on_another() -> None:
    flat = mesh_from_solid(standing(box(40, 40, 10))).vertices - [0, 0, 0.005]
    with World() as world:
        world.add_ground()
        world.add_hull(flat, 0.05, MOMENTS, Pose.from_translation([0, 0, 0.0051]))
        upper = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_translation([0, 0, 0.021]))
        world.step(STEP_RATE)
        assert abs(world.pose(upper).xyz[2] - 0.02) < 4 * MARGIN
