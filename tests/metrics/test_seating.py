"""The seating test of predicted motions: equal to single trials, in whole assemblies, exact where a limit is near."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold

from kit1000.errors import InputError, ShapeError
from kit1000.kits.kit_trials import seating_at
from kit1000.kits.prepared import PreparedKit
from kit1000.kits.seating import (
    BISECTION_STEP,
    SEATED_LIMIT,
    STRICT_LIMIT,
    InsertedPart,
    SeatingResult,
    contact_offset,
    rotated_about_centroid,
    seating_result,
)
from kit1000.mesh import Mesh, defect, mesh_from_solid, solid_from_mesh
from kit1000.metrics import Seatings, seatings
from kit1000.metrics.exact_seating import ContactInterval, SweptVolume, contact_in_interval
from kit1000.metrics.seating import SeatingTestResult, as_seatings, is_over_plate
from kit1000.pose import Pose, random_quaternions
from kit1000.queries.motions import goal_motion
from kit1000.values import Assembly, FreeAxis, Kit, Mount, Part, Truth
from tests.samples.exact_offset import contact_offset_by_booleans, swept_solid
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import cylinder, seated

KIT_PITCH = 0.15  # [m] between two kits of an assembly
ASSEMBLY_IDS = [f"{a}+{b}" for a, b in zip(QUICK, [*QUICK[1:], QUICK[0]], strict=True)]
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class SampleGeometry:
    """Parts and assemblies by id, as a dataset gives them."""

    parts: dict[str, Part]
    assemblies: dict[str, Assembly]

    def part(self, part_id: str) -> Part:
        return self.parts[part_id]

    def assembly(self, assembly_id: str) -> Assembly:
        return self.assemblies[assembly_id]


@cache
def sample_geometry() -> SampleGeometry:
    """One assembly of two kits, the second tilted, for every two families; and one of a round part."""
    parts = {name: sample_part(name) for name in QUICK}
    assemblies = {pair: assembly_of(pair, [sample_kit(name) for name in pair.split("+")]) for pair in ASSEMBLY_IDS}
    part, kit = round_part_and_kit()
    return SampleGeometry({**parts, part.id: part}, {**assemblies, "round": assembly_of("round", [kit])})


@cache
def round_part_and_kit() -> tuple[Part, Kit]:
    place = seated(cylinder(30, 24))
    part, kit = replace(place.part, id="round"), place.kit()
    slot = replace(kit.slot, part_id="round", free_axis=FreeAxis(np.zeros(3), UP))
    return part, replace(kit, slot=slot)


def assembly_of(assembly_id: str, kits: list[Kit]) -> Assembly:
    """Kits in a row, each tilted 20 degrees more than the last."""
    tilts = [Pose.from_rotvec(np.array([0.35 * k, 0, 0]), np.array([KIT_PITCH * k, 0, 0.1])) for k in range(len(kits))]
    meshes = [kit.mesh.moved(pose) for kit, pose in zip(kits, tilts, strict=True)]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    mesh = Mesh(np.concatenate([mesh.vertices for mesh in meshes]), faces)
    return Assembly(assembly_id, mesh, tuple(map(Mount, kits, tilts)))


def truth_of(assembly_id: str, mount: int = 0, seed: int = 0) -> Truth:
    """A query about one part of an assembly; the part and the assembly are posed at random."""
    rng = np.random.default_rng(seed)
    kit_mount = sample_geometry().assemblies[assembly_id].mounts[mount]
    slot = kit_mount.kit.slot
    world_from_assembly, world_from_part = (
        Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.4, 0.4, 3)) for _ in range(2)
    )
    world_from_kit = world_from_assembly @ kit_mount.assembly_from_kit
    goal_drawn = goal_motion(world_from_part, world_from_kit, slot.goals[0])
    return Truth(
        *(f"{assembly_id}-q", assembly_id, slot.part_id, "family", "upright", 2, 0.9),
        *(world_from_part.xyz, world_from_part, world_from_kit, slot, goal_drawn),
    )


def motion_to(truth: Truth, kit_from_part: Pose) -> Pose:
    """goal_from_now that takes the part to a pose in its kit's frame."""
    return goal_motion(truth.world_from_part, truth.world_from_kit, kit_from_part)


