"""Grasps: which spots of rendered shapes a cup seals on, and where it leaks."""

from __future__ import annotations

import numpy as np
import pytest
from manifold3d import Manifold

from kit1000.camera import look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.planner.grasp import CUPS, FLATNESS, Grasp, find_grasps, is_held, top_heights, touch
from kit1000.pose import Pose
from kit1000.sim.cameras import CAMERA
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View
from tests.samples.shapes import box

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


def test_top_heights_are_those_of_rays_from_above() -> None:
    solid = Manifold.sphere(20, 64).scale((1e-3, 1e-3, 1e-3))
    spots = np.random.default_rng(1).uniform(-0.013, 0.013, (50, 2))
    heights = top_heights(mesh_from_solid(solid), spots)
    assert heights == pytest.approx(np.sqrt(0.02**2 - (spots**2).sum(1)), abs=1e-4)
    assert top_heights(mesh_from_solid(solid), np.array([[0.03, 0.0]]))[0] == -np.inf


def test_a_small_cup_carries_50_grams_and_not_100() -> None:
    grasp = Grasp(np.zeros(3), CUPS[-1], 0.0, 0.0)
    assert is_held(grasp, 0.05 * 9.81)
    assert not is_held(grasp, 0.10 * 9.81)
    assert is_held(Grasp(np.zeros(3), CUPS[0], 0.0, 0.0), 0.3 * 9.81)
