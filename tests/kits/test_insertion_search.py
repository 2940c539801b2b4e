"""Lowering a part beside its goal: closed forms of turned boxes, both senses, and no pose that does not fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import CrossSection, Manifold

from kit1000.kits.goals import Design, find_goals
from kit1000.kits.loose_fits import MOST_TILT, find_loose_fit, is_near_goal, turned_matrix
from kit1000.kits.prepared import PreparedKit, PreparedPart
from kit1000.kits.seating import BISECTION_STEP, InsertedPart
from kit1000.mesh import Mesh, solid_from_mesh
from kit1000.pose import Pose
from kit1000.values import Kit
from tests.samples.exact_offset import contact_offset_by_booleans, swept_solid
from tests.samples.shapes import Z, box, seated


def pair_of(solid: Manifold) -> tuple[Mesh, Kit]:
    """A part inserted as drawn, and its kit with all goals."""
    place = seated(solid)
    goals, axis = find_goals(Design(place.part.mesh, place.part.symmetry, place.kit_from_part, place.shadows))
    kit = place.kit(goals)
    return place.part.mesh, replace(kit, slot=replace(kit.slot, free_axis=axis))


def loose_fit(mesh: Mesh, kit: Kit) -> Pose | None:
    """A loose fit on the face of the design pose, checked by booleans."""
    design = kit.slot.goals[0]
    part = PreparedPart(mesh, min_probability=0.0)
    part.faces = [face for face in part.faces if design.rotate(face.normal)[2] < -0.999]
    pose = find_loose_fit(part, PreparedKit(kit))
    if pose is not None:
        inserted = InsertedPart.of(mesh, pose)
        offset = contact_offset_by_booleans(swept_solid(mesh, inserted.axis), inserted, solid_from_mesh(kit.mesh), pose)
        height = np.abs(pose.xyz[2] + offset - kit.slot.goals.xyz[:, 2]).min()
        assert height <= PreparedKit(kit).height_limit + BISECTION_STEP
        assert not is_near_goal(pose, kit.slot)
        assert np.arccos((pose @ design.inverse()).rotate(Z)[2]) <= MOST_TILT + 1e-9
    return pose


def most_yaw(x: float, y: float, clearance: float) -> float:
    """[deg] to which a rectangle [mm] turns in its outline grown by a clearance [mm] with round corners."""
    yaws = np.radians(np.arange(0, 45, 0.01))
    c, s = np.cos(yaws), np.sin(yaws)
    out = np.zeros_like(yaws)
    for px, py in ((x / 2, y / 2), (-x / 2, y / 2)):
        beyond = np.maximum(np.abs(np.stack([c * px - s * py, s * px + c * py], 1)) - np.array([x, y]) / 2, 0)
        out = np.maximum(out, np.linalg.norm(beyond, axis=1))
    return float(np.degrees(yaws[np.argmax(out > clearance)]))


@pytest.mark.parametrize(("x", "y"), [(20, 16), (24, 14), (26.5, 9), (32, 9), (34, 10), (30, 24)])
def test_a_box_has_a_loose_fit_where_it_turns_by_more_than_10_degrees(x: float, y: float) -> None:
    mesh, kit = pair_of(box(x, y, 20))
    yaw = most_yaw(x, y, 2.5)
    assert abs(yaw - 10) > 0.3
    assert (loose_fit(mesh, kit) is not None) == (yaw > 10)


@pytest.mark.parametrize("mirrored", [False, True])
def test_both_senses_of_a_turn_are_tried(mirrored: bool) -> None:
    """A snail cam jams at once when its step turns forward, and late when it turns back."""
    angles = np.radians(np.arange(0, 361, 5.0))
    radii = 14 + 6 * angles / (2 * np.pi)
    outline = np.stack([radii * np.cos(angles), radii * np.sin(angles)], 1)
    outline = outline[::-1] * [1, -1] if mirrored else outline
    mesh, kit = pair_of(Manifold.extrude(CrossSection([outline]), 20))
    pose = loose_fit(mesh, kit)
    assert pose is not None


def test_a_part_that_turns_about_another_point_than_its_centroid_is_found() -> None:
    """A tower at its end draws the centroid 5 mm away from the middle of the cavity."""
    mesh, kit = pair_of(box(20, 16, 12) + box(6, 16, 40, (7, 0, 0)))
    assert abs(mesh.bounds[0][0] + mesh.bounds[1][0]) > 5e-3
    assert loose_fit(mesh, kit) is not None


@settings(max_examples=50)
@given(st.floats(-3, 3), st.floats(-0.09, 0.09), st.floats(-0.09, 0.09))
def test_a_yaw_is_followed_by_a_tilt(yaw: float, x: float, y: float) -> None:
    expected = Pose.from_rotvec(np.array([x, y, 0])) @ Pose.from_rotvec(np.array([0, 0, yaw]))
    assert np.allclose(turned_matrix(yaw, x, y), expected.rotation_matrix(), atol=1e-11)
