"""Depth sensors, their stereo images and noise: ideal depth, errors of the stated size, equal draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.stats import norm

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.noise_fields import add_enlarged, smooth_field, uniform_of, windowed_noise
from kit1000.sim.render import render
from kit1000.sim.sensors import (
    BENDING_AT,
    DEPTH_GRID,
    SENSORS,
    Conditions,
    Sensor,
    conditions_of,
    measured_view,
    sense,
    with_calibration,
)
from kit1000.sim.stereo import EDGE_STEP, disparity_from_depth, grazing_mask, occlusion_mask
from kit1000.values import View

CAMERA = Camera(1280, 720, 925.0, 925.0, 639.5, 359.5)
SMALL = Camera(320, 240, 925.0, 925.0, 159.5, 119.5)
TINY = Camera(8, 6, 925.0, 925.0, 3.5, 2.5)
D415, PHOTONEO = SENSORS["d415"], SENSORS["photoneo"]
NOISY = ("d415", "photoneo")
GAIN = CAMERA.fx * D415.baseline  # [px m]
NOISELESS = Sensor(baseline=D415.baseline)
CALM = Conditions(noise_px=0.0, fixed_share=0.0, bending_px=0.0, unit=0.0, stream="raw")


def wall(camera: Camera, distance: float) -> View:
    return View(camera, Pose.identity(), np.full((camera.height, camera.width), distance, np.float32))


def step_of(jump_px: float, camera: Camera = SMALL, far: float = 0.8, where: int = 180) -> View:
    """A far wall, and from column `where` to 40 px more one that is nearer by a jump of disparity [px]."""
    depth = np.full((camera.height, camera.width), far)
    depth[:, where : where + 40] = GAIN / (GAIN / far + jump_px)
    return View(camera, Pose.identity(), depth.astype(np.float32))


def disparities(view: View, baseline: float = D415.baseline) -> np.ndarray:
    """(H, W) [px], NaN without a return."""
    depth = view.depth.astype(float)
    return np.where(depth > 0, view.camera.fx * baseline / np.where(depth > 0, depth, 1), np.nan)


def residual_px(view: View, sensor: Sensor, conditions: Conditions, seed: int) -> np.ndarray:
    """Measured minus true disparity, away from the invalid band and the border."""
    measured = measured_view(with_calibration(sensor), view, conditions, stream(seed))
    away = disparities(measured, sensor.baseline) - disparities(view, sensor.baseline)
    return away[30:-30, 150:-30]


@pytest.mark.parametrize("name", SENSORS)
def test_the_number_of_draws_depends_on_the_image_size_alone(name: str) -> None:
    after = []
    for view in (step_of(4.0), wall(SMALL, 0.7), View(SMALL, Pose.identity(), np.zeros((240, 320), np.float32))):
        rng = stream(8)
        sense(name, view, rng)
        after.append(rng.random())
    assert len(set(after)) == 1


@pytest.mark.parametrize("jump", [0.0, 1.5, 4.0, 12.0])
def test_without_errors_what_is_seen_is_ideal(jump: float) -> None:
    view = step_of(jump)
    depth = measured_view(NOISELESS, view, CALM, stream(0)).depth
    seen = depth > 0
    assert np.abs(depth.astype(float) - view.depth)[seen].max() <= DEPTH_GRID / 2 + 1e-6
    assert seen[:, 70:].mean() == pytest.approx(1 - jump / 250, abs=0.01)  # all but the shadow


@pytest.mark.parametrize("name", NOISY)
def test_conditions_stay_within_their_ranges(name: str) -> None:
    sensor = SENSORS[name]
    drawn = [conditions_of(sensor, stream(seed)) for seed in range(400)]
    noise = np.array([each.noise_px for each in drawn])
    low, high = sensor.amplitude_px
    assert low <= noise.min() < 1.05 * low
    assert 0.95 * high < noise.max() <= high
    assert np.log(noise).mean() == pytest.approx(np.log(low * high) / 2, abs=0.05)  # log-uniform
    for values, (least, most) in (
        ([each.fixed_share for each in drawn], sensor.fixed_share),
        ([each.ramp_px for each in drawn], sensor.ramp_px),
        ([each.hole_share for each in drawn], sensor.hole_share),
        ([each.bending_px / np.sqrt(each.noise_px / BENDING_AT) for each in drawn], sensor.bending_px),
    ):
        assert min(values) >= least - 1e-12
        assert max(values) <= most + 1e-12
    assert {each.unit for each in drawn} == set(sensor.units)


@pytest.mark.parametrize(("sensor", "rms"), [(D415, 0.1), (D415, 0.3), (PHOTONEO, 0.06)])
def test_noise_on_a_plane_has_its_amplitude_at_every_distance(sensor: Sensor, rms: float) -> None:
    conditions = replace(CALM, noise_px=rms)
    for distance in (0.5, 0.9):
        away = np.concatenate([residual_px(wall(CAMERA, distance), sensor, conditions, seed) for seed in range(2)])
        grid = sensor.baseline * CAMERA.fx / distance**2 * DEPTH_GRID
        expected = np.sqrt(rms**2 + sensor.subpixel_px**2 / 12 + grid**2 / 12)
        assert np.sqrt(np.nanmean(away**2)) == pytest.approx(expected, rel=0.06)
        assert abs(np.nanmean(away)) < 0.06 * rms


def test_noise_of_the_d415_is_wider_across_than_down_and_that_of_the_scanner_is_white() -> None:
    def correlation(sensor: Sensor, axis: int, lag: int) -> float:
        fields = [residual_px(wall(CAMERA, 0.7), sensor, replace(CALM, noise_px=0.2), seed) for seed in range(2)]
        ahead, behind = (np.s_[lag:], np.s_[:-lag]) if axis == 0 else (np.s_[:, lag:], np.s_[:, :-lag])
        return float(np.mean([np.nanmean(f[ahead] * f[behind]) / np.nanvar(f) for f in fields]))

    across, down = correlation(D415, 1, 8), correlation(D415, 0, 8)
    assert 0.6 < across < 0.8  # of the whole image; tiles of 48 px less their own plane have 0.5 at 7 to 8 px
    assert down < across - 0.05
    assert correlation(D415, 1, 40) < 0.1
    assert all(abs(correlation(PHOTONEO, axis, lag)) < 0.02 for axis in (0, 1) for lag in (1, 3))


def test_bending_is_smooth_and_has_its_amplitude() -> None:
    fields = np.stack([residual_px(wall(CAMERA, 0.8), D415, replace(CALM, bending_px=0.2), seed) for seed in range(4)])
    assert np.sqrt(np.mean(fields**2)) == pytest.approx(0.2, rel=0.25)  # few patches an image
    assert np.abs(np.diff(fields, axis=2)).mean() < 0.03  # rounding of disparities alone


def test_frames_lower_the_changing_part_alone() -> None:
    conditions = replace(CALM, noise_px=0.2, fixed_share=0.16)
    assert conditions.left_px == pytest.approx(0.2)
    assert replace(conditions, frames=10**9).left_px == pytest.approx(0.08)
    assert replace(conditions, frames=30).left_px == pytest.approx(0.2 * np.sqrt(0.16 + 0.84 / 30))
    bent = replace(CALM, bending_px=0.1)
    one, many = (residual_px(wall(CAMERA, 0.7), D415, replace(bent, frames=n), 2) for n in (1, 100))
    assert np.corrcoef(one.ravel(), many.ravel())[0, 1] > 0.98
    assert np.std(many) == pytest.approx(np.std(one), rel=0.05)


@pytest.mark.parametrize("unit", [1e-3, 1e-4])
def test_depths_of_one_frame_are_multiples_of_the_unit(unit: float) -> None:
    conditions = replace(CALM, noise_px=0.2, unit=unit)
    depth = measured_view(with_calibration(D415), wall(SMALL, 0.7), conditions, stream(1)).depth.astype(float)
    away = np.abs(depth - unit * np.rint(depth / unit))
    assert away.max() <= DEPTH_GRID / 2 + 1e-6
    assert len(np.unique(depth)) > 5


def between_px(view: View, conditions: Conditions, seed: int = 0) -> np.ndarray:
    """(H,) pixels of each row, right of the near wall, between both surfaces."""
    sensor = replace(D415, fattening_px=0.0, hole_share=(0.0, 0.0))
    d = disparities(measured_view(with_calibration(sensor), view, conditions, stream(seed)))[40:-40]
    near, far = np.nanmedian(d[:, 195:205]), np.nanmedian(d[:, 260:280])
    share = (d[:, 205:240] - far) / (near - far)
    return ((share > 0.1) & (share < 0.9)).sum(1)


def test_small_jumps_become_ramps_and_large_ones_stay_sharp() -> None:
    conditions = replace(CALM, ramp_px=4.0)
    ramps = between_px(step_of(1.5), conditions)
    assert 4 <= ramps.mean() <= 9
    assert ramps.std() > 0.2  # the width varies along the edge
    assert between_px(step_of(8.0), conditions).max() == 0


@pytest.mark.parametrize(("sensor", "left"), [(D415, True), (PHOTONEO, False)])
def test_shadows_lie_on_the_side_of_the_sensor(sensor: Sensor, left: bool) -> None:
    sensor = replace(sensor, fattening_px=0.0, ramp_px=(0.0, 0.0), shadow_px=0, convergence=np.inf)
    depth = np.full((240, 1280), 0.8)
    depth[:, 400:640] = 0.6
    camera = replace(SMALL, width=1280, cx=639.5)
    missing = measured_view(sensor, View(camera, Pose.identity(), depth.astype(np.float32)), CALM, stream(0)).depth == 0
    jump = camera.fx * sensor.baseline * (1 / 0.6 - 1 / 0.8)
    beside = (missing[:, 250:400] if left else missing[:, 640:790]).sum(1)
    other = missing[:, 640:650] if left else missing[:, 390:400]
    assert beside.mean() == pytest.approx(jump, abs=1.0)
    assert not other.any()


def test_shadows_are_wider_by_shadow_px_and_in_an_aligned_stream_by_the_place_of_the_colour_camera() -> None:
    bare = replace(D415, fattening_px=0.0, ramp_px=(0.0, 0.0), shadow_px=0)

    def width(sensor: Sensor, conditions: Conditions) -> float:
        depth = measured_view(sensor, step_of(11.0, CAMERA, where=600), conditions, stream(0)).depth
        return float((depth[100:-100, 500:600] == 0).sum(1).mean())

    narrow = width(bare, CALM)
    assert narrow == pytest.approx(11, abs=1)
    assert width(replace(bare, shadow_px=2), CALM) == narrow + 2
    assert width(bare, replace(CALM, stream="aligned")) == pytest.approx(11 * 70 / 55, abs=1.5)


def test_holes_come_on_every_side_in_their_share_and_nowhere_else() -> None:
    sensor = replace(NOISELESS, hole_jump_px=1.5, hole_px=5)
    depth = np.full((240, 320), 0.8)
    depth[60:180, 120:260] = GAIN / (GAIN / 0.8 + 2.0)
    view = View(SMALL, Pose.identity(), depth.astype(np.float32))
    shares, far_off = [], 0
    for seed in range(12):
        missing = measured_view(sensor, view, replace(CALM, hole_share=0.3), stream(seed)).depth == 0
        sides = missing[70:170, 257:263].any(1), missing[57:63, 130:250].any(0), missing[177:183, 130:250].any(0)
        shares.append([side.mean() for side in sides])
        far_off += int(missing[70:170, 130:250].sum())
    assert np.mean(shares, axis=0) == pytest.approx(0.33, abs=0.12)
    assert far_off == 0
    whole = measured_view(sensor, step_of(1.0), replace(CALM, hole_share=1.0), stream(0)).depth
    assert (whole[:, 80:] > 0).all()  # no jump over hole_jump_px


def test_a_slanted_plane_passes_edges_and_ramps_unchanged() -> None:
    v, u = np.mgrid[:240, :320]
    d = (60 + 0.2 * u - 0.1 * v).astype(np.float32)
    view = View(SMALL, Pose.identity(), (np.float32(GAIN) / d).astype(np.float32))
    sensor = replace(D415, grazing_deg=(89.0, 90.0), subpixel_px=0.0)
    measured = measured_view(with_calibration(sensor), view, replace(CALM, ramp_px=9.0, hole_share=0.5), stream(0))
    away = (disparities(measured) - d)[:, 130:]
    assert np.isfinite(away).all()
    assert np.abs(away).max() < 0.02  # the grid of depths


def test_depth_scale_and_recorded_pose_have_the_stated_errors() -> None:
    view = wall(TINY, 1.0)
    shifts, angles = [], []
    for seed in range(300):
        error = sense("d415", view, stream(seed)).world_from_camera
        shifts.append(np.sum(np.square(error.xyz)))
        angles.append(np.sum(np.square(np.degrees(error.rotvec()))))
    assert np.sqrt(np.mean(shifts)) == pytest.approx(D415.position_error, rel=0.1)
    assert np.sqrt(np.mean(angles)) == pytest.approx(D415.rotation_error_deg, rel=0.1)
    ratios = [
        np.mean(measured_view(D415, wall(SMALL, 1.0), CALM, stream(seed)).depth[100:140, 100:].astype(float))
        for seed in range(60)
    ]
    assert np.abs(np.array(ratios) - 1).max() < D415.scale_error + DEPTH_GRID


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
def test_pixels_show_the_surfaces_that_they_look_at(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a bowl of four planes, which distinguishes an offset of the image from an error of scale."""
    monkeypatch.setitem(SENSORS, name, replace(SENSORS[name], bending_px=(0.0, 0.0)))  # bending shifts planes too
    rays = CAMERA.unproject(np.ones((CAMERA.height, CAMERA.width)))
    offset = rays[..., :2] - (0.12, -0.07)  # from the middle of the bowl; a mirrored image would differ
    true = 1 / (1 + np.abs(offset).sum(axis=-1))
    view = View(CAMERA, Pose.identity(), true.astype(np.float32))
    error = sense(name, view, np.random.default_rng(0)).depth - true
    returned = error > -0.1
    assert returned.mean() > 0.5
    median = np.median(np.abs(error[returned]))
    assert median < 0.01  # [m]
    kept = returned & (np.abs(error) <= 4 * median + DEPTH_GRID)
    slopes = -np.sign(offset[kept]) * (true[kept] ** 2)[:, None] / (CAMERA.fx, CAMERA.fy)  # [m/px]
    basis = np.column_stack([true[kept], slopes])
    shift = np.linalg.lstsq(basis.T @ basis, basis.T @ error[kept], rcond=None)[0][1:]
    assert np.abs(shift).max() <= 0.25  # [px]


