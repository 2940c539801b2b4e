"""The camera: integer pixel centres, OpenCV axes, projection round trips."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError, ShapeError
from kit1000.pose import Pose
from kit1000.rng import stream
from tests.samples.strategies import directions, poses, vectors

ROUNDING = 1e-14
CAMERA = Camera(width=64, height=48, fx=50.0, fy=55.0, cx=31.5, cy=20.25)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Cameras of odd and even sizes with their principal points anywhere in the image."""
    width, height = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    focal = st.floats(5.0, 100.0)
    cx, cy = draw(st.floats(-0.5, width - 0.5)), draw(st.floats(-0.5, height - 0.5))
    return Camera(width, height, draw(focal), draw(focal), cx, cy)


def test_right_is_plus_u_and_down_is_plus_v() -> None:
    u, v = CAMERA.project([0.1, 0.2, 1.0])
    assert u == pytest.approx(31.5 + 5.0)
    assert v == pytest.approx(20.25 + 11.0)


@given(cameras(), st.floats(0.1, 5.0))
def test_pixel_centres_are_integers(camera: Camera, z: float) -> None:
    # A depth image of a wall: each pixel's point projects to the pixel's own integer position.
    uv = camera.project(camera.unproject(np.full((camera.height, camera.width), z)))
    v, u = np.indices((camera.height, camera.width))
    assert np.allclose(uv, np.stack([u, v], axis=-1), rtol=0, atol=1e-12)


@given(cameras(), st.lists(vectors(1.0), min_size=1, max_size=5).map(np.array), st.floats(1.1, 3.0))
def test_unprojecting_a_projection_returns_the_point(camera: Camera, points: np.ndarray, away: float) -> None:
    points = points + np.array([0, 0, away])
    again = camera.unproject_pixels(camera.project(points), points[:, 2])
    assert np.allclose(again, points, rtol=0, atol=ROUNDING * 10)


@given(cameras(), vectors(1.0), st.floats(1.1, 3.0))
def test_project_is_the_intrinsic_matrix(camera: Camera, point: np.ndarray, away: float) -> None:
    point = point + np.array([0, 0, away])
    u, v, w = camera.K @ point
    assert np.allclose(camera.project(point), [u / w, v / w], rtol=0, atol=1e-11)


def test_unproject_gives_depth_along_z_and_the_origin_without_return() -> None:
    depth = stream(0).uniform(0.5, 1.5, (48, 64)).astype(np.float32)
    depth[10, 20] = 0
    points = CAMERA.unproject(depth)
    assert points.dtype == np.float64
    assert np.array_equal(points[..., 2], depth)
    assert points[10, 20].tolist() == [0, 0, 0]


def test_points_behind_the_camera_project_to_nan() -> None:
    uv = CAMERA.project([[0, 0, 1], [0, 0, 0], [0.1, 0, -1]])
    assert np.isfinite(uv[0]).all()
    assert np.isnan(uv[1:]).all()


def test_wrong_shapes_are_rejected_by_name() -> None:
    with pytest.raises(ShapeError, match=r"depth: expected .* shape \(48, 64\), got shape \(64, 48\)"):
        CAMERA.unproject(np.ones((64, 48)))
    with pytest.raises(ShapeError, match="points_cam: expected"):
        CAMERA.project(np.ones((5, 2)))
    with pytest.raises(ShapeError, match="depth: expected one depth or shape"):
        CAMERA.unproject_pixels(np.ones((5, 2)), np.ones(4))


@pytest.mark.parametrize(
    ("change", "name"),
    [({"width": 0}, "width"), ({"height": 2.5}, "height"), ({"fx": 0.0}, "fx"), ({"cy": np.nan}, "cy")],
)
def test_invalid_cameras_are_rejected_by_name(change: dict[str, float], name: str) -> None:
    fields = {"width": 4, "height": 4, "fx": 1.0, "fy": 1.0, "cx": 1.5, "cy": 1.5}
    with pytest.raises(InputError, match=f"{name}.*expected"):
        Camera(**(fields | change))  # pyright: ignore[reportArgumentType]


