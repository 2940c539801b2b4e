"""Expected disparity images: exact but for edges, where they lie between both surfaces; truth explains an image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.camera import Camera
from kit1000.known_shapes.disparity import CORRELATED, REACH, DisparityImage, unexplained
from kit1000.known_shapes.known_kits import KITS
from kit1000.known_shapes.shapes import StandingShape
from kit1000.known_shapes.support import Support, seen_support
from kit1000.perception.sensor_facts import SensorFacts
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.sensors import sense
from kit1000.values import LabelledDepth, View
from tests.samples.labelled_scenes import SampleScene, sample_scene

STEREO, SHARP = SensorFacts(), SensorFacts(fattening_px=0.0)


def disparities(scene: SampleScene, sensor: SensorFacts) -> DisparityImage:
    return DisparityImage.of(scene.image, sensor, seen_support(scene.image))


def standing_kits(scene: SampleScene, image: DisparityImage) -> StandingShape:
    pose = scene.camera_from_world @ scene.world_from_assembly
    return StandingShape.by_pose(scene.kits.shape(KITS), image.support, pose)


@pytest.mark.parametrize("sensor", [STEREO, SHARP])
def test_edges_lie_between_both_surfaces_and_planes_stay(sensor: SensorFacts) -> None:
    image = disparities(sample_scene(), sensor)
    exact = np.where(np.arange(80)[None] < 40, 70.0, 50.0) + np.zeros((60, 1))
    mean, variance = image.expected(exact)
    assert (mean >= 50 - 1e-3).all()
    assert (mean <= 70 + 1e-3).all()
    assert np.allclose(mean[:, :30], 70)
    assert np.allclose(mean[:, 60:], 50)
    assert np.allclose(variance[:, :30], 0)
    assert variance.max() > 1
    assert (np.diff(mean[30], axis=0) <= 1e-6).all()  # it falls from the near to the far surface


def test_the_mean_is_that_of_the_simulated_sensor() -> None:
    """Of many simulated images of one wall before another, the expected one is the mean, beside the edge too."""
    gain, near, far = 925.0 * STEREO.baseline, 0.6, 0.75
    wall = np.where(np.arange(300)[None] < 150, near, far) + np.zeros((200, 1))
    camera = Camera(300, 200, 925.0, 925.0, 149.5, 99.5)
    view = View(camera, Pose.identity(), wall.astype(np.float32))
    support = Support(np.array([0.0, 0.0, -1.0]), -far, 1e-3, 1e-4)
    image = DisparityImage.of(LabelledDepth(view, np.zeros(wall.shape, np.uint8)), STEREO, support)
    beside = np.s_[:, 152:160]
    depths = np.stack([sense("d415", view, stream(seed, "edges")).depth[beside] for seed in range(60)]).astype(float)
    measured = np.nanmean(gain / np.where(depths > 0, depths, np.nan), axis=(0, 1))
    expected = image.expected(gain / wall)[0][beside].mean(0)
    assert np.abs(measured - expected).max() < 0.15 * (gain / near - gain / far)


def test_the_true_pose_explains_the_image_and_others_do_not() -> None:
    scene = sample_scene()
    image = disparities(scene, SHARP)
    kits = standing_kits(scene, image)
    window = image.window(kits)
    right = window.explained(kits).misfit
    assert right < 0.05
    for move in np.eye(3) * (8e-3, 8e-3, 0.15):
        assert window.explained(kits.at(kits.place + move)).misfit > right + 0.01
    assert window.explained(kits).gain > 1000
    away = kits.at(kits.place + (-0.25, 0.0, 0.0))
    assert image.window(away).explained(away).gain < 0


def test_a_cropped_window_explains_what_a_fresh_one_does() -> None:
    scene = sample_scene()
    image = disparities(scene, STEREO)
    kits = standing_kits(scene, image)
    fresh = image.window(kits)
    cropped = image.window(kits, room=9).cropped(fresh.box)
    assert cropped.box == fresh.box
    assert np.array_equal(cropped.rest, fresh.rest)
    assert cropped.explained(kits) == pytest.approx(fresh.explained(kits), rel=1e-3)


def test_half_an_image_has_the_same_disparities() -> None:
    image = disparities(sample_scene(), SHARP)
    half = image.halved
    assert np.array_equal(half.measured, image.measured[::2, ::2])
    assert np.allclose(half.table, image.table[::2, ::2])


def test_an_image_without_masks_has_the_same_disparities() -> None:
    scene = sample_scene()
    plain = LabelledDepth(scene.image.view, np.zeros_like(scene.image.labels))
    image = DisparityImage.of(plain, SHARP, seen_support(scene.image))
    assert np.array_equal(image.measured, disparities(scene, SHARP).measured)


def test_a_slow_error_of_the_disparities_changes_no_gain() -> None:
    image = disparities(sample_scene(), SHARP)
    kits = standing_kits(sample_scene(), image)
    rows, columns = np.indices(image.measured.shape) / image.measured.shape[1] - 0.5
    slow = image.bend * (1 + rows - columns)
    bent = replace(image, measured=np.where(image.measured > 0, image.measured + slow, 0.0))
    straight, found = image.window(kits).explained(kits), bent.window(kits).explained(kits)
    assert found.gain == pytest.approx(straight.gain, rel=0.01)
    assert found.misfit == pytest.approx(straight.misfit, abs=5e-3)


def test_a_window_with_room_contains_that_of_a_shape_which_moves_in_it() -> None:
    image = disparities(sample_scene(), SHARP)
    kits = standing_kits(sample_scene(), image)
    wide, moved = image.window(kits, room=8), kits.at(kits.place + (4e-3, -4e-3, 0.0))
    assert wide.box.contains(image.box(moved))
    assert not image.window(kits).box.contains(wide.box)
    assert wide.explained(moved).gain == pytest.approx(image.window(moved).explained(moved).gain, rel=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_unexplained_pixels_are_those_of_the_formula(seed: int) -> None:
    """The compiled loop agrees with least squares under Tukey's weights, written with arrays."""
    rng = stream(seed, "unexplained")
    residual, total = rng.normal(0, 0.4, (31, 47)), rng.uniform(0.01, 0.5, (31, 47))
    compared, certainty = rng.random((31, 47)) < 0.7, 1e-3 / REACH**2 * CORRELATED
    v, u = np.nonzero(compared)
    slow = np.stack([np.ones(len(v)), 2 * u / 47 - 1, 2 * v / 31 - 1])
    amounts, limits = np.zeros(3), total[compared] * REACH**2
    for _ in range(2):
        share = np.minimum(np.square(residual[compared] - amounts @ slow) / limits, 1)
        weight = np.square(1 - share) / limits
        normal = (slow * weight) @ slow.T + certainty * np.eye(3)
        amounts = np.linalg.solve(normal, (slow * weight) @ residual[compared])
    left = np.minimum(np.square(residual[compared] - amounts @ slow) / limits, 1).sum() + certainty * amounts @ amounts
    assert unexplained(residual, total, compared, certainty) == pytest.approx(left, rel=1e-9)
