"""Trials: a sound pair passes, and every rule turns down a pair that was made to break it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from manifold3d import CrossSection, Manifold

from kit1000.errors import Redraw
from kit1000.kits.acceptance import SeatingTest, check_pair, keyedness, rotated_about_centroid, wrong_poses
from kit1000.kits.goals import Design, find_goals
from kit1000.kits.kit import make_kit
from kit1000.pose import Pose
from kit1000.symmetry import Symmetry
from kit1000.values import Kit, Part
from tests.sample_kits import QUICK, sample_kit, sample_part
from tests.shapes import Z, as_part, box, cylinder, ell, ring_plate, seated

STEP = np.radians(1)


def whole(solid: Manifold, symmetry: Symmetry | None = None, clearance: float = 2.5e-3) -> tuple[Part, Kit]:
    """A part and its kit with all goals, inserted as drawn."""
    place = seated(solid, symmetry, clearance=clearance)
    goals, axis = find_goals(Design(place.part.mesh, place.part.symmetry, place.kit_from_part, place.cavity))
    kit = place.kit(goals, clearance=clearance)
    return place.part, replace(kit, slot=replace(kit.slot, free_axis=axis))


@pytest.mark.parametrize("family", QUICK)
def test_drawn_pairs_pass(family: str) -> None:
    trial = check_pair(sample_part(family), sample_kit(family))
    assert trial.keyedness is None or STEP <= trial.keyedness < np.pi


def test_a_sound_pair_passes() -> None:
    trial = check_pair(*whole(ell()))
    assert trial.keyedness is not None
    assert np.radians(3) < trial.keyedness < np.radians(30)
    assert not trial.has_loose_fit


def test_a_washer_is_free_and_not_loose() -> None:
    washer = cylinder(34, 12) - cylinder(16, 40).translate((0, 0, -9))
    trial = check_pair(*whole(washer, Symmetry.free_flipped(Z)))
    assert trial.keyedness is None
    assert not trial.has_loose_fit


def test_a_plate_told_apart_by_its_hole_alone_is_a_loose_fit() -> None:
    """The hole is too small for a post: half a turn is no goal, yet it seats."""
    part, kit = whole(ring_plate(7, off=9))
    assert len(kit.slot.goals) == 2
    assert check_pair(part, kit).has_loose_fit


def test_a_narrow_bar_seats_when_tilted() -> None:
    with pytest.raises(Redraw, match="seats when tilted 20 degrees"):
        check_pair(*whole(box(40, 4, 12)))


def test_a_gaping_slot_lets_the_part_seat_off_its_place() -> None:
    part, kit = whole(box(34, 30, 24), clearance=10e-3)
    modest = replace(kit, slot=replace(kit.slot, clearance=2.5e-3))
    with pytest.raises(Redraw, match="seats when moved clearance"):
        check_pair(part, modest)


def test_a_goal_below_the_floor_lets_a_lifted_part_seat() -> None:
    part, kit = whole(box(34, 30, 24))
    low = Pose.from_translation(np.array([0, 0, -0.8e-3])) @ kit.slot.goals[0]
    with pytest.raises(Redraw, match="seats when lifted 3 mm"):
        check_pair(part, replace(kit, slot=replace(kit.slot, goals=Pose.stack([low]))))


@pytest.mark.parametrize("error", [[0, 0, 2e-3, 0, 0, 0], [5e-3, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0.6]])
def test_a_goal_that_is_none_is_found_out(error: list[float]) -> None:
    part, kit = whole(ell())
    design = kit.slot.goals[0]
    wrong = rotated_about_centroid(Pose.from_translation(np.array(error[:3])) @ design, np.array(error[3:]))
    with pytest.raises(Redraw, match="does not seat at a goal"):
        check_pair(part, replace(kit, slot=replace(kit.slot, goals=Pose.stack([design, wrong]))))


@pytest.mark.parametrize(("x", "y"), [(40, 20), (36, 28), (30, 30)])
def test_keyedness_of_a_box_is_that_of_a_turning_rectangle(x: float, y: float) -> None:
    """Its corner leaves the rounded rectangle when it stands farther than the clearance from the rectangle."""
    part, kit = whole(box(x, y, 20))
    corners = np.array([[x, y], [-x, y]]) / 2 * 1e-3
    turns = np.arange(0, np.pi, 1e-4)
    c, s = np.cos(turns), np.sin(turns)
    out = np.zeros_like(turns)
    for px, py in corners:
        turned = np.stack([c * px - s * py, s * px + c * py], 1)
        beyond = np.maximum(np.abs(turned) - np.array([x, y]) / 2 * 1e-3, 0)
        out = np.maximum(out, np.linalg.norm(beyond, axis=1))
    brute = turns[np.argmax(out > kit.slot.clearance)]
    found = keyedness(SeatingTest(part.mesh, kit))
    assert found is not None
    assert brute - 1e-3 <= found <= brute + STEP + 1e-3


def test_wrong_poses_are_as_wrong_as_they_say() -> None:
    _, kit = whole(ell())
    design = kit.slot.goals[0]
    poses = list(wrong_poses(kit))
    assert len(poses) == 25
    for name, pose in poses:
        off = pose.xyz - design.xyz
        turn = float((pose @ design.inverse()).angle())
        if name == "lifted 3 mm":
            assert np.allclose(off, [0, 0, 3e-3])
        elif name.startswith("moved"):
            assert np.hypot(*off[:2]) == pytest.approx(5.5e-3)
            assert turn < 1e-7
        else:
            assert np.linalg.norm(off) < 1e-12
            assert turn == pytest.approx(np.radians(20))


def test_a_turn_about_the_anchor_leaves_the_centroid_where_it_is() -> None:
    pose = rotated_about_centroid(whole(ell())[1].slot.goals[0], np.array([0.1, -0.2, 0.3]))
    assert np.allclose(pose.apply(np.zeros(3)), whole(ell())[1].slot.goals[0].xyz)


def test_a_kit_made_as_in_a_dataset_passes() -> None:
    part = as_part(box(40, 30, 16) - box(16, 12, 30, (12, 9, -2)), Symmetry.none())
    assert not check_pair(part, make_kit(part)).has_loose_fit


def test_a_turn_must_jam_both_ways_round() -> None:
    """A snail cam jams at once when its step turns forward, and hardly when it turns back."""
    angles = np.radians(np.arange(0, 361, 5.0))
    radii = 14 + 6 * angles / (2 * np.pi)
    snail = CrossSection([np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1)])
    part, kit = whole(Manifold.extrude(snail, 20))
    seat, design = SeatingTest(part.mesh, kit), kit.slot.goals[0]
    turns = np.arange(STEP, np.pi, STEP)
    ways = [
        next(t for t in turns if not seat.is_seated(rotated_about_centroid(design, s * t * Z), design)) for s in (1, -1)
    ]
    assert max(ways) > 5 * min(ways)
    assert keyedness(seat) == pytest.approx(max(ways), abs=1e-9)