SMALL_STEREO = Camera(160, 120, 925.0, 925.0, 79.5, 59.5)


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


@pytest.mark.parametrize("tilt_deg", [60, 72, 78, 81, 84, 88])
def test_returns_fail_at_grazing_angles_with_the_stated_probability(tilt_deg: float) -> None:
    tilt = np.radians(tilt_deg)
    normal = np.array([np.sin(tilt) * 0.6, np.sin(tilt) * 0.8, np.cos(tilt)])
    view = plane(SMALL_STEREO, tuple(normal), 0.8)
    ray = rays(SMALL_STEREO)
    incidence = np.degrees(np.arccos(np.clip(ray @ normal / np.linalg.norm(ray, axis=-1), 0, 1)))
    start, end = D415.grazing_deg
    expected = np.clip((incidence - start) / (end - start), 0, 1)[1:-1, 1:-1]
    d = disparity_from_depth(view.depth, np.float32(GAIN))
    intrinsics = (SMALL_STEREO.fx, SMALL_STEREO.fy, SMALL_STEREO.cx, SMALL_STEREO.cy)
    limits = np.radians((start, end))
    masks = [
        grazing_mask(d, intrinsics, smooth_field(np.random.default_rng(seed), (60, 80), 5), *limits)
        for seed in range(300)
    ]
    missing = np.mean(masks, axis=0)[2:-2, 2:-2]
    visible = view.depth[1:-1, 1:-1] > 0
    assert missing[visible].mean() == pytest.approx(expected[visible].mean(), abs=0.02)
    assert not missing[visible & (expected == 0)].any()
    assert (missing[visible & (incidence[1:-1, 1:-1] > end + 0.1)] == 1).all()


