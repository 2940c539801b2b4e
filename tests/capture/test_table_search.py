"""The table of an image: found under noise, whatever else is in view, and the same plane however the image lies."""

from __future__ import annotations

import numpy as np
import pytest

from kit1000.camera import look_at
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.pinhole_images import PinholeImage, pinhole_image
from kit1000.capture.table_search import Table, find_table
from kit1000.errors import InputError
from tests.samples.own_images import CAMERA, EYE, KIT, exact_depth, noisy_depth

KNOWN = Intrinsics(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)


def image_of(depth: np.ndarray) -> PinholeImage:
    return pinhole_image(depth, KNOWN, "depth.png")


def errors(table: Table, height: float, up: np.ndarray) -> tuple[float, float]:
    """[m] and degrees."""
    angle = np.degrees(np.arccos(np.clip(table.up @ up, -1, 1)))
    return abs(table.distance - height), float(angle)


@pytest.mark.parametrize("noise_px", [0.0, 0.05, 0.2])
def test_the_table_is_found_under_noise(noise_px: float) -> None:
    table = find_table(image_of(noisy_depth(exact_depth(), noise_px)), "x")
    distance, angle = errors(table, float(EYE.xyz[2]), EYE.inverse().rotate((0.0, 0.0, 1.0)))
    assert distance < 0.3e-3 + 2e-3 * noise_px
    assert angle < 0.02 + 0.3 * noise_px
    assert 0.4 < table.share < 1
    assert abs(table.ripple - noise_px * 0.85**2 / (CAMERA.fx * 0.055)) < 0.5e-3 + 0.3e-2 * noise_px


def test_an_image_turned_upside_down_has_the_same_table() -> None:
    depth = noisy_depth(exact_depth(), 0.05)
    turned = Intrinsics(CAMERA.fx, CAMERA.fy, CAMERA.width - 1 - CAMERA.cx, CAMERA.height - 1 - CAMERA.cy)
    here = find_table(image_of(depth), "x")
    there = find_table(pinhole_image(depth[::-1, ::-1].copy(), turned, "x"), "x")
    assert abs(here.distance - there.distance) < 0.5e-3
    np.testing.assert_allclose(there.up, here.up * (-1, -1, 1), atol=2e-3)


def test_a_face_of_a_body_is_not_the_table() -> None:
    large = ((0.25, 0.2, 0.09), (0.0, 0.02))
    table = find_table(image_of(noisy_depth(exact_depth((large,)), 0.05)), "x")
    assert errors(table, float(EYE.xyz[2]), EYE.inverse().rotate((0.0, 0.0, 1.0)))[0] < 1e-3


def test_heights_are_those_of_the_bodies() -> None:
    table = find_table(image_of(exact_depth()), "x")
    (_, _, height), (x, y) = KIT
    u, v = np.rint(CAMERA.project(EYE.inverse().apply((x, y, height)))).astype(int)
    assert table.heights[v, u] == pytest.approx(height, abs=0.3e-3)
    assert table.flat_heights[v, u] == pytest.approx(height, abs=0.5e-3)


def test_a_wall_is_no_table() -> None:
    level = look_at((0.0, -0.5, 0.02), (0.0, 0.0, 0.0))  # the table is seen at 2 degrees
    with pytest.raises(InputError, match="table in view"):
        find_table(image_of(exact_depth((), level)), "x")


def test_rough_ground_is_no_table() -> None:
    rough = np.random.default_rng(0).uniform(0.4, 1.5, (480, 640)).astype(np.float32)
    with pytest.raises(InputError, match=r"x: .*table in view"):
        find_table(image_of(rough), "x")
