"""Bending: a smooth error of the table's disparities is taken off bodies too; noise alone changes nothing there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.camera import look_at
from kit1000.perception.calibration import flattened, unbent
from kit1000.perception.calibration.table import correlated_in, table_plane, table_residuals
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA
from kit1000.values import LabelledDepth, View

BASELINE = 0.055
GAIN = CAMERA.fx * BASELINE
BODY = np.s_[280:440, 560:720]
LABELS = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
LABELS[BODY] = 1
NOISE = 0.05  # [px]

D415, SCANNER = simulated_sensor("d415"), simulated_sensor("photoneo")


@pytest.fixture(scope="module")
def flat() -> View:
    """The table, and a body whose top is 3 % nearer to the camera than the table behind it."""
    pose = look_at((0.15, 0.0, 0.7), (0.0, 0.0, 0.0))
    nothing = View(CAMERA, pose, np.zeros(LABELS.shape, np.float32))
    table = flattened(nothing, np.zeros_like(LABELS))
    return replace(table, depth=np.where(LABELS == 1, table.depth * np.float32(0.97), table.depth))


def measured(view: View, error: np.ndarray) -> View:
    """The view with an error of its disparities (H, W) [px]."""
    disparity = GAIN / np.where(view.depth > 0, view.depth, np.inf) + error
    depth = np.where(view.depth > 0, GAIN / np.maximum(disparity, 1e-3), 0)
    return replace(view, depth=depth.astype(np.float32))


def noise() -> np.ndarray:
    return NOISE * stream(0, "bending").standard_normal(LABELS.shape)


def waves() -> np.ndarray:
    """(H, W) [px] a field that varies over some hundred pixels; its RMS is 0.15 px."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return 0.3 * np.sin(u / 110) * np.cos(v / 130)


def error_on(view: View, true: View, label: int) -> np.ndarray:
    """[px] of the disparities of a body, or of the table, at pixels far from edges."""
    inside = np.s_[300:420, 580:700] if label else np.s_[60:220, 200:1000]
    return GAIN / view.depth[inside] - GAIN / true.depth[inside]


def test_bending_is_taken_off_the_body_that_the_table_surrounds(flat: View) -> None:
    bent = measured(flat, waves() + noise())
    straight = unbent(bent, LABELS, BASELINE)
    for label in (0, 1):
        before, after = (error_on(view, flat, label).mean(axis=0) for view in (bent, straight))  # noise averages out
        assert np.sqrt(np.mean(after**2)) < 0.35 * np.sqrt(np.mean(before**2))


def test_noise_alone_hardly_moves_the_body(flat: View) -> None:
    noisy = measured(flat, noise())
    moved = error_on(unbent(noisy, LABELS, BASELINE), noisy, 1)
    assert np.abs(moved).max() < 0.1 * NOISE


def test_what_varies_slowly_is_told_from_noise(flat: View) -> None:
    still, bent = (table_residuals(measured(flat, error), LABELS, GAIN) for error in (noise(), waves() + noise()))
    assert still is not None
    assert bent is not None
    assert still.bending < 0.01 * np.mean(waves() ** 2)
    assert bent.bending == pytest.approx(np.mean(waves() ** 2), rel=0.5)
    assert bent.noise < 0.1 * bent.bending


def test_pixels_without_a_return_stay_without(flat: View) -> None:
    bent = measured(flat, waves())
    bent.depth.setflags(write=True)
    bent.depth[100:120, 300:330] = 0
    assert (unbent(bent, LABELS, BASELINE).depth[100:120, 300:330] == 0).all()


def test_an_image_that_shows_hardly_any_table_stays_as_it_is(flat: View) -> None:
    bent, everywhere = measured(flat, waves()), np.ones_like(LABELS)
    everywhere[:60, :60] = 0
    assert unbent(bent, everywhere, BASELINE) is bent


def test_a_plane_that_a_stereo_camera_bends_is_less_sure_than_a_scanner_s(flat: View) -> None:
    noisy = measured(flat, noise())
    stereo, scanner = (
        table_plane(noisy, LABELS, correlated=correlated_in(simulated_sensor(name))) for name in ("d415", "photoneo")
    )
    assert stereo is not None
    assert scanner is not None
    ratio = np.sqrt(correlated_in(D415) / correlated_in(SCANNER))
    assert stereo.spreads / scanner.spreads == pytest.approx(ratio)
    assert ratio > 10


def test_images_of_stereo_cameras_alone_are_straightened(flat: View) -> None:
    bent = LabelledDepth(measured(flat, waves() + noise()), LABELS)
    stereo, scanner = (
        error_on(calibrated_image(bent, simulated_sensor(name)).view, flat, 1).mean() for name in ("d415", "photoneo")
    )
    assert abs(stereo) < 0.5 * abs(scanner)
