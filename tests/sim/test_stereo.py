"""The loops of triangulation: shadows against a second rendering, losses at grazing angles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.camera import Camera
from kit1000.pose import Pose
from kit1000.sim.noise_fields import smooth_field
from kit1000.sim.sensors import SENSORS
from kit1000.sim.stereo import EDGE_STEP, disparity_from_depth, grazing_mask, occlusion_mask
from tests.samples.depth_scenes import CAMERA, boxes, plane, rays, scene

SMALL = Camera(160, 120, 925.0, 925.0, 79.5, 59.5)
D415 = SENSORS["d415"]
GAIN = CAMERA.fx * D415.baseline  # [px m]


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
    masks = [
        grazing_mask(d, intrinsics, smooth_field(np.random.default_rng(seed), (60, 80), 5), *limits)
        for seed in range(300)
    ]
    missing = np.mean(masks, axis=0)[2:-2, 2:-2]
    visible = view.depth[1:-1, 1:-1] > 0
    assert missing[visible].mean() == pytest.approx(expected[visible].mean(), abs=0.02)
    assert not missing[visible & (expected == 0)].any()
    assert (missing[visible & (incidence[1:-1, 1:-1] > end + 0.1)] == 1).all()