@pytest.mark.parametrize("windows", [(1, 1), (13, 9), (5, 1)])
def test_windowed_noise_has_unit_variance_and_the_correlation_of_its_windows(windows: tuple[int, int]) -> None:
    field = np.stack([windowed_noise(stream(seed), (480, 640), windows) for seed in range(4)])
    assert field.dtype == np.float32
    assert np.std(field) == pytest.approx(1, abs=0.03)
    for axis, width in ((2, windows[0]), (1, windows[1])):
        kernel = np.convolve(np.ones(width), np.ones(width))
        tail = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :] / np.sum(kernel**2)
        for lag in (1, 4, 8):
            expected = tail[lag] if lag < len(tail) else 0
            assert np.mean(field * np.roll(field, lag, axis)) == pytest.approx(expected, abs=0.04)


def test_the_share_below_a_normal_value_is_its_distribution() -> None:
    values = np.linspace(-6, 6, 4001, dtype=np.float32)[None]
    shares = uniform_of(values)[0]
    np.testing.assert_allclose(shares, norm.cdf(values[0]), atol=3e-3)
    assert (np.diff(shares) >= 0).all()
    assert shares.min() >= 0
    assert shares.max() <= 1


@pytest.mark.parametrize(("shape", "factor"), [((12, 20), 4), ((13, 21), 4), ((9, 9), 8), ((6, 7), 2)])
def test_an_enlarged_field_is_bilinear_between_its_values(shape: tuple[int, int], factor: int) -> None:
    coarse = tuple(-(-n // factor) for n in shape)
    field = np.random.default_rng(1).standard_normal(coarse).astype(np.float32)
    out = np.ones(shape, np.float32)
    add_enlarged(out, field, factor, np.float32(3))
    np.testing.assert_allclose(out[::factor, ::factor], 1 + 3 * field, atol=1e-5)
    wrapped = np.pad(field, ((0, 1), (0, 1)), mode="wrap")
    for v in range(shape[0]):
        for u in range(shape[1]):
            (y, b), (x, a) = divmod(v, factor), divmod(u, factor)
            a, b = a / factor, b / factor
            four = wrapped[y : y + 2, x : x + 2].astype(float)
            expected = 1 + 3 * (np.array([1 - b, b]) @ four @ np.array([1 - a, a]))
            assert out[v, u] == pytest.approx(expected, abs=1e-5)


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) points at depth 1 m behind each pixel centre."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def plane(camera: Camera, normal: tuple[float, float, float], distance: float) -> View:
    """An infinite plane that intersects the optical axis at `distance`; depth 0 where it is invisible."""
    facing = rays(camera) @ np.asarray(normal)
    visible = facing * normal[2] > 1e-3
    depth = np.where(visible, distance * normal[2] / np.where(visible, facing, 1), 0)
    return View(camera, Pose.identity(), depth.astype(np.float32))


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
    """The boxes from a distance [m], at an angle [rad] from straight above."""
    return boxes(CAMERA, look_at((radius * np.sin(polar), 0, radius * np.cos(polar)), (0, 0, 0)))
