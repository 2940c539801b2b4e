"""Where cameras stand: the ranges of the draw, what stays in view, and how the images are turned."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest
from strategies import poses

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.pose import Pose
from kit1000.sim import layout
from kit1000.sim.cameras import (
    AZIMUTH,
    CAMERA,
    LOOK_AT,
    POLAR,
    RADIUS,
    WORKSPACE,
    camera_set,
    draw_primary,
    in_view,
)

DRAWS = 1000
CORNERS = np.array(np.meshgrid(*WORKSPACE.T)).reshape(3, 8).T


@pytest.fixture(scope="module")
def drawn() -> Pose:
    rng = np.random.default_rng(0)
    return Pose.stack([draw_primary(rng) for _ in range(DRAWS)])


@pytest.fixture(scope="module")
def spherical(drawn: Pose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radius, angle from the vertical, and azimuth from -pi/2 to 3/2 pi, about the point looked at."""
    x, y, z = (drawn.xyz - LOOK_AT).T
    radius = np.sqrt(x**2 + y**2 + z**2)
    return radius, np.arctan2(np.hypot(x, y), z), (np.arctan2(y, x) + np.pi / 2) % (2 * np.pi) - np.pi / 2


def cylinder(radius: float, height: float, x: float, y: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 48)
    ring = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), 0 * angle], axis=1)
    return np.concatenate([ring, ring + (0, 0, height)])


def test_the_camera_is_that_of_the_paper_with_the_principal_point_amid_the_pixels():
    assert (CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy) == (1280, 720, 925, 925)
    assert (CAMERA.cx, CAMERA.cy) == ((1280 - 1) / 2, (720 - 1) / 2)


def test_radius_and_angles_are_uniform_in_their_ranges(spherical: tuple[np.ndarray, ...]):
    radius, polar, azimuth = spherical
    turn = (azimuth + AZIMUTH) % np.pi - AZIMUTH  # of either side
    for values, (low, high) in ((radius, RADIUS), (polar, POLAR), (turn, (-AZIMUTH, AZIMUTH))):
        assert values.min() >= low - 1e-12
        assert values.max() <= high + 1e-12
        assert kstest(values, "uniform", (low, high - low)).pvalue > 1e-3


def test_layouts_keep_within_the_workspace():
    kits = np.stack([layout.KITS_AT - layout.KITS_REACH, layout.KITS_AT + layout.KITS_REACH])
    for region in (kits, layout.PARTS_IN):
        assert (region[0] >= WORKSPACE[0, :2]).all()
        assert (region[1] <= WORKSPACE[1, :2]).all()


def test_both_sides_of_the_table_are_drawn_alike(drawn: Pose):
    assert abs((drawn.xyz[:, 0] > 0).mean() - 0.5) < 4 * 0.5 / np.sqrt(DRAWS)


def test_drawn_cameras_look_at_one_point_between_the_halves_with_z_up(drawn: Pose):
    seen = drawn.inverse().apply(LOOK_AT)
    np.testing.assert_allclose(seen[:, :2], 0, atol=1e-12)
    right, down, _ = np.moveaxis(drawn.rotation_matrix(), -1, 0)
    np.testing.assert_allclose(right[:, 2], 0, atol=1e-12)
    assert (down[:, 2] < 0).all()


def test_the_halves_stand_side_by_side_in_a_drawn_image(drawn: Pose):
    for pose in drawn[:100]:
        kits, parts = CAMERA.project(pose.inverse().apply([(0, 0.2, 0), (0, -0.17, 0)]))
        assert abs(kits - parts)[0] > 2 * abs(kits - parts)[1]


def test_nearly_every_draw_holds_a_full_layout(drawn: Pose):
    """The widest assembly there is, in any turn, and parts all over their half."""
    halves = np.concatenate([cylinder(0.165, 0.1, 0, 0.2), cylinder(0.15, 0.03, 0, -0.17)])
    assert np.mean([in_view(CAMERA, pose, halves) for pose in drawn]) > 0.95


def test_the_same_generator_draws_the_same_camera():
    one, other = (draw_primary(np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one.xyz, other.xyz)
    np.testing.assert_array_equal(one.wxyz, other.wxyz)


def test_the_sets_have_the_keys_that_recordings_use():
    primary = draw_primary(np.random.default_rng(0))
    assert camera_set("primary", primary) == {"": (CAMERA, primary)}
    assert list(camera_set("three")) == ["three/0", "three/1", "three/2"]
    assert list(camera_set("top", primary)) == ["top"]


@pytest.mark.parametrize("name", ["three", "top"])
def test_fixed_cameras_hold_the_whole_workspace_at_the_pixel_of_height_maps(name: str):
    for camera, pose in camera_set(name).values():
        assert in_view(camera, pose, CORNERS)
        across = np.linalg.norm(pose.xyz - (0, 0.025, 0)) / camera.fx
        assert across < 1.15e-3


def test_three_cameras_stand_around_the_table_in_equal_turns():
    places = np.array([pose.xyz for _, pose in camera_set("three").values()])
    angles = np.sort(np.arctan2(places[:, 1] - 0.025, places[:, 0]) % (2 * np.pi))
    np.testing.assert_allclose(np.diff(angles), 2 * np.pi / 3)
    np.testing.assert_allclose(places[:, 2], places[0, 2])


def test_the_top_camera_looks_straight_down_with_y_across_as_from_the_positive_side_of_x():
    (camera, pose), side = camera_set("top")["top"], camera_set("three")["three/2"][1]
    np.testing.assert_allclose(pose.rotation_matrix()[:, 2], (0, 0, -1), atol=1e-12)
    assert side.xyz[0] > 0
    steps = np.diff(camera.project(pose.inverse().apply([(0, 0, 0), (0, 0.1, 0), (0.1, 0.1, 0)])), axis=0)
    assert steps[0, 0] > 100
    assert steps[1, 1] > 100
    np.testing.assert_allclose([steps[0, 1], steps[1, 0]], 0, atol=1e-9)
    assert side.rotation_matrix()[1, 0] > 0  # +y to the right there too


def test_an_unknown_set_is_answered_with_the_known_ones():
    with pytest.raises(InputError, match=r"camera set 'four': expected one of primary, three, top"):
        camera_set("four")


def test_the_primary_set_wants_the_pose_that_was_drawn():
    with pytest.raises(InputError, match="expected the pose that was drawn for the scene"):
        camera_set("primary")


@settings(max_examples=60)
@given(poses(), st.integers(0, 2**32 - 1), st.floats(0, 50))
def test_points_are_in_view_if_each_projects_inside_the_margin(pose: Pose, seed: int, margin: float):
    rng = np.random.default_rng(seed)
    points = pose.apply(rng.normal((0, 0, 1), (0.3, 0.2, 0.3), (2, 3)))
    each = []
    for x, y, z in pose.inverse().apply(points):
        u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
        each.append(z > 0 and margin <= u + 0.5 <= 1280 - margin and margin <= v + 0.5 <= 720 - margin)
    assert in_view(CAMERA, pose, points, margin) == all(each)


def test_the_image_ends_half_a_pixel_outside_the_outer_centres():
    camera = Camera(width=8, height=6, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    assert in_view(camera, Pose.identity(), [(-0.5, -0.5, 1), (7.5, 5.5, 1)])
    assert not in_view(camera, Pose.identity(), [(7.6, 0, 1)])
    assert not in_view(camera, Pose.identity(), [(0, 0, -1)])
