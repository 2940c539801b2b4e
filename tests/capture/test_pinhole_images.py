"""Recorded depths as a pinhole camera would have seen them: never interpolated, distortion undone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kit1000.capture.intrinsics import Intrinsics, distorted
from kit1000.capture.pinhole_images import FOCAL, pinhole_image
from kit1000.errors import InputError

PLANE = np.array([0.1, -0.4, 1.4])  # [1/m] inverse depth is its product with a ray


def plane_depth(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(H, W) [m] depths of the plane along rays x, y, 1."""
    return (1 / (PLANE[0] * x + PLANE[1] * y + PLANE[2])).astype(np.float32)


def test_an_image_near_the_focal_length_stays_as_it_is() -> None:
    depth = np.random.default_rng(0).uniform(0.5, 1, (481, 641)).astype(np.float32)
    image = pinhole_image(depth, Intrinsics(900, 905, 320, 240), "x")
    assert image.depth.shape == (480, 640)  # previews have half as many columns and rows
    np.testing.assert_array_equal(image.depth, depth[:480, :640])
    assert image.enlarged == 1


@settings(max_examples=10)
@given(st.floats(300, 2200), st.integers(70, 200), st.integers(70, 200))
def test_every_pixel_has_a_recorded_depth_that_its_ray_met(fx: float, width: int, height: int) -> None:
    fx = min(fx, 20.0 * width)  # longer ones are of no depth camera
    known = Intrinsics(fx, fx * 1.01, width * 0.5, height * 0.45)
    v, u = np.indices((height, width))
    depth = plane_depth((u - known.cx) / known.fx, (v - known.cy) / known.fy)
    image = pinhole_image(depth, known, "x")
    camera = image.camera
    v, u = np.indices(image.depth.shape)
    expected = plane_depth((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    step = 0.51 * (1 + 0.5) * np.abs(PLANE[:2] * expected.max() ** 2).sum() / fx
    seen = image.depth > 0
    assert seen.mean() > 0.95
    assert np.abs(image.depth - expected)[seen].max() < step + 1e-6
    assert np.isin(image.depth[seen], depth).all()
    assert camera.fx == pytest.approx(FOCAL, rel=0.26)
    assert camera.width % 2 == camera.height % 2 == 0


def test_distortion_is_undone() -> None:
    coefficients = (-0.2, 0.05, 1e-3, -1e-3, 0.01)
    known = Intrinsics(900, 900, 320, 240, coefficients=coefficients)
    straight = Intrinsics(900, 900, 320, 240)
    v, u = np.indices((480, 640))
    x, y = (u - 320) / 900, (v - 240) / 900
    seen_x, seen_y = x, y
    for _ in range(50):  # the ray that is seen at each pixel
        across, down = distorted(seen_x, seen_y, coefficients)
        seen_x, seen_y = seen_x + x - across, seen_y + y - down
    recorded = plane_depth(seen_x, seen_y)
    undone, ignored = pinhole_image(recorded, known, "x"), pinhole_image(recorded, straight, "x")
    right = plane_depth(x, y)
    inside = undone.depth > 0
    wrong = [np.abs(image.depth - right)[inside].max() for image in (undone, ignored)]
    assert wrong[0] < 0.6e-3 < 1e-3 < wrong[1]
    assert inside.mean() > 0.9


def test_a_model_that_cannot_be_undone_is_refused() -> None:
    known = Intrinsics(900, 900, 320, 240, model="equidistant", coefficients=(0.1, 0, 0, 0))
    with pytest.raises(InputError, match="equidistant"):
        pinhole_image(np.ones((480, 640), np.float32), known, "x")


def test_distortion_of_another_camera_is_refused() -> None:
    known = Intrinsics(900.0, 905.0, 322.3, 238.1, coefficients=(1e6, 1e6, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"--intrinsics: its distortion maps most of a\.png outside"):
        pinhole_image(np.full((480, 640), 0.8, np.float32), known, "a.png")
