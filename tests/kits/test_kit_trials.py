"""Trials of kits: a valid pair passes, every rule rejects a pair that breaks it, and no loose fit is missed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.errors import Redraw
from kit1000.kits.goals import is_near_goal
from kit1000.kits.kit_trials import ANY_FACE, PairCheck, check_pair, fits_at, keyedness
from kit1000.kits.loose_fits import MOST_TILT, find_fit_in_other_slot, find_loose_fit, turned_matrix
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.kits.seating import BISECTION_STEP, InsertedPart, contact_offset, rotated_about_centroid, wrong_poses
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.pose import Pose, quaternion_angle
from kit1000.symmetry import Symmetry
from kit1000.values import FreeAxis, Kit, Part, Slot
from tests.samples.exact_offset import contact_offset_by_booleans, swept_solid
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import (
    Z,
    as_part,
    box,
    cylinder,
    ell,
    leaning_prism,
    most_yaw,
    pair_of,
    ring_plate,
    snail_cam,
    upturned_tee,
)

STEP = np.radians(1)


def checked(part: Part, kit: Kit) -> PairCheck:
    return check_pair(PreparedPart(part.mesh, ANY_FACE), PreparedKit(kit))


@pytest.mark.parametrize("family", QUICK)
def test_drawn_pairs_are_accepted(family: str) -> None:
    check = checked(sample_part(family), sample_kit(family))
    assert check.keyedness is None or STEP <= check.keyedness < np.pi


def test_a_valid_pair_is_accepted() -> None:
    check = checked(*pair_of(ell()))
    assert check.keyedness is not None
    assert np.radians(3) < check.keyedness < np.radians(30)
    assert not check.has_loose_fit


def test_a_washer_has_a_free_axis_and_no_loose_fit() -> None:
    washer = cylinder(34, 12) - cylinder(16, 40).translate((0, 0, -9))
    check = checked(*pair_of(washer, Symmetry.free_flipped(Z)))
    assert check.keyedness is None
    assert not check.has_loose_fit


def test_a_plate_with_an_eccentric_hole_alone_has_a_loose_fit() -> None:
    """The hole is too small for a post: the pose at 180 degrees is no goal, but the part seats."""
    part, kit = pair_of(ring_plate(7, off=9))
    assert len(kit.slot.goals) == 2
    assert checked(part, kit).has_loose_fit


def test_a_narrow_bar_seats_when_tilted() -> None:
    with pytest.raises(Redraw, match="seats when tilted 20 degrees"):
        checked(*pair_of(box(40, 4, 12)))


def test_a_slot_with_too_much_clearance_is_rejected() -> None:
    part, kit = pair_of(box(34, 30, 24), clearance=10e-3)
    understated = replace(kit, slot=replace(kit.slot, clearance=2.5e-3))
    with pytest.raises(Redraw, match="seats when moved clearance"):
        checked(part, understated)


def test_a_goal_below_the_floor_is_rejected() -> None:
    part, kit = pair_of(box(34, 30, 24))
    low = Pose.from_translation(np.array([0, 0, -0.8e-3])) @ kit.slot.goals[0]
    with pytest.raises(Redraw, match="seats when lifted 3 mm"):
        checked(part, replace(kit, slot=replace(kit.slot, goals=Pose.stack([low]))))


@pytest.mark.parametrize("error", [[0, 0, 2e-3, 0, 0, 0], [5e-3, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0.6]])
def test_a_wrong_goal_is_rejected(error: list[float]) -> None:
    part, kit = pair_of(ell())
    design = kit.slot.goals[0]
    wrong = rotated_about_centroid(Pose.from_translation(np.array(error[:3])) @ design, np.array(error[3:]))
    with pytest.raises(Redraw, match="does not seat at a goal"):
        checked(part, replace(kit, slot=replace(kit.slot, goals=Pose.stack([design, wrong]))))


@pytest.mark.parametrize(("x", "y"), [(40, 20), (36, 28), (30, 30)])
def test_keyedness_of_a_box_is_that_of_a_rotating_rectangle(x: float, y: float) -> None:
    """Its corner leaves the rounded rectangle when it stands farther than the clearance from the rectangle."""
    part, kit = pair_of(box(x, y, 20))
    brute = most_yaw(x, y, 2.5)
    prepared = PreparedKit(kit)
    measured = keyedness(InsertedPart.of(part.mesh, prepared.design), prepared)
    assert measured is not None
    assert brute - 1e-3 <= measured <= brute + STEP + 1e-3


def test_wrong_poses_have_the_stated_errors() -> None:
    _, kit = pair_of(ell())
    design = kit.slot.goals[0]
    poses = list(wrong_poses(kit.slot))
    assert len(poses) == 25
    for name, pose in poses:
        off = pose.xyz - design.xyz
        angle = float((pose @ design.inverse()).angle())
        if name == "lifted 3 mm":
            assert np.allclose(off, [0, 0, 3e-3])
        elif name.startswith("moved"):
            assert np.hypot(*off[:2]) == pytest.approx(5.5e-3)
            assert angle < 1e-7
        else:
            assert np.linalg.norm(off) < 1e-12
            assert angle == pytest.approx(np.radians(20))


def test_keyedness_is_the_yaw_that_jams_in_both_senses() -> None:
    part, kit = pair_of(snail_cam())
    prepared = PreparedKit(kit)
    design = prepared.design
    inserted = InsertedPart.of(part.mesh, design)
    yaws = np.arange(STEP, np.pi, STEP)
    jams = [
        next(yaw for yaw in yaws if not fits_at(inserted, prepared, rotated_about_centroid(design, sign * yaw * Z)))
        for sign in (1, -1)
    ]
    assert max(jams) > 5 * min(jams)
    assert keyedness(inserted, prepared) == pytest.approx(max(jams), abs=1e-9)


def offset_by_booleans(mesh: Mesh, kit: Kit, pose: Pose) -> float:
    """[m] contact offset by booleans."""
    part = InsertedPart.of(mesh, pose)
    return contact_offset_by_booleans(swept_solid(mesh, part.axis), part, solid_from_mesh(kit.mesh), pose)


OTHER_SLOTS = [
    ("peg in a larger bore", lambda: cylinder(16, 24), lambda: cylinder(22, 22), True),
    ("peg in a bore as large", lambda: cylinder(20, 20), lambda: cylinder(20, 20), True),
    ("peg over a smaller bore", lambda: cylinder(30, 24), lambda: cylinder(20, 22), False),
    ("small box in a large slot, rotated", lambda: box(14, 34, 18), lambda: box(38, 18, 20), True),
    ("large box over a small slot", lambda: box(40, 40, 34), lambda: box(34, 22, 20), False),
    ("bar too long for a square slot, but not across", lambda: box(33, 9, 9), lambda: box(26, 26, 20), True),
    ("bar too long even across", lambda: box(48, 9, 30), lambda: box(26, 26, 20), False),
    ("full block in a slot with a post", lambda: box(34, 34, 20), lambda: ring_plate(16), False),
    ("ell on end in the slot of a tee", ell, upturned_tee, True),
]


@pytest.mark.parametrize(
    ("part", "other", "accepted"), [case[1:] for case in OTHER_SLOTS], ids=[case[0] for case in OTHER_SLOTS]
)
def test_the_search_finds_parts_that_another_slot_accepts_and_no_others(part, other, accepted: bool) -> None:
    mesh, kit = as_part(part()).mesh, pair_of(other())[1]
    prepared = PreparedKit(kit)
    pose = find_fit_in_other_slot(PreparedPart(mesh), prepared)
    assert (pose is not None) == accepted
    if pose is not None:
        assert offset_by_booleans(mesh, kit, pose) <= prepared.height_limit
        lowest = pose.apply(mesh.vertices)[:, 2].min()
        assert lowest == pytest.approx(-kit.slot.depth, abs=1e-9)


@pytest.mark.parametrize(
    ("solid", "loose"),
    [
        (lambda: ring_plate(7, off=9), True),  # the hole is too small for a post: the part also seats at 180 degrees
        (lambda: ring_plate(20, off=6), False),  # here the post prevents it
        (ell, False),
        (leaning_prism, True),  # so small that it turns by more than 10 degrees within the clearance
        (lambda: box(34, 22, 14), False),
        (lambda: box(34, 22, 14) - box(9, 9, 14, (16, 10, 7.5)), True),  # a corner cut above the middle of the depth
    ],
)
def test_loose_fits_are_found_and_confirmed_by_booleans(solid, loose: bool) -> None:
    part, kit = pair_of(solid())
    mesh = part.mesh
    pose = find_loose_fit(PreparedPart(mesh), PreparedKit(kit))
    assert (pose is not None) == loose
    if pose is not None:
        assert not is_near_goal(pose, kit.slot)
        contact = pose.xyz[2] + offset_by_booleans(mesh, kit, pose)
        assert np.abs(contact - kit.slot.goals.xyz[:, 2]).min() <= PreparedKit(kit).height_limit + BISECTION_STEP


@pytest.mark.parametrize("solid", [ell, lambda: box(34, 22, 14), lambda: ring_plate(20, off=6)])
def test_random_poses_find_no_loose_fit_where_the_search_finds_none(solid) -> None:
    """None of 400 random resting poses over the open area seats away from the goals."""
    part, kit = pair_of(solid())
    mesh = part.mesh
    part, prepared, rng = PreparedPart(mesh), PreparedKit(kit), np.random.default_rng(11)
    (lowest, highest), faces = prepared.field.opening, part.faces
    assert find_loose_fit(part, prepared) is None
    for number in range(400):
        face = faces[number % len(faces)]
        rotated = Pose.from_rotvec(np.array([0, 0, rng.uniform(0, 2 * np.pi)])) @ face.plane_from_part
        low, high = mesh.moved(rotated).bounds
        room = highest + 1e-3 - high[:2], lowest - 1e-3 - low[:2]
        shift = rng.uniform(np.minimum(*room), np.maximum(*room))
        pose = Pose.from_translation(np.array([*shift, -kit.slot.depth - low[2]])) @ rotated
        heights = pose.xyz[2] + contact_offset(InsertedPart.of(mesh, pose), kit.mesh, pose) - kit.slot.goals.xyz[:, 2]
        assert np.abs(heights).min() > prepared.height_limit or is_near_goal(pose, kit.slot)


@pytest.mark.parametrize(
    ("clearance_mm", "angle_deg", "shift_mm"), [(1, 10, 5), (2.5, 10, 5), (5, 12, 10), (10, 24, 20)]
)
def test_in_wide_slots_poses_farther_off_are_near_a_goal(
    clearance_mm: float, angle_deg: float, shift_mm: float
) -> None:
    goal = Pose.from_translation(np.array([0, 0, -5e-3]))
    slot = Slot("p", goal, clearance_mm * 1e-3, 8e-3, Pose.stack([goal]), None)
    for share in (0.99, 1.01):
        assert is_near_goal(Pose(Pose.from_rotvec(np.radians(share * angle_deg) * Z).wxyz, goal.xyz), slot) == (
            share < 1
        )
        assert is_near_goal(Pose.from_translation([share * shift_mm * 1e-3, 0, -5e-3]), slot) == (share < 1)


def test_any_rotation_about_a_free_axis_is_near_the_goal() -> None:
    point = np.array([3e-3, 0, 0])
    goal = Pose.from_translation(np.array([3e-3, 0, -5e-3]))
    slot = Slot("p", goal, 2.5e-3, 8e-3, Pose.stack([goal]), FreeAxis(point, Z))
    for angle in (0.5, 2.0, 3.1):
        spun = Pose(Pose.from_rotvec(angle * Z).wxyz, goal.xyz)
        assert is_near_goal(spun, slot)
        assert float(quaternion_angle(spun.wxyz, goal.wxyz)) > 0.4


def loose_fit(mesh: Mesh, kit: Kit) -> Pose | None:
    """A loose fit on the face of the design pose, checked by booleans."""
    design = kit.slot.goals[0]
    part = PreparedPart(mesh, min_probability=0.0)
    part.faces = [face for face in part.faces if design.rotate(face.normal)[2] < -0.999]
    pose = find_loose_fit(part, PreparedKit(kit))
    if pose is not None:
        height = np.abs(pose.xyz[2] + offset_by_booleans(mesh, kit, pose) - kit.slot.goals.xyz[:, 2]).min()
        assert height <= PreparedKit(kit).height_limit + BISECTION_STEP
        assert not is_near_goal(pose, kit.slot)
        assert np.arccos((pose @ design.inverse()).rotate(Z)[2]) <= MOST_TILT + 1e-9
    return pose


@pytest.mark.parametrize(("x", "y"), [(20, 16), (24, 14), (26.5, 9), (32, 9), (34, 10), (30, 24)])
def test_a_box_has_a_loose_fit_where_it_turns_by_more_than_10_degrees(x: float, y: float) -> None:
    part, kit = pair_of(box(x, y, 20))
    mesh = part.mesh
    yaw = np.degrees(most_yaw(x, y, 2.5))
    assert abs(yaw - 10) > 0.3
    assert (loose_fit(mesh, kit) is not None) == (yaw > 10)


@pytest.mark.parametrize("mirrored", [False, True])
def test_both_senses_of_a_turn_are_tried(mirrored: bool) -> None:
    part, kit = pair_of(snail_cam(mirrored))
    assert loose_fit(part.mesh, kit) is not None


def test_a_part_that_turns_about_another_point_than_its_centroid_is_found() -> None:
    """A tower at its end draws the centroid 5 mm away from the middle of the cavity."""
    part, kit = pair_of(box(20, 16, 12) + box(6, 16, 40, (7, 0, 0)))
    mesh = part.mesh
    assert abs(mesh.bounds[0][0] + mesh.bounds[1][0]) > 5e-3
    assert loose_fit(mesh, kit) is not None


@given(st.floats(-3, 3), st.floats(-0.09, 0.09), st.floats(-0.09, 0.09))
def test_a_yaw_is_followed_by_a_tilt(yaw: float, x: float, y: float) -> None:
    expected = Pose.from_rotvec(np.array([x, y, 0])) @ Pose.from_rotvec(np.array([0, 0, yaw]))
    assert np.allclose(turned_matrix(yaw, x, y), expected.rotation_matrix(), atol=1e-11)