def results_of(*poses: tuple[Truth, Pose], exact: str = "near", workers: int = 1) -> Seatings:
    """Seating results of parts at poses in the frames of their kits."""
    truths = [truth for truth, _ in poses]
    return seatings(Pose.stack([motion_to(*pose) for pose in poses]), truths, sample_geometry(), exact, workers)


def random_errors(seed: int, n: int, offset: float = 4e-3, angle: float = 0.15) -> np.ndarray:
    """(n, 6) random offsets [m] and rotation vectors [rad]."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(n, 2, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    return (directions * rng.uniform(0, [offset, angle], (n, 2))[..., None]).reshape(n, 6)


def displaced(goal: Pose, error: np.ndarray) -> Pose:
    return Pose.from_translation(error[:3]) @ rotated_about_centroid(goal, error[3:])


def raised(goal: Pose, height: float) -> Pose:
    return displaced(goal, np.array([0, 0, height, 0, 0, 0]))


@pytest.mark.parametrize("mount", [0, 1])
@pytest.mark.parametrize("assembly_id", ASSEMBLY_IDS)
def test_every_goal_is_seated_strictly_in_an_assembly(assembly_id: str, mount: int) -> None:
    truth = truth_of(assembly_id, mount)
    results = results_of(*((truth, goal) for goal in truth.slot.goals))
    assert results.seated.all()
    assert results.strict.all()
    assert np.abs(results.contact_height).max() < 0.01e-3
    assert results.penetration.max() < 0.01e-3


def test_a_round_part_is_seated_at_any_angle() -> None:
    """The goal of the seating test is that of the pose errors, at its angle about the free axis."""
    truth = truth_of("round")
    goal = truth.slot.goals[0]
    rotated = [Pose.from_rotvec(np.array([0, 0, angle])) @ goal for angle in np.arange(0, 6.3, 0.7)]
    results = results_of(*((truth, pose) for pose in rotated))
    assert results.strict.all()


@pytest.mark.parametrize(("tilt", "is_seated"), [(9.9, True), (10.1, False)])
def test_a_jammed_part_is_seated_up_to_10_degrees_from_its_goal(tilt: float, is_seated: bool) -> None:
    truth, spun = truth_of("round"), Pose.from_rotvec(np.array([0, 0, 2.0]))
    pose = rotated_about_centroid(spun @ truth.slot.goals[0], np.radians([tilt, 0, 0]))
    pose = Pose.from_translation(results_of((truth, pose)).contact_offset[0] * pose.rotate(UP)) @ pose
    assert all(results_of((truth, pose), exact=mode).seated[0] == is_seated for mode in ("near", "all", "never"))


@pytest.mark.parametrize("name", QUICK)
def test_results_equal_those_of_single_trials(name: str) -> None:
    """Of a kit alone, in its own frame: the test that the generation of kits runs."""
    truth = truth_of(next(i for i in sample_geometry().assemblies if i.startswith(name)))
    goal, part, kit = truth.slot.goals[0], sample_part(name).mesh, PreparedKit(sample_kit(name))
    poses = [displaced(goal, error) for error in random_errors(QUICK.index(name), 30)]
    results = results_of(*((truth, pose) for pose in poses), exact="never")
    single = [seating_at(InsertedPart.of(part, goal), kit, pose, goal) for pose in poses]
    assert 0 < sum(one.seated for one in single) < len(single)
    assert results.seated.tolist() == [one.seated for one in single]
    assert results.strict.tolist() == [one.strict for one in single]
    assert results.contact_offset == pytest.approx([one.contact_offset for one in single], abs=1e-9)
    assert results.contact_height == pytest.approx([one.contact_height for one in single], abs=1e-9)
    assert results.penetration == pytest.approx([one.penetration for one in single], abs=1e-9)
    assert not results.exact.any()


@pytest.mark.parametrize("name", QUICK)
def test_the_exact_test_equals_the_bisection(name: str) -> None:
    """At poses near the limits, beyond the step of the bisection."""
    truth = truth_of(next(i for i in sample_geometry().assemblies if i.startswith(name)))
    goal, slot = truth.slot.goals[0], truth.slot
    mesh, plate = sample_part(name).mesh, solid_from_mesh(sample_kit(name).mesh)
    inserted = InsertedPart.of(mesh, goal)
    swept = swept_solid(mesh, inserted.axis)
    heights = [limit + step for limit in (SEATED_LIMIT, STRICT_LIMIT) for step in (-45e-6, -5e-6, 35e-6)]
    poses = [*(raised(goal, height) for height in heights), displaced(goal, random_errors(1, 1)[0])]
    results = results_of(*((truth, pose) for pose in poses), exact="all")
    assert results.exact.all()
    assert not results.disagrees.any()
    for i, pose in enumerate(poses):
        offset = contact_offset_by_booleans(swept, inserted, plate, pose)
        expected = seating_result(offset, inserted, pose, goal, slot.depth)
        assert (results.seated[i], results.strict[i]) == (expected.seated, expected.strict), i


def test_the_swept_volume_of_a_thread_overlaps_itself_and_still_detects_collisions() -> None:
    """Two turns of a ramp, one patch: a ball collides from below its lowest face to the end of the path."""
    angle = np.linspace(0, 4 * np.pi, 97)
    rim = [np.stack([r * np.cos(angle), r * np.sin(angle), 1e-3 * angle], axis=1) for r in (5e-3, 10e-3)]
    corners, n = np.concatenate([*rim, *(line + [0, 0, 1e-3] for line in rim)]), len(angle)
    i = np.arange(n - 1)
    walls = [(0, 1), (3, 2), (2, 0), (1, 3)]  # below, above, inside, outside: from line to line
    faces = [np.stack([a * n + i, a * n + i + 1, b * n + i], 1) for a, b in walls]
    faces += [np.stack([a * n + i + 1, b * n + i + 1, b * n + i], 1) for a, b in walls]
    last = n - 1
    ends = np.array([[0, n, 2 * n], [n, 3 * n, 2 * n]])
    faces += [ends, ends[:, ::-1] + last]
    mesh = Mesh(corners, np.concatenate(faces).astype(np.int32))
    assert defect(mesh) is None
    swept_volume = SweptVolume.of(mesh, UP)
    ball = Manifold.sphere(1e-3, 24)
    for height, collision_free in ((-2e-3, True), (3e-3, False), (10e-3, False), (60e-3, False), (-40e-3, True)):
        for position in (0.0, 2.0, 4.0):
            at = (7.5e-3 * np.cos(position), 7.5e-3 * np.sin(position), height + 1e-3 * position)
            assert swept_volume.is_collision_free(ball.translate(at), Pose.identity(), 0.0) == collision_free
    assert swept_volume.is_collision_free(ball.translate((0, 0, 50e-3)), Pose.identity(), 0.0)


@given(st.integers(0, 10_000))
def test_a_swept_volume_is_collision_free_from_contact_on(seed: int) -> None:
    """Closed form and booleans agree on both sides of contact."""
    truth = truth_of("channel+tee", seed % 2)
    name = truth.part_id
    mesh, goal = sample_geometry().part(name).mesh, truth.slot.goals[0]
    inserted = InsertedPart.of(mesh, goal)
    pose = displaced(goal, random_errors(seed, 1, 10e-3, 0.4)[0])
    offset = contact_offset(inserted, sample_kit(name).mesh, pose)
    swept_volume, plate = SweptVolume.of(mesh, inserted.axis), solid_from_mesh(sample_kit(name).mesh)
    assert swept_volume.is_collision_free(plate, pose, offset + BISECTION_STEP / 2)
    assert not swept_volume.is_collision_free(plate, pose, offset - BISECTION_STEP / 2)


@given(st.floats(-5e-3, 5e-3), st.floats(-4e-3, 4e-3), st.floats(-1, 1), st.floats(4e-3, 20e-3))
def test_a_contact_interval_holds_the_offsets_that_pass_the_seating_test(
    height: float, offset: float, cosine: float, depth: float
) -> None:
    axis = np.array([np.sqrt(1 - cosine**2), 0, cosine])
    pose, goal = Pose.from_translation(np.array([0, 0, height])), Pose.identity()
    inserted = InsertedPart(sample_part("tee").mesh, axis)
    result = seating_result(offset, inserted, pose, goal, depth)

    def never_called(end: float) -> bool:
        raise AssertionError(f"called at {end}")

    for limit, passed in ((SEATED_LIMIT, result.seated), (STRICT_LIMIT, result.strict)):
        interval = ContactInterval.of(limit, depth, cosine, height)
        if not interval.has_end_within(1e-9, offset):
            assert contact_in_interval(interval, offset, 0.0, never_called) == passed
            assert contact_in_interval(interval, 0.0, np.inf, lambda end, offset=offset: offset <= end) == passed


def test_the_exact_test_decides_near_limits_only() -> None:
    truth = truth_of("tee+foot")
    heights = np.array([0.0, 0.8, 0.92, 1.05, 2.0, 2.93, 3.05, 3.2]) * 1e-3
    trials = [(truth, raised(truth.slot.goals[0], height)) for height in heights]
    for exact in ("near", "all", "never"):
        results = results_of(*trials, exact=exact)
        near = np.isin(np.arange(8), (2, 3, 5, 6))
        assert results.exact.tolist() == {"near": near, "all": near | True, "never": near & False}[exact].tolist()
        assert results.strict.tolist() == (heights < STRICT_LIMIT).tolist()
        assert results.seated.tolist() == (heights < SEATED_LIMIT).tolist()


def test_a_part_in_the_slot_of_its_neighbour_is_not_seated() -> None:
    """Two kits for the same part: at goal height in the other kit it is in the wrong slot."""
    kit = sample_kit("tee")
    to_twin = Pose.from_translation(np.array([KIT_PITCH, 0, 0]))
    two = mesh_from_solid(solid_from_mesh(kit.mesh) + solid_from_mesh(kit.mesh.moved(to_twin)))
    twins = Assembly("twins", two, (Mount(kit, Pose.identity()),))
    truth = replace(truth_of("tee+foot"), assembly_id="twins")
    goal = truth.slot.goals[0]
    predicted = Pose.stack([motion_to(truth, goal), motion_to(truth, to_twin @ goal)])
    for exact in ("near", "all"):
        results = seatings(predicted, [truth] * 2, SampleGeometry(sample_geometry().parts, {"twins": twins}), exact)
        assert np.abs(results.contact_height).max() < 0.01e-3
        assert results.seated.tolist() == results.strict.tolist() == [True, False]


@pytest.mark.parametrize("side", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_part_beside_its_own_plate_at_floor_height_is_not_seated(side: tuple[int, int]) -> None:
    """On a block as high as the cavity's floor it is at goal height: it passes all but the bounds of its plate."""
    kit, truth = sample_kit("tee"), replace(truth_of("tee+foot"), assembly_id="beside")
    goal, outward = truth.slot.goals[0], np.array([*side, 0.0])
    reach = (sample_part("tee").mesh.moved(goal).vertices @ -outward).max()
    distance = kit.extent[0] / 2 + reach + 1e-3  # of the part: it clears the plate by 1 mm
    block = Manifold.cube((0.06, 0.06, 0.02), center=True).translate(
        (kit.extent[0] / 2 + 0.0305) * outward - [0, 0, kit.slot.depth + 0.01]
    )
    both = mesh_from_solid(solid_from_mesh(kit.mesh) + block)
    beside = {"beside": Assembly("beside", both, (Mount(kit, Pose.identity()),))}
    predicted = Pose.stack([motion_to(truth, Pose.from_translation(distance * outward) @ goal)])
    for exact in ("near", "all"):
        results = seatings(predicted, [truth], SampleGeometry(sample_geometry().parts, beside), exact)
        assert abs(results.contact_height[0]) < 0.01e-3
        assert abs(results.contact_offset[0]) < 0.01e-3
        assert not results.seated[0]
        assert not results.strict[0]


