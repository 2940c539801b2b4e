"""The seating test: two independent computations of contact agree, and each rule rejects the poses that it should."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from manifold3d import Manifold

from kit1000.kits.seating import (
    BISECTION_STEP,
    SEATED_LIMIT,
    STRICT_LIMIT,
    InsertedPart,
    SeatingResult,
    contact_offset,
    is_rotation_seated,
    rotated_about_centroid,
    seating_result,
)
from kit1000.mesh import mesh_from_solid, solid_from_mesh
from kit1000.pose import Pose
from kit1000.values import Kit, Part
from tests.samples.exact_offset import contact_offset_by_booleans, swept_solid
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import (
    MM,
    Z,
    box,
    cylinder,
    ell,
    leaning_prism,
    lying_cylinder,
    ring_plate,
    seated,
    standing,
    upturned_tee,
)

LIMIT_BAND = 0.1e-3  # [m] from a limit, within which the two results may differ
SHAPES: dict[str, Callable[[], Manifold]] = {
    "box": lambda: box(34, 22, 20),
    "ell": ell,
    "tee": upturned_tee,
    "leaning": leaning_prism,
    "lying cylinder": lambda: lying_cylinder(20, 34),
    "cone": lambda: cylinder(14, 24, top=34, segments=48),
    "plate with hole": lambda: ring_plate(16, off=4),
}
NAMES = [*SHAPES, *QUICK]


class Pair:
    """A part and its kit, to be tested at poses in the kit frame."""

    def __init__(self, part: Part, kit: Kit) -> None:
        self.part, self.goal, self.depth = part, kit.slot.goals[0], kit.slot.depth
        self.kit, self.edges = kit, kit.mesh
        self.inserted = InsertedPart.of(part.mesh, self.goal)

    def contact_offset(self, pose: Pose) -> float:
        return contact_offset(self.inserted, self.edges, pose)

    def result(self, pose: Pose, offset: float | None = None) -> SeatingResult:
        offset = self.contact_offset(pose) if offset is None else offset
        return seating_result(offset, self.inserted, pose, self.goal, self.depth)

    def moved(self, error: np.ndarray, share: float = 1.0) -> Pose:
        """The goal shifted and rotated about the centroid by a share of an error (6,) [m, rad]."""
        return Pose.from_translation(share * error[:3]) @ rotated_about_centroid(self.goal, share * error[3:])

    def lifted(self, height: float) -> Pose:
        return self.moved(np.array([0, 0, height, 0, 0, 0]))

    def seated_share(self, error: np.ndarray) -> float:
        """The share of an error at which the part is no longer seated."""
        low, high = 0.0, 1.0
        for _ in range(14):
            middle = (low + high) / 2
            low, high = (middle, high) if self.result(self.moved(error, middle)).seated else (low, middle)
        return low


@cache
def pair(name: str) -> Pair:
    if name in QUICK:
        return Pair(sample_part(name), sample_kit(name))
    place = seated(SHAPES[name]())
    return Pair(place.part, place.kit())


def errors(seed: int, n: int) -> np.ndarray:
    """(n, 6) shifts of 0 to 10 mm and rotations of 0 to 25 degrees, in any direction and about any axis."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(n, 2, 3))
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    return (ways * rng.uniform(0, [10e-3, np.radians(25)], (n, 2))[..., None]).reshape(n, 6)


def sample_poses(subject: Pair, seed: int) -> list[Pose]:
    """Poses with random errors, others just before and beyond the limit of being seated, and lifts near the limits."""
    poses = [subject.moved(error) for error in errors(seed, 2)]
    for error in errors(seed + 1, 2):
        share = subject.seated_share(error)
        poses += [subject.moved(error, share * (1 + step)) for step in (-0.02, 0.004)]
    return poses + [subject.lifted(SEATED_LIMIT + step) for step in (-0.15e-3, 0.15e-3)]


@pytest.mark.parametrize("name", NAMES)
def test_closed_form_and_booleans_agree(name: str) -> None:
    subject = pair(name)
    swept, plate = swept_solid(subject.part.mesh, subject.inserted.axis), solid_from_mesh(subject.kit.mesh)
    for pose in sample_poses(subject, NAMES.index(name)):
        closed, by_booleans = (
            subject.contact_offset(pose),
            contact_offset_by_booleans(swept, subject.inserted, plate, pose),
        )
        assert closed == pytest.approx(by_booleans, abs=BISECTION_STEP)
        ours, theirs = subject.result(pose), subject.result(pose, by_booleans)
        if distance_to_limit(ours, subject.depth) > LIMIT_BAND:
            assert (ours.seated, ours.strict) == (theirs.seated, theirs.strict)


