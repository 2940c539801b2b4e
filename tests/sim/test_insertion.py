"""Simulated insertions: forces of the physics engine, outcomes in closed form, pegs in cavities."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from kit1000.kits.assembly import AssemblyPlan, build_assembly
from kit1000.kits.seating import rotated_about_centroid
from kit1000.pose import Pose
from kit1000.sim.insertion import MAX_LAG, InsertionTrial, Workpiece, assembly_obstacles, classify_outcome, insert
from kit1000.sim.world import MARGIN, STEP_RATE, World
from kit1000.values import Assembly, FreeAxis, Kit, Part, Slot
from tests.samples.shapes import MM, Z, box, seated

CUBE = (np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.01).astype(float)
MOMENTS = np.array([1e-6, 2e-6, 2.5e-6])
FREE = {"linearDamping": 0.0, "angularDamping": 0.0}
ARCH = [CUBE * (0.5, 1, 1) + [s * 0.015, 0, 0] for s in (-1, 1)] + [CUBE * (2, 1, 0.25) + [0, 0, 0.0125]]


def test_convex_pieces_leave_the_gap_between_them_open() -> None:
    """An arch with legs of 10 mm width rests on the ground over a post of 8 mm that its hull would rest on."""
    with World() as world:
        world.add_ground()
        world.add_hull(CUBE * (0.4, 0.4, 0.4), 0.0, np.zeros(3), Pose.from_translation([0, 0, 0.004]))
        arch = world.add_pieces(ARCH, 0.02, MOMENTS, Pose.from_translation([0, 0, 0.012]))
        world.step(STEP_RATE)
        assert abs(world.pose(arch).xyz[2] - 0.01) < 1.2 * MARGIN


def test_a_push_accelerates_along_the_world_axes() -> None:
    """One step from rest: v = F/m t, and w = R I^-1 R^T torque t."""
    start = Pose.from_rotvec([0.4, -1.0, 0.7], [0, 0, 1.0])
    force, torque = np.array([0.1, -0.2, 0.3]), np.array([1e-5, 2e-5, -1e-5])
    with World() as world:
        body = world.add_pieces([CUBE], 0.02, MOMENTS, start, **FREE)
        world.push(body, force + 0.02 * 9.81 * Z, torque)
        world.step()
        linear, angular = world.velocity(body)
        world.step()
        assert world.velocity(body)[0][:2] == pytest.approx(linear[:2])  # the push is over
    rotation = start.rotation_matrix()
    assert linear == pytest.approx(force / 0.02 / STEP_RATE, abs=1e-7)
    assert angular == pytest.approx(rotation @ (rotation.T @ torque / MOMENTS) / STEP_RATE, rel=1e-3)


class Peg:
    """A part, and its kit on a foot that tilts it."""

    def __init__(self, part: Part, kit: Kit, pieces: list[np.ndarray], tilt: float) -> None:
        self.kit, self.goal = kit, kit.slot.goals[0]
        self.assembly: Assembly = build_assembly("a", [kit], AssemblyPlan(tilt, 0.4, ()))
        self.workpiece, self.obstacles = Workpiece.of(part, pieces), assembly_obstacles(self.assembly)

    def insert(self, pose: Pose) -> InsertionTrial:
        assembly_from_kit = self.assembly.mounts[0].assembly_from_kit
        return insert(self.workpiece, self.obstacles, assembly_from_kit @ pose, self.goal.inverse().rotate(Z))

    def outcome(self, pose: Pose) -> str:
        kit_from_assembly, trial = self.assembly.mounts[0].assembly_from_kit.inverse(), self.insert(pose)
        poses = kit_from_assembly @ trial.release_pose, kit_from_assembly @ trial.rest_pose
        return classify_outcome(self.kit, *poses).outcome

    def shifted(self, *millimetres: float) -> Pose:
        return Pose.from_translation(MM * np.array(millimetres)) @ self.goal


@cache
def box_peg(tilt_deg: float = 0.0) -> Peg:
    place = seated(box(34, 22, 20))
    return Peg(place.part, place.kit(), [place.part.mesh.vertices], float(np.radians(tilt_deg)))


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_a_true_pose_seats(tilt_deg: float) -> None:
    peg = box_peg(tilt_deg)
    assert peg.outcome(peg.goal) == "seated"


def test_a_shift_within_the_clearance_seats_and_one_of_8_mm_does_not() -> None:
    assert box_peg().outcome(box_peg().shifted(2, 0, 0)) == "seated"
    assert box_peg().outcome(box_peg().shifted(8, 0, 0)) != "seated"


def test_the_hand_is_blocked_only_by_an_obstacle() -> None:
    peg = box_peg()
    assert not peg.insert(peg.goal).blocked
    trial = peg.insert(peg.shifted(12, 0, 0))
    assert trial.blocked
    assert MAX_LAG < trial.release_pose.xyz[2] - (peg.assembly.mounts[0].assembly_from_kit @ peg.goal).xyz[2] < 0.03


def test_a_part_released_in_the_air_is_at_the_predicted_pose() -> None:
    """The hand follows its path to a tenth of a millimetre and a tenth of a degree."""
    peg = box_peg()
    target = Pose.from_translation([0, 0, 0.05]) @ rotated_about_centroid(peg.goal, np.array([0.3, -0.2, 0.5]))
    error = (peg.assembly.mounts[0].assembly_from_kit @ target).inverse() @ peg.insert(target).release_pose
    assert np.linalg.norm(error.xyz) < 1e-4
    assert error.angle() < np.radians(0.1)


def test_the_same_insertion_gives_the_same_bytes() -> None:
    first, again = (box_peg(20.0).insert(box_peg(20.0).shifted(4, 1, 0)).rest_pose for _ in range(2))
    assert first.xyz.tobytes() + first.wxyz.tobytes() == again.xyz.tobytes() + again.wxyz.tobytes()


@pytest.mark.parametrize(
    ("shift_mm", "angle_deg", "after_release_deg", "outcome"),
    [
        ((0, 0, 0), 0, 0, "seated"),
        ((4.4, 0, 2.9), 9.9, 9.9, "seated"),
        ((4.6, 0, 0), 0, 0, "slid"),
        ((0, 0, 3.1), 0, 0, "jammed"),
        ((0, 0, 0), 10.1, 10.1, "askew"),
        ((0, 0, 0), 21, 21, "tipped"),
        ((0, 0, 3.1), 21, 0, "jammed"),
        ((50, 0, 0), 21, 21, "left"),
        ((0, 0, -30), 0, 0, "left"),
    ],
)
def test_the_outcome_of_an_insertion(
    shift_mm: tuple[float, float, float], angle_deg: float, after_release_deg: float, outcome: str
) -> None:
    kit, goal = box_peg().kit, box_peg().goal
    rest = Pose.from_translation(MM * np.array(shift_mm)) @ rotated_about_centroid(goal, np.radians(angle_deg) * Z)
    release = Pose.from_translation(rest.xyz - goal.xyz) @ rotated_about_centroid(
        goal, np.radians(angle_deg - after_release_deg) * Z
    )
    result = classify_outcome(kit, release, rest)
    assert result.outcome == outcome
    assert result.height == pytest.approx(MM * shift_mm[2], abs=1e-12)


def test_any_goal_and_any_turn_about_a_free_axis_is_seated() -> None:
    slot, extent = box_peg().kit.slot, box_peg().kit.extent
    half = rotated_about_centroid(slot.goals[0], np.pi * Z)
    two_goals = Slot("p", slot.kit_from_part, slot.clearance, slot.depth, Pose.stack([slot.goals[0], half]))
    axis = FreeAxis(np.zeros(3), Z)
    with_axis = Slot("p", slot.kit_from_part, slot.clearance, slot.depth, slot.goals, axis)
    for variant, angle in ((two_goals, np.pi), (with_axis, 0.3), (with_axis, 2.0)):
        rest = rotated_about_centroid(slot.goals[0], angle * Z)
        assert classify_outcome(Kit("k", box_peg().kit.mesh, variant, extent), rest, rest).outcome == "seated"