@given(cameras(), vectors(1.0), st.sampled_from([2.0, 3.0, 0.5, 0.37]))
def test_scaling_keeps_each_point_at_its_relative_position_in_the_image(
    camera: Camera, point: np.ndarray, factor: float
) -> None:
    def share(view: Camera) -> np.ndarray:
        return (view.project(point + np.array([0, 0, 2])) + 0.5) / [view.width, view.height]

    assert np.allclose(share(camera.scaled(factor)), share(camera), rtol=0, atol=1e-12)


def test_doubling_splits_a_pixel_symmetrically() -> None:
    double = CAMERA.scaled(2)
    assert (double.width, double.height) == (128, 96)
    point = CAMERA.unproject_pixels([10.0, 10.0], 1.0)
    assert np.allclose(double.project(point), [20.5, 20.5], rtol=0, atol=1e-12)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.inf, np.nan])
def test_scaling_by_an_invalid_factor_is_rejected(factor: float) -> None:
    with pytest.raises(InputError, match="factor: expected"):
        CAMERA.scaled(factor)


@given(vectors(2.0), directions(), st.floats(0.1, 3.0), directions())
def test_look_at_centres_the_target_with_up_upward(
    eye: np.ndarray, way: np.ndarray, distance: float, up: np.ndarray
) -> None:
    target = eye + distance * way
    assume(np.linalg.norm(np.cross(way, up)) > 1e-3)
    camera_from_world = look_at(eye, target, up).inverse()
    assert np.allclose(camera_from_world.apply(target), [0, 0, distance], rtol=0, atol=ROUNDING * 10)
    raised = camera_from_world.rotate(up)
    assert abs(raised[0]) < 1e-12  # no roll
    assert raised[1] < 0  # up is -y in the image


def test_look_at_gives_opencv_axes() -> None:
    # Looking along +x with +z up: right is -y, down is -z.
    world_from_camera = look_at([1, 2, 3], [5, 2, 3])
    axes = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    assert np.allclose(world_from_camera.rotation_matrix(), axes, rtol=0, atol=ROUNDING)
    assert world_from_camera.xyz.tolist() == [1, 2, 3]


@given(poses(), vectors(1.0))
def test_look_at_moves_with_the_world(world_from_old: Pose, eye: np.ndarray) -> None:
    target, up = eye + np.array([0.3, 0.5, -0.4]), np.array([0.0, 0.0, 1.0])
    before = look_at(eye, target, up)
    after = look_at(world_from_old.apply(eye), world_from_old.apply(target), world_from_old.rotate(up))
    assert np.allclose(after.matrix(), (world_from_old @ before).matrix(), rtol=0, atol=ROUNDING * 10)


@pytest.mark.parametrize(
    ("eye", "target", "up", "name"),
    [
        ([0, 0, 1], [0, 0, 0], [0, 0, 1], "up"),
        ([0, 0, 1], [0, 0, 1], [0, 1, 0], "target - eye"),
        ([0, 0, 1], [0, 1, 0], [0, 0, 0], "up"),
    ],
)
def test_a_view_without_direction_or_up_vector_is_rejected(eye: list, target: list, up: list, name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: expected a direction"):
        look_at(eye, target, up)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2]), st.integers(0, 9))
def test_a_window_shows_what_the_image_shows_there(seed: int, step: int, margin: int) -> None:
    camera = Camera(64, 48, 60.0, 61.0, 31.5, 23.0)
    points = np.random.default_rng(seed).uniform((-0.3, -0.3, 0.6), (0.3, 0.3, 1.0), (3, 3))
    left, top, window = camera.window(points, (-64, -48), (128, 96), margin, step)
    pixels = camera.project(points)
    assert np.allclose(window.project(points), pixels - (left, top))
    assert left % step == top % step == 0
    inside = ((pixels >= (-64, -48)) & (pixels <= (127, 95))).all(axis=1)
    shown = window.project(points[inside])
    assert ((shown >= 0) & (shown <= (window.width - 1, window.height - 1))).all()
    behind = camera.window(points - (0, 0, 0.8), (0, 0), (64, 48))
    assert behind == (0, 0, camera) or (points[:, 2] > 0.8).all()
