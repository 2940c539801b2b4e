"""The limits of task, sensors and scores as literals: a change of one changes data or scores."""

from __future__ import annotations

import numpy as np
import pytest

from kit1000.kits.goals import is_goal
from kit1000.kits.seating import HOVER, InsertedPart, is_rotation_seated, seating_result
from kit1000.metrics.exact_seating import ContactInterval
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_ANGLE, MAX_OFFSET, level_angle, level_offset
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA
from kit1000.sim.sensors import SENSORS, sense
from kit1000.sim.visibility import (
    MAX_SLOT_ANGLE,
    MIN_CAVITY_SHARE,
    MIN_PART_PIXELS,
    MIN_PART_SHARE,
    cavity_labels,
)
from kit1000.values import View
from tests.samples.kits import sample_kit, sample_part

D415, PHOTONEO = SENSORS["d415"], SENSORS["photoneo"]
DEGREE = np.pi / 180


@pytest.mark.parametrize(
    ("found", "stated"),
    [
        (D415.baseline, 0.055),  # sensors: noise, quantisation, losses, range
        (PHOTONEO.baseline, 0.225),
        (PHOTONEO.convergence, 0.8),
        (D415.amplitude_px, (0.10, 0.30)),
        (PHOTONEO.amplitude_px, (0.045, 0.062)),
        (D415.subpixel_px, 1 / 32),
        (D415.grazing_deg, (75, 87)),
        ((D415.side, PHOTONEO.side), (1, -1)),
        ((D415.min_depth, D415.max_depth), (0.3, 3.0)),
        ((PHOTONEO.min_depth, PHOTONEO.max_depth), (0.4, 2.0)),
        ((MIN_PART_PIXELS, MIN_PART_SHARE, MIN_CAVITY_SHARE), (800, 0.5, 0.15)),  # a view that has a query
        (MAX_SLOT_ANGLE, 70 * DEGREE),
        ((MAX_OFFSET, MAX_ANGLE), (28e-3, 27.5 * DEGREE)),  # the errors of guesses
        ((level_offset(1), level_offset(7)), (4e-3, 28e-3)),
        (level_angle(7), 27.5 * DEGREE),
        (HOVER, 0.1),  # the seating test
    ],
)
def test_a_limit_is_the_stated_one(found: object, stated: object) -> None:
    assert found == pytest.approx(stated)


def wall_depths(sensor: str, depth: np.ndarray) -> np.ndarray:
    """Measured depths [m] of ideal ones."""
    return sense(sensor, View(CAMERA, Pose.identity(), depth.astype(np.float32)), stream(0, "stated")).depth


@pytest.mark.parametrize(("incidence_deg", "least", "most"), [(72, 1, 1), (81, 0.35, 0.65), (88, 0, 0)])
def test_the_stereo_camera_loses_surfaces_from_75_to_87_degrees(
    incidence_deg: float, least: float, most: float
) -> None:
    """A plane is tilted about the horizontal axis and measured in the middle rows, beside shadow and border."""
    tilt, y = incidence_deg * DEGREE, (np.arange(CAMERA.height) - CAMERA.cy) / CAMERA.fy
    facing = np.cos(tilt) + np.sin(tilt) * y
    depth = np.where(facing > 1e-3, 0.8 * np.cos(tilt) / np.maximum(facing, 1e-3), 0)
    measured = wall_depths("d415", np.repeat(depth[:, None], CAMERA.width, 1))
    assert least <= np.mean(measured[CAMERA.height // 2 - 4 : CAMERA.height // 2 + 4, 420:-420] > 0) <= most


def test_the_axes_of_the_scanner_cross_at_800_mm() -> None:
    """Both imagers see the same columns there; parallel axes would lose 312 of 1280."""
    assert np.mean(wall_depths("photoneo", np.full((CAMERA.height, CAMERA.width), 0.8)) > 0) > 0.99


@pytest.mark.parametrize(("below_mm", "is_cavity"), [(0.25, False), (0.35, True), (5.0, True)])
def test_a_cavity_begins_three_tenths_of_a_millimetre_below_the_rim(below_mm: float, is_cavity: bool) -> None:
    view = Pose.from_rotvec((np.pi, 0, 0), (0, 0, 0.5))  # 0.5 m above the plate, straight down
    depth = np.full((CAMERA.height, CAMERA.width), 0.5 + below_mm * 1e-3)
    labels = cavity_labels(depth, CAMERA, view, [Pose.identity()], [sample_kit("tee")])
    assert (labels[CAMERA.height // 2, CAMERA.width // 2] == 0) == is_cavity


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


def test_contact_in_a_shallow_cavity_comes_within_a_third_of_its_depth() -> None:
    """In 6 mm of depth the limit is 2 mm, not the 3 mm of deep cavities, less the 0.02 mm of the bisection."""
    interval = ContactInterval.of(3e-3, 6e-3, 1.0, 0.0)
    assert (interval.low, interval.high) == pytest.approx((-1.98e-3, 1.98e-3))
