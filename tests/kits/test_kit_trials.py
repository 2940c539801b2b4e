"""Acceptance tests: a valid pair passes, and every rule rejects a pair that breaks it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kit1000.errors import Redraw
from kit1000.kits.kit_trials import ANY_FACE, PairCheck, check_pair, fits_at, keyedness
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.kits.seating import InsertedPart, rotated_about_centroid, wrong_poses
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.values import Kit, Part
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import Z, box, cylinder, ell, most_yaw, pair_of, ring_plate, snail_cam

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


def test_rotation_about_the_centroid_keeps_its_position() -> None:
    pose = rotated_about_centroid(pair_of(ell())[1].slot.goals[0], np.array([0.1, -0.2, 0.3]))
    assert np.allclose(pose.apply(np.zeros(3)), pair_of(ell())[1].slot.goals[0].xyz)


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
