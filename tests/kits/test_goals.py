"""Goals are exactly the poses with the same shadow below the rim, also without declared symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from kit1000.kits.goals import SHADOW_TOLERANCE, Design, find_goals, has_design_shadow, nearest_about_axis
from kit1000.kits.shadows import PartShadows
from kit1000.pose import Pose, quaternion_angle, random_quaternions
from kit1000.symmetry import Symmetry
from kit1000.values import FreeAxis
from tests.samples.shapes import (
    MM,
    Seated,
    X,
    Y,
    Z,
    box,
    cylinder,
    ell,
    gaps,
    lying_cylinder,
    outline_points,
    plug,
    prism,
    ring_plate,
    seated,
    slice_union,
    standing,
    upturned_tee,
)

CASES = {
    "box": (lambda: box(34, 22, 14), Symmetry.dihedral(2, Z, X), 4, None),
    "square prism": (lambda: box(22, 22, 30), Symmetry.dihedral(4, Z, X), 8, None),
    "hex": (lambda: prism(6, 30, 16), Symmetry.dihedral(6, Z, X), 12, None),
    "ell": (ell, Symmetry.none(), 1, None),
    "tee": (upturned_tee, Symmetry.cyclic(2, Z), 2, None),
    "eccentric hole": (lambda: ring_plate(12, off=7), Symmetry.cyclic(2, X), 2, None),
    "standing cylinder": (lambda: cylinder(26, 20), Symmetry.free_flipped(Z), 2, Z),
    "lying cylinder": (lambda: lying_cylinder(20, 34), Symmetry.free_flipped(X), 2, X),
    "plug": (plug, Symmetry.cyclic(4, Z), 1, Z),
}
UNDECLARED = ["box", "square prism", "hex", "ell", "tee", "eccentric hole"]


def design(place: Seated, symmetry: Symmetry | None = None) -> Design:
    return Design(place.part.mesh, symmetry or place.part.symmetry, place.kit_from_part, place.shadows)


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest):
    make, symmetry, count, axis = CASES[request.param]
    place = seated(make(), symmetry)
    return request.param, place, count, axis, find_goals(design(place))


def same_pose(a: Pose, b: Pose, axis: FreeAxis | None = None) -> bool:
    b = b if axis is None else nearest_about_axis(a, b, axis)
    return bool(quaternion_angle(a.wxyz, b.wxyz) < 3e-3 and np.linalg.norm(a.xyz - b.xyz) < 0.06e-3)


def test_the_number_of_goals_is_that_of_the_shape(case) -> None:
    _, place, count, axis, (goals, free) = case
    assert len(goals) == count
    assert same_pose(goals[0], place.kit_from_part)
    assert (free is None) == (axis is None)
    if free is not None:
        assert abs(free.direction @ axis) == pytest.approx(1)
        aside = place.kit_from_part.xyz - free.point
        assert np.linalg.norm(aside - (aside @ axis) * axis) < 1e-6


def test_every_goal_has_the_shadow_of_the_design_pose(case) -> None:
    """By slices of the moved part: every outline point of one shadow lies on the other's outline."""
    _, place, _, _, (goals, free) = case
    plain = design(place)
    for goal in goals:
        rotated = goal if free is None else rotated_about(free, goal, 0.7)
        for z in place.cavity.depth * np.array([0.12, 0.55, 0.97]):
            here, there = (slice_union(plain.standing(pose), z) for pose in (place.kit_from_part, rotated))
            for a, b in ((here, there), (there, here)):
                assert np.abs(gaps(outline_points(a.to_polygons(), 1e-3), b)).max() < SHADOW_TOLERANCE + 0.01e-3


def rotated_about(axis: FreeAxis, pose: Pose, angle: float) -> Pose:
    about = Pose.from_translation(axis.point) @ Pose.from_rotvec(angle * axis.direction)
    return about @ Pose.from_translation(-axis.point) @ pose


@pytest.mark.parametrize("name", UNDECLARED)
def test_goals_are_found_without_declared_symmetry(name: str) -> None:
    make, symmetry, count, _ = CASES[name]
    declared, _ = find_goals(design(seated(make(), symmetry)))
    found, _ = find_goals(design(seated(make())))
    assert len(found) == count
    assert all(any(same_pose(a, b) for b in declared) for a in found)


def test_a_round_foot_has_a_free_axis_under_a_square_head() -> None:
    shallow, deep = (seated(plug(), Symmetry.cyclic(4, Z), depth=depth) for depth in (8e-3, 15e-3))
    assert find_goals(design(shallow))[1] is not None
    goals, axis = find_goals(design(deep))
    assert axis is None
    assert len(goals) == 4


def test_a_hole_too_small_for_a_post_still_distinguishes_goals() -> None:
    """The shadow decides, not the remaining walls: a pose with the hole on the wrong side is wrong."""
    place = seated(ring_plate(7, off=11))
    goals, _ = find_goals(design(place))
    assert place.cavity.removed_wall_count == 1
    assert len(goals) == 2  # itself, and flipped about the line through its holes


@pytest.mark.parametrize(("off_mm", "same"), [(0.045, True), (0.055, False)])
def test_shadows_are_the_same_within_50_micrometres(off_mm: float, same: bool) -> None:
    place = seated(ell())
    moved = design(place).standing(Pose.from_translation(np.array([off_mm * MM, 0, 0])) @ place.kit_from_part)
    assert has_design_shadow(place.shadows, moved) == same


@pytest.mark.parametrize(("wider_mm", "same"), [(0.0, True), (1.0, False), (-1.0, False)])
def test_a_larger_and_a_smaller_shadow_are_others(wider_mm: float, same: bool) -> None:
    shadows = PartShadows.of(standing(box(30, 20, 20)), 12e-3)
    assert has_design_shadow(shadows, standing(box(30 + wider_mm, 20 + wider_mm, 20))) == same


@pytest.mark.parametrize(("step_mm", "same"), [(0.01, True), (0.5, False)])
def test_a_step_near_the_floor_changes_the_shadow(step_mm: float, same: bool) -> None:
    """The shadows agree at the rim but not below: a notch under one end is higher."""
    shadows = PartShadows.of(standing(box(30, 20, 20) - box(8, 20, 6, (11, 0, 0))), 12e-3)
    other = box(30, 20, 20) - box(8, 20, 6 + step_mm, (11, 0, 0))
    assert has_design_shadow(shadows, standing(other)) == same


def test_the_nearest_goal_about_the_axis_is_the_nearest_of_many_angles() -> None:
    axis = FreeAxis(np.array([3e-3, 1e-3, 0]), Y)
    rng = np.random.default_rng(2)
    for quaternions in random_quaternions(rng, 10).reshape(5, 2, 4):
        pose, goal = (Pose(q, rng.normal(0, 0.01, 3)) for q in quaternions)
        best = nearest_about_axis(pose, goal, axis)
        brute = [rotated_about(axis, goal, angle) for angle in np.radians(np.arange(0, 360, 1.0))]
        angles = [float(quaternion_angle(pose.wxyz, other.wxyz)) for other in brute]
        found = float(quaternion_angle(pose.wxyz, best.wxyz))
        assert found <= min(angles) + 1e-9
        assert min(angles) - found < np.radians(0.6)
        nearest = brute[int(np.argmin(angles))]
        assert np.linalg.norm(nearest.xyz - best.xyz) < 1e-3
