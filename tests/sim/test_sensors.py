"""The simulated sensors compared with their parameters: closed forms on planes, a second rendering for shadows."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.render import render
from kit1000.sim.sensors import DEPTH_GRID, SENSORS, sense
from kit1000.sim.stereo import (
    EDGE_STEP,
    blend_windows,
    box_blur,
    depth_from_disparity,
    disparity_from_depth,
    fatten_edges,
    grazing_mask,
    occlusion_mask,
)
from kit1000.values import View

IDENTITY = Pose.identity()
CAMERA = Camera(1280, 720, 925.0, 925.0, 639.5, 359.5)
SMALL = Camera(160, 120, 925.0, 925.0, 79.5, 59.5)
TINY = Camera(8, 6, 925.0, 925.0, 3.5, 2.5)
D415 = SENSORS["d415"]
GAIN = CAMERA.fx * D415.baseline  # [px m]


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) points at depth 1 m behind each pixel centre."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def plane(camera: Camera, normal: tuple[float, float, float], distance: float) -> View:
    """An infinite plane that intersects the optical axis at `distance`; depth 0 where it is invisible."""
    facing = rays(camera) @ np.asarray(normal)
    visible = facing * normal[2] > 1e-3
    depth = np.where(visible, distance * normal[2] / np.where(visible, facing, 1), 0)
    return View(camera, IDENTITY, depth.astype(np.float32))


def wall(camera: Camera, distance: float) -> View:
    """A plane across the optical axis."""
    return plane(camera, (0, 0, 1), distance)


def boxes(camera: Camera, world_from_camera: Pose) -> View:
    """A table with two boxes and a thin post, its edges in view."""
    bodies = (
        ((0.8, 1.0, 0.04), (0, 0, -0.02)),
        ((0.1, 0.1, 0.06), (0, 0.15, 0.03)),
        ((0.05, 0.03, 0.12), (0.1, -0.1, 0.06)),
        ((0.006, 0.006, 0.2), (0.05, 0.02, 0.1)),
    )
    meshes = [trimesh.creation.box(extents=size) for size, _ in bodies]
    solids = [Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int32)) for mesh in meshes]
    places = [Pose.from_translation(np.array(place, float)) for _, place in bodies]
    image = render(camera, world_from_camera, list(zip(solids, places, strict=True)), threads=1)
    return View(camera, world_from_camera, image.depth)


def scene(radius: float = 0.8, polar: float = 0.8) -> View:
    return boxes(CAMERA, look_at((radius * np.sin(polar), 0, radius * np.cos(polar)), (0, 0, 0)))


def without_calibration_errors(monkeypatch: pytest.MonkeyPatch, name: str = "d415") -> None:
    errorless = replace(SENSORS[name], scale_error=0, position_error=0, rotation_error_deg=0)
    monkeypatch.setitem(SENSORS, name, errorless)


def residual_px(view: View, name: str, seed: int) -> np.ndarray:
    """Measured disparity of a plane minus its best affine fit, away from the image border. [px]"""
    depth = sense(name, view, stream(seed)).depth[20:-20, 420:-420]
    assert (depth > 0).all()
    d = view.camera.fx * SENSORS[name].baseline / depth.astype(float)
    v, u = np.indices(d.shape)
    basis = np.stack([np.ones(d.size), u.ravel(), v.ravel()], axis=1)
    return d - (basis @ np.linalg.lstsq(basis, d.ravel(), rcond=None)[0]).reshape(d.shape)


def test_the_message_about_an_unknown_sensor_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"no 'd435', expected one of ideal, d415, photoneo"):
        sense("d435", wall(TINY, 1.0), stream(0))


def test_ideal_depth_is_the_rendered_one_to_half_a_step_of_the_grid() -> None:
    view = scene()
    measured = sense("ideal", view, stream(0))
    assert measured.world_from_camera is view.world_from_camera
    assert np.abs(measured.depth.astype(float) - view.depth).max() <= DEPTH_GRID / 2
    np.testing.assert_array_equal(measured.depth, sense("ideal", view, stream(1)).depth)


@pytest.mark.parametrize("name", SENSORS)
def test_depths_lie_on_the_grid_and_within_range(name: str) -> None:
    view = plane(CAMERA, (0, -1, 0.3), 0.7)  # from right below the camera to the horizon
    depth = sense(name, view, stream(3)).depth
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(depth, np.rint(depth.astype(float) / DEPTH_GRID) * DEPTH_GRID)
    returns, sensor = depth[depth > 0], SENSORS[name]
    assert returns.size
    assert returns.min() >= sensor.min_depth - DEPTH_GRID / 2
    assert returns.max() <= sensor.max_depth + DEPTH_GRID / 2


@pytest.mark.parametrize("name", SENSORS)
def test_pixels_without_a_surface_give_no_return(name: str) -> None:
    view = scene(polar=1.2)
    empty = view.depth == 0
    assert empty.any()
    assert not sense(name, view, stream(1)).depth[empty].any()
    nothing = View(TINY, IDENTITY, np.zeros((6, 8), np.float32))
    assert not sense(name, nothing, stream(1)).depth.any()


@pytest.mark.parametrize("name", SENSORS)
def test_the_measurement_depends_on_the_generator_alone(name: str) -> None:
    first, again, other = (sense(name, scene(), stream(seed)) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.depth, again.depth)
    np.testing.assert_array_equal(first.world_from_camera.matrix(), again.world_from_camera.matrix())
    assert (name == "ideal") == np.array_equal(first.depth, other.depth)


@pytest.mark.parametrize("name", SENSORS)
def test_the_number_of_draws_does_not_depend_on_the_scene(name: str) -> None:
    after = []
    for view in (scene(), wall(CAMERA, 0.7), View(CAMERA, IDENTITY, np.zeros((720, 1280), np.float32))):
        rng = stream(8)
        sense(name, view, rng)
        after.append(rng.random())
    assert len(set(after)) == 1


def test_noise_in_disparity_does_not_depend_on_the_scene() -> None:
    near, far = (residual_px(wall(CAMERA, z), "d415", seed=4) for z in (0.5, 1.0))
    assert np.corrcoef(near.ravel(), far.ravel())[0, 1] > 0.95  # what remains is rounding


@pytest.mark.parametrize("distance", [0.5, 0.8, 1.2, 2.0])
def test_noise_on_a_plane_grows_by_the_stereo_formula(distance: float) -> None:
    view = wall(CAMERA, distance)
    window = (slice(20, -20), slice(150, -20))
    depths = [sense("d415", view, stream(seed, "wall")).depth[window].astype(float) for seed in range(4)]
    rms = np.sqrt(np.mean([np.var(depth) for depth in depths]))
    in_px = D415.noise_px**2 + D415.quantisation_px**2 / 12
    expected = np.sqrt((distance**2 / GAIN) ** 2 * in_px + DEPTH_GRID**2 / 12)
    assert rms == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("normal", [(0.5, 0.2, 1), (-0.3, 0.8, 1)])
def test_noise_in_disparity_is_the_same_on_slanted_planes(normal: tuple[float, float, float]) -> None:
    residual = residual_px(plane(CAMERA, normal, 0.8), "d415", seed=11)
    grid_px = GAIN / 0.8**2 * DEPTH_GRID
    expected = np.sqrt(D415.noise_px**2 + D415.quantisation_px**2 / 12 + grid_px**2 / 12)
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(expected, rel=0.04)


@pytest.mark.parametrize("name", ["d415", "photoneo"])
def test_noise_has_the_correlation_of_two_windows_in_succession(name: str) -> None:
    sensor = SENSORS[name]
    kernel = np.convolve(np.ones(sensor.window_px), np.ones(sensor.window_px))
    tail = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :] / np.sum(kernel**2)
    fields = [residual_px(plane(CAMERA, (0.2, 0.3, 1), 0.7), name, seed) for seed in range(2)]
    correlated = sensor.noise_px**2 / np.mean([np.var(f) for f in fields])  # the rest is rounding
    for axis, lag in product((0, 1), (1, 3, 5, 8, 14)):
        correlation = np.mean([np.mean(f * np.roll(f, lag, axis)) / np.var(f) for f in fields])
        assert correlation == pytest.approx(correlated * tail[lag] if lag < len(tail) else 0, abs=0.04)


def test_a_box_blur_is_the_mean_over_squares_with_periodic_boundaries() -> None:
    image = np.random.default_rng(0).standard_normal((11, 13)).astype(np.float32)
    shifted = [np.roll(image, (i, j), (0, 1)) for i in range(-2, 3) for j in range(-2, 3)]
    np.testing.assert_allclose(box_blur(image, 5), np.mean(shifted, axis=0), atol=1e-6)
    np.testing.assert_allclose(box_blur(image, 1), image, atol=1e-6)


def test_disparity_is_quantised(monkeypatch: pytest.MonkeyPatch) -> None:
    without_calibration_errors(monkeypatch)
    depth = sense("d415", wall(CAMERA, 2.0), stream(2)).depth[:, 60:].astype(float)
    steps = GAIN / depth / D415.quantisation_px
    assert np.abs(steps - np.rint(steps)).max() < 0.03  # the grid of depths: 0.025 of a step at 2 m
    assert 10 < len(np.unique(depth)) < 40


def test_rounding_in_disparity_is_exact() -> None:
    rng = np.random.default_rng(1)
    d = np.pad(rng.uniform(20, 90, (30, 40)), 1).astype(np.float32)
    noise = rng.normal(0, 0.08, (30, 40)).astype(np.float32)
    depth = depth_from_disparity(d, noise, np.zeros(d.shape, bool), np.float32(1 / 32), np.float32(50))
    steps = 50 / depth.astype(float) * 32
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-3)
    assert np.abs(50 / depth - d[1:-1, 1:-1] - noise).max() <= 0.5 / 32 + 1e-4


@pytest.mark.parametrize(("name", "tolerance"), [("d415", 1e-4), ("photoneo", 1e-5)])
def test_planes_are_unbiased(name: str, tolerance: float, monkeypatch: pytest.MonkeyPatch) -> None:
    without_calibration_errors(monkeypatch, name)
    for view in (wall(CAMERA, 0.8137), plane(CAMERA, (0.3, -0.6, 1), 0.7)):
        depth = sense(name, view, stream(7)).depth
        valid = depth > 0
        assert abs(np.mean(depth[valid].astype(float) - view.depth[valid])) < tolerance  # noise: 1 mm and 0.1 mm


def test_depth_scale_is_uniform_within_its_bound() -> None:
    ratios = []
    for seed in range(200):
        depth = sense("d415", wall(SMALL, 1.0), stream(seed)).depth
        ratios.append(np.mean(depth[depth > 0].astype(float)) - 1)
    tolerance = 3e-4  # of the mean of so few pixels
    assert np.abs(ratios).max() < D415.scale_error + tolerance
    assert np.abs(np.mean(ratios)) < 3 * D415.scale_error / np.sqrt(3 * 200)
    assert np.std(ratios) == pytest.approx(D415.scale_error / np.sqrt(3), rel=0.12)


@pytest.mark.parametrize("name", ["d415", "photoneo"])
def test_the_recorded_pose_has_the_stated_error(name: str) -> None:
    true = look_at((0.5, 0.2, 0.6), (0, 0, 0))
    view = View(TINY, true, np.ones((6, 8), np.float32))
    errors = [true.inverse() @ sense(name, view, stream(seed)).world_from_camera for seed in range(600)]
    shift = np.array([error.xyz for error in errors])
    rotvec_deg = np.degrees([error.rotvec() for error in errors])
    for error, stated in ((shift, SENSORS[name].position_error), (rotvec_deg, SENSORS[name].rotation_error_deg)):
        assert np.sqrt(np.mean(np.sum(error**2, axis=1))) == pytest.approx(stated, rel=0.06)
        assert np.abs(error.mean(axis=0)).max() < 4 * stated / np.sqrt(3 * 600)
        np.testing.assert_allclose(error.std(axis=0), stated / np.sqrt(3), rtol=0.15)


@pytest.mark.parametrize(("name", "class_mm"), [("d415", 5.0), ("photoneo", 0.5)])
def test_all_errors_together_are_of_the_stated_class(name: str, class_mm: float) -> None:
    """19 of 20 measured points of a plane are within about 5 mm and 0.5 mm of the true ones."""
    view = wall(SMALL, 0.8)
    true, errors = SMALL.unproject(view.depth), []
    for seed in range(100):
        measured = sense(name, view, stream(seed, "class"))
        valid = measured.depth > 0
        points = measured.world_from_camera.apply(SMALL.unproject(measured.depth)[valid])
        errors.append(np.linalg.norm(points - true[valid], axis=1)[::50])
    assert np.percentile(np.concatenate(errors), 95) == pytest.approx(class_mm * 1e-3, rel=0.15)


def two_walls(near: float, far: float) -> np.ndarray:
    """Disparities, with the border, of a far wall and of a near one in front of columns 250 to 389."""
    depth = np.full((40, 400), far, np.float32)
    depth[:, 250:390] = near
    return disparity_from_depth(depth, np.float32(GAIN))


@given(near=st.floats(0.4, 0.9), behind=st.floats(0.05, 1.0))
@settings(max_examples=30)
def test_shadows_are_left_of_near_bodies_and_as_wide_as_the_step_in_disparity(near: float, behind: float) -> None:
    band = int(np.ceil(GAIN / (near + behind)))  # columns outside the other image
    columns = np.flatnonzero(occlusion_mask(two_walls(near, near + behind), 0.0)[20, 1:-1][band + 1 :]) + band + 1
    step = GAIN / near - GAIN / (near + behind)
    assert columns.size == pytest.approx(step, abs=1.0)
    np.testing.assert_array_equal(columns, np.arange(250 - columns.size, 250))


@pytest.mark.parametrize(("polar", "radius"), [(0.5, 0.6), (0.9, 0.8), (1.25, 0.9)])
def test_shadows_are_invisible_in_a_second_rendering(polar: float, radius: float) -> None:
    view = scene(radius, polar)
    d = disparity_from_depth(view.depth, np.float32(GAIN))
    occluded = occlusion_mask(d, 0.0)[1:-1, 1:-1]
    other = boxes(CAMERA, view.world_from_camera @ Pose.from_translation(np.array([D415.baseline, 0, 0])))
    v, u = np.nonzero(view.depth)
    x = u - GAIN / view.depth[v, u]
    column = np.floor(x + 0.5).astype(int)
    inside = (column >= 0) & (column < CAMERA.width)
    other_depth = np.zeros(len(u))
    other_depth[inside] = other.depth[v[inside], column[inside]]
    nearer = other_depth < GAIN / (GAIN / view.depth[v, u] + EDGE_STEP)
    invisible = ~inside | ((other_depth > 0) & nearer)
    assert 0.01 < invisible.mean() < 0.2
    assert np.mean(occluded[v, u] != invisible) < 0.002  # pixels that straddle an outline


def test_converging_imagers_lose_the_opposite_border() -> None:
    d = disparity_from_depth(np.full((3, 200), 1.0, np.float32), np.float32(50))
    assert list(np.flatnonzero(occlusion_mask(d, 0.0)[2, 1:-1])) == list(range(50))
    assert not occlusion_mask(d, 50.0)[2].any()
    assert list(np.flatnonzero(occlusion_mask(d, 80.0)[2, 1:-1])) == list(range(170, 200))


def smooth_field(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    white = np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)
    smooth = box_blur(box_blur(white, 7), 7)
    return smooth / smooth.std()


def test_edges_are_fattened_outward_by_at_most_half_the_window() -> None:
    d = two_walls(0.6, 1.0)
    fattened = fatten_edges(d, smooth_field((20, 200)), 6.0)
    near, far = d[20, 300], d[20, 20]
    assert set(np.unique(fattened[1:-1, 1:-1])) == {near, far}
    assert (fattened >= d).all()
    covered = (fattened == near)[1:-1, 1:-1]
    columns = np.flatnonzero(covered.any(axis=0))
    assert columns.min() >= 250 - 6
    assert columns.max() <= 389 + 6
    widths = covered.sum(axis=1) - 140
    assert 4 < widths.mean() < 11  # both sides together; 12 at most
    assert widths.std() > 0.5  # irregular


def test_fattened_surfaces_continue_in_their_own_plane() -> None:
    v, u = np.mgrid[:60, :80]
    d = np.pad(np.where(u < 40, 60 + 0.2 * u - 0.3 * v, 20), 1).astype(np.float32)
    fattened = fatten_edges(d, smooth_field((30, 40)), 6.0)[1:-1, 1:-1]
    changed = fattened != d[1:-1, 1:-1]
    assert changed.any()
    np.testing.assert_allclose(fattened[changed], (60 + 0.2 * u - 0.3 * v)[changed], atol=1e-3)


@pytest.mark.parametrize("polar", [0.5, 0.9, 1.25])
def test_fattening_only_reduces_depth_and_fills_no_hole(polar: float) -> None:
    d = disparity_from_depth(scene(polar=polar).depth, np.float32(GAIN))
    fattened = fatten_edges(d, smooth_field((360, 640)), 6.0)
    changed = fattened != d
    assert 0 < changed.mean() < 0.02
    assert (fattened[changed] > d[changed] + EDGE_STEP).all()
    assert not fattened[d == 0].any()


@given(a=st.floats(-0.3, 0.3), b=st.floats(-0.3, 0.3), cut=st.integers(5, 35))
@settings(max_examples=25)
def test_blending_changes_no_plane_and_no_high_edge(a: float, b: float, cut: int) -> None:
    v, u = np.mgrid[:30, :40]
    d = np.pad(np.where(u < cut, 60 + a * u + b * v, 20 - b * u), 1).astype(np.float32)
    np.testing.assert_allclose(blend_windows(d, 7), d, atol=2e-5)


def test_blending_rounds_low_steps_over_one_window() -> None:
    row = np.where(np.arange(42) < 20, 50.0, 50.6).astype(np.float32)
    d = np.tile(row, (30, 1))
    expected = np.convolve(row, np.ones(7) / 7, "valid")
    np.testing.assert_allclose(blend_windows(d, 7)[15, 3:-3], expected, atol=1e-4)


@pytest.mark.parametrize("tilt_deg", [60, 72, 78, 81, 84, 88])
def test_returns_fail_at_grazing_angles_with_the_stated_probability(tilt_deg: float) -> None:
    tilt = np.radians(tilt_deg)
    normal = np.array([np.sin(tilt) * 0.6, np.sin(tilt) * 0.8, np.cos(tilt)])
    view = plane(SMALL, tuple(normal), 0.8)
    ray = rays(SMALL)
    incidence = np.degrees(np.arccos(np.clip(ray @ normal / np.linalg.norm(ray, axis=-1), 0, 1)))
    start, end = D415.grazing_deg
    expected = np.clip((incidence - start) / (end - start), 0, 1)[1:-1, 1:-1]
    d = disparity_from_depth(view.depth, np.float32(GAIN))
    intrinsics = (SMALL.fx, SMALL.fy, SMALL.cx, SMALL.cy)
    limits = np.radians((start, end))
    masks = [grazing_mask(d, intrinsics, smooth_field((60, 80), seed), *limits) for seed in range(300)]
    missing = np.mean(masks, axis=0)[2:-2, 2:-2]
    visible = view.depth[1:-1, 1:-1] > 0
    assert missing[visible].mean() == pytest.approx(expected[visible].mean(), abs=0.02)
    assert not missing[visible & (expected == 0)].any()
    assert (missing[visible & (incidence[1:-1, 1:-1] > end + 0.1)] == 1).all()


def test_only_grazing_shadowed_or_distant_surfaces_give_no_return() -> None:
    view = plane(CAMERA, (0.1, -0.7, 1), 0.8)
    depth = sense("d415", view, stream(0)).depth
    inside = np.arange(1280)[None] - GAIN / view.depth > 0
    assert (depth[inside] > 0).all()
    assert not depth[np.arange(1280)[None] - GAIN / view.depth < -1].any()


def test_the_scanner_casts_wider_shadows_and_less_noise_than_the_stereo_camera() -> None:
    view = scene()
    stereo, scanner = (sense(name, view, stream(3)).depth for name in ("d415", "photoneo"))
    middle = (slice(100, 620), slice(250, 1000))
    visible = view.depth[middle] > 0
    assert (scanner[middle][visible] == 0).mean() > 2 * (stereo[middle][visible] == 0).mean()
    rms = [np.median(np.abs(depth - view.depth)[depth > 0]) for depth in (stereo, scanner)]
    assert rms[0] > 5 * rms[1]