@pytest.mark.parametrize(
    ("x", "offset", "over"), [(49e-3, 10e-3, False), (53e-3, -10e-3, True), (49e-3, -np.inf, True)]
)
def test_the_bounds_of_the_plate_hold_at_contact(x: float, offset: float, over: bool) -> None:
    """Not at the predicted pose, from which a tilted part comes down sideways."""
    axis, extent = np.array([0.6, 0, 0.8]), np.array([99e-3, 99e-3, 22e-3])
    assert is_over_plate(np.array([x, 0, 0]), axis, offset, extent) == over


@pytest.mark.parametrize(
    ("seated", "strict", "differs"), [(True, True, False), (True, False, True), (False, False, True)]
)
def test_the_tests_disagree_when_either_result_differs(seated: bool, strict: bool, differs: bool) -> None:
    closed, final = SeatingResult(0.0, 0.0, True, True, True), SeatingResult(0.0, 0.0, True, seated, strict)
    assert as_seatings([SeatingTestResult(closed, final, True)]).disagrees.tolist() == [differs]


def test_nothing_below_is_not_seated() -> None:
    truth = truth_of("tee+foot")
    away = Pose.from_translation(np.array([0, 5.0, 0])) @ truth.slot.goals[0]
    for exact in ("near", "all", "never"):
        results = results_of((truth, away), exact=exact)
        assert results.contact_offset[0] == results.contact_height[0] == -np.inf
        assert results.penetration[0] == 0
        assert not results.seated[0]


