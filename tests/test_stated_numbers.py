"""The limits of task, sensors and scores as literals: a change of one changes data or scores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.kits.goals import is_goal
from kit1000.kits.seating import HOVER, InsertedPart, is_rotation_seated, seating_result
from kit1000.metrics.exact_seating import ContactInterval
from kit1000.pose import Pose
from kit1000.queries.guesses import draw_ball_error, draw_tilt_error, level_angle, level_offset
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA
from kit1000.sim.sensors import SENSORS, sense
from kit1000.sim.visibility import PartVisibility, SlotVisibility, cavity_labels, view_redraw_reason
from kit1000.values import View
from tests.samples.kits import sample_kit, sample_part

COLUMNS, ROWS = slice(420, -420), slice(20, -20)  # of an image: no border of a sensor, no shadow of the other imager


def wall_depths(sensor: str, distance: float, seed: int = 0) -> np.ndarray:
    """Measured depths [m] of a plane across the optical axis, in the middle of the image."""
    depth = np.full((CAMERA.height, CAMERA.width), distance, np.float32)
    return (
        sense(sensor, View(CAMERA, Pose.identity(), depth), stream(seed, "stated")).depth[ROWS, COLUMNS].astype(float)
    )


@pytest.mark.parametrize(
    ("sensor", "baseline", "least", "most"), [("d415", 0.055, 0.10, 0.43), ("photoneo", 0.225, 0.045, 0.062)]
)
def test_the_noise_of_disparity_is_the_stated_one(sensor: str, baseline: float, least: float, most: float) -> None:
    """The RMS over a plane includes the bending of the stereo camera; rounding adds at most 3 % at this distance."""
    disparities = [CAMERA.fx * baseline / wall_depths(sensor, 0.6, seed) for seed in range(12)]
    rms = [float(np.std(disparity)) for disparity in disparities]
    assert 0.95 * least < min(rms) < max(rms) < 1.05 * most


def test_the_stereo_camera_rounds_disparity_to_a_32nd_of_a_pixel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SENSORS, "d415", replace(SENSORS["d415"], units=(0.0,)))
    steps = np.diff(np.sort(CAMERA.fx * 0.055 / np.unique(wall_depths("d415", 2.0))))
    assert np.median(steps) == pytest.approx(1 / 32, rel=0.1)


@pytest.mark.parametrize(
    ("sensor", "distance", "share"),
    [("d415", 0.29, 0), ("d415", 0.31, 1), ("d415", 2.6, 1), ("d415", 3.5, 0)]
    + [("photoneo", 0.39, 0), ("photoneo", 0.41, 1), ("photoneo", 1.95, 1), ("photoneo", 2.05, 0)],
)
def test_a_sensor_measures_between_the_stated_distances(sensor: str, distance: float, share: float) -> None:
    depth = wall_depths(sensor, distance)[:, -40:]  # where both imagers see a near wall
    assert np.mean(depth > 0) == share


@pytest.mark.parametrize(("incidence_deg", "least", "most"), [(72, 1, 1), (81, 0.35, 0.65), (88, 0, 0)])
def test_the_stereo_camera_loses_surfaces_from_75_to_87_degrees(
    incidence_deg: float, least: float, most: float
) -> None:
    """Measured on a plane that is tilted about the horizontal axis, in the middle rows."""
    tilt = np.radians(incidence_deg)
    y = (np.arange(CAMERA.height) - CAMERA.cy) / CAMERA.fy
    facing = np.cos(tilt) + np.sin(tilt) * y
    depth = np.where(facing > 1e-3, 0.8 * np.cos(tilt) / np.maximum(facing, 1e-3), 0)
    view = View(CAMERA, Pose.identity(), np.repeat(depth[:, None], CAMERA.width, 1).astype(np.float32))
    middle = slice(CAMERA.height // 2 - 4, CAMERA.height // 2 + 4)
    measured = [sense("d415", view, stream(seed, "stated")).depth[middle, COLUMNS] for seed in range(3)]
    assert least <= np.mean(np.array(measured) > 0) <= most


@pytest.mark.parametrize(
    ("pixels", "part_share", "angle_deg", "cavity_share", "reason"),
    [
        (800, 0.5, 69.9, 0.15, None),
        (799, 0.5, 69.9, 0.15, "part small in the image"),
        (800, 0.49, 69.9, 0.15, "part mostly hidden"),
        (800, 0.5, 70.1, 0.15, "slot turned away"),
        (800, 0.5, 69.9, 0.149, "cavity mostly hidden"),
    ],
)
def test_views_are_redrawn_beyond_the_stated_limits(
    pixels: int, part_share: float, angle_deg: float, cavity_share: float, reason: str | None
) -> None:
    part, slot = PartVisibility(pixels, part_share), SlotVisibility(float(np.radians(angle_deg)), cavity_share)
    assert view_redraw_reason(part, slot) == reason


@pytest.mark.parametrize(("below_mm", "is_cavity"), [(0.25, False), (0.35, True), (5.0, True)])
def test_a_cavity_begins_three_tenths_of_a_millimetre_below_the_rim(below_mm: float, is_cavity: bool) -> None:
    view = Pose.from_rotvec((np.pi, 0, 0), (0, 0, 0.5))  # 0.5 m above the plate, straight down
    depth = np.full((CAMERA.height, CAMERA.width), 0.5 + below_mm * 1e-3)
    labels = cavity_labels(depth, CAMERA, view, [Pose.identity()], [sample_kit("tee")])
    assert (labels[CAMERA.height // 2, CAMERA.width // 2] == 0) == is_cavity


@pytest.mark.parametrize("draw", [draw_ball_error, draw_tilt_error])
def test_guesses_reach_28_mm_and_27_5_degrees(draw) -> None:
    rng = np.random.default_rng(0)
    offsets, rotvecs = map(np.array, zip(*(draw(rng) for _ in range(2000)), strict=True))
    assert 27.9e-3 < np.abs(offsets).max() <= 28e-3
    assert 27.4 < np.degrees(np.linalg.norm(rotvecs, axis=1).max()) <= 27.5


def test_the_last_level_of_a_curve_is_28_mm_and_27_5_degrees() -> None:
    assert level_offset(7) == pytest.approx(28e-3)
    assert np.degrees(level_angle(7)) == pytest.approx(27.5)
    assert level_offset(1) == pytest.approx(4e-3)


@pytest.mark.parametrize(
    ("off_mm", "seated", "strict"), [(0.95, True, True), (1.01, True, False), (2.95, True, False), (3.01, False, False)]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_seated_is_within_3_mm_and_strict_within_1_mm(off_mm: float, seated: bool, strict: bool, sign: int) -> None:
    """The limit holds for the goal height of a part in contact, and for the contact of a part at goal height."""
    part = InsertedPart(sample_part("tee").mesh, np.array([0.0, 0.0, 1.0]))
    off, goal = sign * off_mm * 1e-3, Pose.identity()
    raised = Pose.from_translation((0, 0, off))
    for offset, pose in ((0.0, raised), (-off, raised)):
        result = seating_result(offset, part, pose, goal, 20e-3)
        assert (result.seated, result.strict) == (seated, strict)


@pytest.mark.parametrize(
    ("clearance_mm", "axis", "angle_deg", "seated"),
    [
        *[(mm, axis, 9.95, True) for mm in (0.1, 4.1) for axis in ((1, 0, 0), (0, 0, 1), (0.6, 0, 0.8))],
        *[(mm, axis, 10.05, False) for mm in (0.1, 4.1) for axis in ((1, 0, 0), (0, 0, 1), (0.6, 0, 0.8))],
        (10, (0, 0, 1), 23.9, True),  # up to 24 degrees about the slot's axis, where there is room to turn
        (10, (0, 0, -1), 23.9, True),
        (10, (0, 0, 1), 24.1, False),
        (10, (1, 0, 0), 9.9, True),
        (10, (1, 0, 0), 10.1, False),
        (10, (0.28, 0, 0.96), 23.9, True),
        (10, (0.6, 0, 0.8), 20.0, False),
    ],
)
def test_seated_is_within_10_degrees_and_more_about_the_axis_with_much_clearance(
    clearance_mm: float, axis: tuple[float, ...], angle_deg: float, seated: bool
) -> None:
    goal = Pose.from_rotvec((0.3, -1.2, 2.0))
    for sign in (1, -1):
        pose = Pose.from_rotvec(sign * np.radians(angle_deg) * np.array(axis)) @ goal
        assert is_rotation_seated(pose, goal, clearance_mm * 1e-3) is seated


@pytest.mark.parametrize(("angle_deg", "seated"), [(9.95, True), (10.05, False)])
def test_the_rotation_limits_both_criteria_while_contact_is_exact(angle_deg: float, seated: bool) -> None:
    part = InsertedPart(sample_part("tee").mesh, np.array([0.0, 0.0, 1.0]))
    pose = Pose.from_rotvec(np.radians(angle_deg) * np.array([0.6, 0, 0.8]))
    result = seating_result(0.0, part, pose, Pose.identity(), 20e-3)
    assert (result.fits, result.seated, result.strict) == (True, seated, seated)


@pytest.mark.parametrize(("off_mm", "same"), [(0.9, True), (1.1, False)])
def test_a_pose_within_1_mm_of_a_goal_is_that_goal(off_mm: float, same: bool) -> None:
    kit = sample_kit("tee")
    assert is_goal(Pose.from_translation((off_mm * 1e-3, 0, 0)) @ kit.slot.goals[0], kit.slot) == same


def test_the_axes_of_the_scanner_cross_at_800_mm() -> None:
    """Both imagers see the same columns there; parallel axes would lose 312 of 1280."""
    depth = np.full((CAMERA.height, CAMERA.width), 0.8, np.float32)
    measured = sense("photoneo", View(CAMERA, Pose.identity(), depth), stream(0, "stated")).depth
    assert np.mean(measured > 0) > 0.99


def test_the_approach_begins_100_mm_out() -> None:
    assert HOVER == 0.1


def test_contact_in_a_shallow_cavity_comes_within_a_third_of_its_depth() -> None:
    """In 6 mm of depth the limit is 2 mm, not the 3 mm of deep cavities, less the 0.02 mm of the bisection."""
    interval = ContactInterval.of(3e-3, 6e-3, 1.0, 0.0)
    assert (interval.low, interval.high) == pytest.approx((-1.98e-3, 1.98e-3))
