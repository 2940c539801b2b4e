"""Camera poses: the ranges they are drawn from, what is in view, and the orientation of the images."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.sim import layout
from kit1000.sim.cameras import (
    CAMERA,
    MAX_PRIMARY_AZIMUTH,
    PRIMARY_POLAR_ANGLE,
    PRIMARY_RADIUS,
    PRIMARY_TARGET,
    WORKSPACE,
    camera_set,
    draw_primary_pose,
    in_view,
)
from tests.samples.strategies import poses

DRAWS = 1000
CORNERS = np.array(np.meshgrid(*WORKSPACE.T)).reshape(3, 8).T


@pytest.fixture(scope="module")
def primary_poses() -> Pose:
    rng = np.random.default_rng(0)
    return Pose.stack([draw_primary_pose(rng) for _ in range(DRAWS)])


@pytest.fixture(scope="module")
def spherical(primary_poses: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius, angle from the vertical, and azimuth from -pi/2 to 3/2 pi, about the target."""
    x, y, z = (primary_poses.xyz - PRIMARY_TARGET).T
    radius = np.sqrt(x**2 + y**2 + z**2)
    return radius, np.arctan2(np.hypot(x, y), z), (np.arctan2(y, x) + np.pi / 2) % (2 * np.pi) - np.pi / 2


def cylinder(radius: float, height: float, x: float, y: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 48)
    ring = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), 0 * angle], axis=1)
    return np.concatenate([ring, ring + (0, 0, height)])


def test_radius_and_angles_are_uniform_in_their_ranges(spherical: tuple[np.ndarray, ...]):
    radius, polar, azimuth = spherical
    folded = (azimuth + MAX_PRIMARY_AZIMUTH) % np.pi - MAX_PRIMARY_AZIMUTH  # from the x axis, on either side
    azimuths = (-MAX_PRIMARY_AZIMUTH, MAX_PRIMARY_AZIMUTH)
    for values, (low, high) in ((radius, PRIMARY_RADIUS), (polar, PRIMARY_POLAR_ANGLE), (folded, azimuths)):
        assert values.min() >= low - 1e-12
        assert values.max() <= high + 1e-12
        assert kstest(values, "uniform", (low, high - low)).pvalue > 1e-3


def test_layouts_lie_within_the_workspace():
    kits = np.stack([layout.KITS_CENTRE - layout.KITS_RADIUS, layout.KITS_CENTRE + layout.KITS_RADIUS])
    for region in (kits, layout.PARTS_BOUNDS):
        assert (region[0] >= WORKSPACE[0, :2]).all()
        assert (region[1] <= WORKSPACE[1, :2]).all()


def test_both_sides_of_the_table_are_equally_likely(primary_poses: Pose):
    assert abs((primary_poses.xyz[:, 0] > 0).mean() - 0.5) < 4 * 0.5 / np.sqrt(DRAWS)


def test_primary_cameras_look_at_one_point_between_the_halves_with_z_up(primary_poses: Pose):
    targets = primary_poses.inverse().apply(PRIMARY_TARGET)
    np.testing.assert_allclose(targets[:, :2], 0, atol=1e-12)
    right, down, _ = np.moveaxis(primary_poses.rotation_matrix(), -1, 0)
    np.testing.assert_allclose(right[:, 2], 0, atol=1e-12)
    assert (down[:, 2] < 0).all()


def test_nearly_every_primary_camera_has_a_full_layout_in_view(primary_poses: Pose):
    """The widest possible assembly at any yaw, and parts all over their half."""
    halves = np.concatenate([cylinder(0.165, 0.1, 0, 0.2), cylinder(0.15, 0.03, 0, -0.17)])
    assert np.mean([in_view(CAMERA, pose, halves) for pose in primary_poses]) > 0.95


def test_the_sets_have_the_keys_that_recordings_use():
    primary = draw_primary_pose(np.random.default_rng(0))
    assert camera_set("primary", primary) == {"": (CAMERA, primary)}
    assert list(camera_set("three")) == ["three/0", "three/1", "three/2"]
    assert list(camera_set("top", primary)) == ["top"]


@pytest.mark.parametrize("name", ["three", "top"])
def test_fixed_cameras_see_the_whole_workspace_at_the_resolution_of_height_maps(name: str):
    for camera, pose in camera_set(name).values():
        assert in_view(camera, pose, CORNERS)
        across = np.linalg.norm(pose.xyz - (0, 0.025, 0)) / camera.fx
        assert across < 1.15e-3


def test_the_top_camera_looks_straight_down_with_y_across_as_from_the_positive_x_side():
    (camera, pose), side = camera_set("top")["top"], camera_set("three")["three/2"][1]
    np.testing.assert_allclose(pose.rotation_matrix()[:, 2], (0, 0, -1), atol=1e-12)
    assert side.xyz[0] > 0
    steps = np.diff(camera.project(pose.inverse().apply([(0, 0, 0), (0, 0.1, 0), (0.1, 0.1, 0)])), axis=0)
    assert steps[0, 0] > 100
    assert steps[1, 1] > 100
    np.testing.assert_allclose([steps[0, 1], steps[1, 0]], 0, atol=1e-9)
    assert side.rotation_matrix()[1, 0] > 0  # +y to the right there too


def test_the_primary_set_needs_the_pose_of_the_primary_camera():
    with pytest.raises(InputError, match="expected the pose of the scene's primary camera"):
        camera_set("primary")


@given(poses(), st.integers(0, 2**32 - 1), st.floats(0, 50))
def test_points_are_in_view_if_each_projects_inside_the_margin(pose: Pose, seed: int, margin: float):
    rng = np.random.default_rng(seed)
    points = pose.apply(rng.normal((0, 0, 1), (0.3, 0.2, 0.3), (2, 3)))
    visible = []
    for x, y, z in pose.inverse().apply(points):
        u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
        visible.append(z > 0 and margin <= u + 0.5 <= 1280 - margin and margin <= v + 0.5 <= 720 - margin)
    assert in_view(CAMERA, pose, points, margin) == all(visible)


@pytest.mark.parametrize("name", ["three", "top"])
def test_cameras_of_a_larger_scene_see_it_as_those_of_the_usual_one(name: str) -> None:
    for (camera, usual), (_, larger) in zip(
        camera_set(name).values(), camera_set(name, scale=1.4).values(), strict=True
    ):
        pixels = [camera.project(pose.inverse().apply(size * CORNERS)) for pose, size in ((usual, 1.0), (larger, 1.4))]
        np.testing.assert_allclose(pixels[0], pixels[1], atol=1e-6)