def distance_to_limit(result: SeatingResult, depth: float) -> float:
    """[m] distance of a result to the nearest of its limits."""
    gaps = [abs(abs(result.contact_height) - min(limit, depth / 3)) for limit in (SEATED_LIMIT, STRICT_LIMIT)]
    return min([*gaps, *(abs(abs(result.contact_offset) - limit) for limit in (SEATED_LIMIT, STRICT_LIMIT))])


@pytest.mark.parametrize("name", NAMES)
def test_height_alone_decides_over_a_free_slot(name: str) -> None:
    subject = pair(name)
    for lift, is_seated, is_strict in (
        (0.0, True, True),
        (0.9e-3, True, True),
        (1.0e-3, True, False),
        (2.9e-3, True, False),
        (SEATED_LIMIT, False, False),
        (15e-3, False, False),
        (-0.9e-3, True, True),
        (-2.9e-3, True, False),
        (-SEATED_LIMIT, False, False),
        (-15e-3, False, False),
    ):
        result = subject.result(subject.lifted(lift))
        assert (result.seated, result.strict) == (is_seated, is_strict)
        assert result.contact_offset == pytest.approx(-lift, abs=5e-6)
        assert result.penetration == pytest.approx(max(-lift, 0), abs=5e-6)
        assert result.contact_height == pytest.approx(0, abs=5e-6)


@pytest.mark.parametrize(("height_mm", "is_seated"), [(1.9, True), (2.1, False), (-1.9, True), (-2.1, False)])
def test_in_a_shallow_slot_a_third_of_its_depth_is_the_limit(height_mm: float, is_seated: bool) -> None:
    subject = pair("box")
    pose = subject.lifted(height_mm * MM)
    assert seating_result(0.0, subject.inserted, pose, subject.goal, 6e-3).seated == is_seated
    assert seating_result(0.0, subject.inserted, pose, subject.goal, 12e-3).seated


def test_a_shift_within_the_clearance_is_seated_and_one_beyond_is_not() -> None:
    for angle in np.arange(0, 2 * np.pi, 0.5):
        way = np.array([np.cos(angle), np.sin(angle), 0, 0, 0, 0])
        assert pair("box").result(pair("box").moved(2.4e-3 * way)).strict
        beyond = pair("box").result(pair("box").moved(3.6e-3 * way))
        assert not beyond.seated
        assert beyond.contact_offset == pytest.approx(pair("box").depth, abs=5e-6)


@pytest.mark.parametrize(
    ("clearance_mm", "yaw_deg", "tilt_deg", "is_seated"),
    [
        (1, 9.9, 0, True), (1, 10.1, 0, False), (1, 0, 9.9, True), (1, 0, 10.1, False),
        (10, 23.9, 0, True), (10, 24.1, 0, False), (10, 20, 9.9, True), (10, 0, 10.1, False), (10, 20, 10.1, False),
    ],
)  # fmt: skip
def test_wide_slots_let_a_part_rotate_about_its_axis_alone(
    clearance_mm: float, yaw_deg: float, tilt_deg: float, is_seated: bool
) -> None:
    goal = Pose.from_rotvec((0.3, -0.2, 1.0), (0.01, 0.02, 0.03))
    yaw, tilt = Pose.from_rotvec((0, 0, np.radians(yaw_deg))), Pose.from_rotvec((0, np.radians(tilt_deg), 0))
    assert is_rotation_seated(tilt @ yaw @ goal, goal, clearance_mm * MM) == is_seated


def test_in_a_pit_deeper_than_the_slot_the_part_is_not_seated() -> None:
    """A neighbour's slot 5 mm deeper takes the part, but below goal height."""
    subject = pair("box")
    pit = box(60, 60, 40, (0, 0, -40)) - box(40, 30, 40, (0, 0, -(subject.depth / MM + 5)))
    around = mesh_from_solid(standing(pit))
    pose = subject.lifted(-5e-3)
    offset = contact_offset(subject.inserted, around, pose)
    assert offset == pytest.approx(0, abs=5e-6)
    assert not seating_result(offset, subject.inserted, pose, subject.goal, subject.depth).seated


def test_a_tilted_pose_comes_down_along_the_axis_it_carries() -> None:
    """Tilted by 10 degrees over a plain top, the part's lowest corner touches first, along the tilted axis."""
    block = Manifold.cube((0.1, 0.1, 0.02), center=True).translate((0, 0, -0.01))
    part = pair("box").part
    pose = Pose.from_rotvec(np.array([0, np.radians(10), 0])) @ Pose.from_translation(np.array([0, 0, 0.03]))
    lowest = pose.apply(part.mesh.vertices)[:, 2].min()
    offset = contact_offset(InsertedPart(part.mesh, Z), mesh_from_solid(block), pose)
    assert offset == pytest.approx(-lowest / np.cos(np.radians(10)), abs=1e-9)