def test_penetration_is_the_depth_of_a_prediction_below_contact() -> None:
    truth = truth_of("tee+foot")
    for height in (-2e-3, -0.5e-3, 1.5e-3):
        results = results_of((truth, raised(truth.slot.goals[0], height)))
        assert results.penetration[0] == pytest.approx(max(-height, 0), abs=1e-5)
        assert results.contact_offset[0] == pytest.approx(-height, abs=1e-5)
        assert results.contact_height[0] == pytest.approx(0, abs=1e-5)


def test_no_queries_have_no_results() -> None:
    results = seatings(Pose.identity((0,)), [], sample_geometry())
    assert results.seated.shape == results.contact_offset.shape == (0,)
    assert results.seated.dtype == bool


def test_wrong_input_is_refused() -> None:
    truth = truth_of("round")
    with pytest.raises(ShapeError, match=r"predicted: expected a batch of shape \(1,\)"):
        seatings(Pose.identity(), [truth], sample_geometry())
    with pytest.raises(InputError, match="exact: expected near, all, never, got 'sometimes'"):
        seatings(Pose.identity((1,)), [truth], sample_geometry(), "sometimes")
    with pytest.raises(InputError, match="workers: expected 1 or more, got 0"):
        seatings(Pose.identity((1,)), [truth], sample_geometry(), workers=0)
    with pytest.raises(InputError, match=r"tee\+foot: expected one slot for round, found 0"):
        seatings(Pose.identity((1,)), [replace(truth, assembly_id="tee+foot")], sample_geometry())
