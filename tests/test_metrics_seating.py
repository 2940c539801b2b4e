"""Seating of predicted motions: as single trials have it, in whole assemblies, and exact where a limit is near."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold, OpType

from kit1000.errors import InputError, ShapeError
from kit1000.kits.acceptance import SeatingTest, rotated_about_centroid
from kit1000.kits.contact import convex_edges
from kit1000.kits.seating import (
    HOVER,
    BISECTION_STEP,
    SEATED_LIMIT,
    STRICT_LIMIT,
    InsertedPart,
    contact_offset,
    contact_offset_by_booleans,
    swept_solid,
    seating_result,
)
from kit1000.mesh import Mesh, defect, mesh_from_solid, solid_from_mesh
from kit1000.metrics import Seatings, seatings
from kit1000.metrics.exact_seating import SweptVolume, ContactInterval, contact_in_interval
from kit1000.motions import goal_motion
from kit1000.pose import Pose, random_quaternions
from kit1000.values import Assembly, FreeAxis, Kit, Mount, Part, Truth
from tests.sample_kits import QUICK, sample_kit, sample_part
from tests.shapes import cylinder, leaning_prism, lying_cylinder, random_solid, seated, upturned_tee

laws = settings(max_examples=40)
APART = 0.15  # [m] between two kits of an assembly
PAIRS = [f"{a}+{b}" for a, b in zip(QUICK, [*QUICK[1:], QUICK[0]], strict=True)]
NOTHING = 1e-12  # [m^3] a cube of 0.1 mm
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Shelf:
    """Parts and assemblies by id, as a dataset gives them."""

    parts: dict[str, Part]
    assemblies: dict[str, Assembly]

    def part(self, part_id: str) -> Part:
        return self.parts[part_id]

    def assembly(self, assembly_id: str) -> Assembly:
        return self.assemblies[assembly_id]


@cache
def shelf() -> Shelf:
    """One assembly of two kits, the second tilted, for every two families; and one of a round part."""
    parts = {name: sample_part(name) for name in QUICK}
    assemblies = {pair: joined(pair, [sample_kit(name) for name in pair.split("+")]) for pair in PAIRS}
    part, kit = round_pair()
    return Shelf({**parts, part.id: part}, {**assemblies, "round": joined("round", [kit])})


@cache
def round_pair() -> tuple[Part, Kit]:
    place = seated(cylinder(30, 24))
    part, kit = replace(place.part, id="round"), place.kit()
    slot = replace(kit.slot, part_id="round", free_axis=FreeAxis(np.zeros(3), UP))
    return part, replace(kit, slot=slot)


def joined(assembly_id: str, kits: list[Kit]) -> Assembly:
    """Kits in a row, each tilted 20 degrees more than the last."""
    tilts = [Pose.from_rotvec(np.array([0.35 * k, 0, 0]), np.array([APART * k, 0, 0.1])) for k in range(len(kits))]
    meshes = [kit.mesh.moved(pose) for kit, pose in zip(kits, tilts, strict=True)]
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    mesh = Mesh(np.concatenate([mesh.vertices for mesh in meshes]), faces)
    return Assembly(assembly_id, mesh, tuple(map(Mount, kits, tilts)))


def truth_of(assembly_id: str, mount: int = 0, seed: int = 0) -> Truth:
    """A query about one of the parts of an assembly; part and assembly stand anywhere."""
    rng = np.random.default_rng(seed)
    held = shelf().assemblies[assembly_id].mounts[mount]
    slot = held.kit.slot
    world_from_assembly, world_from_part = (
        Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.4, 0.4, 3)) for _ in range(2)
    )
    world_from_kit = world_from_assembly @ held.assembly_from_kit
    home = goal_motion(world_from_part, world_from_kit, slot.goals[0])
    return Truth(
        *(f"{assembly_id}-q", assembly_id, slot.part_id, "family", "upright", 2, 0.9),
        *(world_from_part.xyz, world_from_part, world_from_kit, slot, home),
    )


def moved(truth: Truth, kit_from_part: Pose) -> Pose:
    """goal_from_now that takes the part to a pose in its kit's frame."""
    return goal_motion(truth.world_from_part, truth.world_from_kit, kit_from_part)


def said_of(*tries: tuple[Truth, Pose], judge: str = "near", workers: int = 1) -> Seatings:
    """What is said of parts taken to poses in the frames of their kits."""
    truths = [truth for truth, _ in tries]
    return seatings(Pose.stack([moved(*one) for one in tries]), truths, shelf(), judge, workers)


def errors(seed: int, n: int, shift: float = 4e-3, turn: float = 0.15) -> np.ndarray:
    """(n, 6) shifts [m] and turns [rad] of any direction and axis."""
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(n, 2, 3))
    ways /= np.linalg.norm(ways, axis=2, keepdims=True)
    return (ways * rng.uniform(0, [shift, turn], (n, 2))[..., None]).reshape(n, 6)


def off(goal: Pose, error: np.ndarray) -> Pose:
    return Pose.from_translation(error[:3]) @ rotated_about_centroid(goal, error[3:])


@pytest.mark.parametrize("mount", [0, 1])
@pytest.mark.parametrize("assembly_id", PAIRS)
def test_every_goal_is_seated_strictly_in_an_assembly(assembly_id: str, mount: int) -> None:
    truth = truth_of(assembly_id, mount)
    found = said_of(*((truth, goal) for goal in truth.slot.goals))
    assert found.seated.all()
    assert found.strict.all()
    assert np.abs(found.contact_height).max() < 0.01e-3
    assert found.penetration.max() < 0.01e-3


def test_a_round_part_is_seated_at_any_turn() -> None:
    """The goal of the verdict is the one of the pose errors, turned as they judge."""
    truth = truth_of("round")
    goal = truth.slot.goals[0]
    turned = [Pose.from_rotvec(np.array([0, 0, angle])) @ goal for angle in np.arange(0, 6.3, 0.7)]
    found = said_of(*((truth, pose) for pose in turned))
    assert found.strict.all()


@pytest.mark.parametrize("name", QUICK)
def test_verdicts_are_those_of_single_trials(name: str) -> None:
    """A kit alone, in its own frame: what making the pairs asks."""
    truth = truth_of(next(i for i in shelf().assemblies if i.startswith(name)))
    goal, seat = truth.slot.goals[0], SeatingTest(sample_part(name).mesh, sample_kit(name))
    poses = [off(goal, error) for error in errors(QUICK.index(name), 30)]
    found = said_of(*((truth, pose) for pose in poses), judge="never")
    alone = [seat.result(pose, goal) for pose in poses]
    assert 0 < sum(one.seated for one in alone) < len(alone)
    assert found.seated.tolist() == [one.seated for one in alone]
    assert found.strict.tolist() == [one.strict for one in alone]
    assert found.contact_offset == pytest.approx([one.contact_offset for one in alone], abs=1e-9)
    assert found.contact_height == pytest.approx([one.contact_height for one in alone], abs=1e-9)
    assert found.penetration == pytest.approx([one.penetration for one in alone], abs=1e-9)
    assert not found.exact.any()


@pytest.mark.parametrize("name", QUICK)
def test_the_judge_is_that_of_the_bisection(name: str) -> None:
    """Where it is asked, about poses at the brink, it says what the bisected booleans say, but for their step."""
    truth = truth_of(next(i for i in shelf().assemblies if i.startswith(name)))
    goal, slot = truth.slot.goals[0], truth.slot
    mesh, plate = sample_part(name).mesh, solid_from_mesh(sample_kit(name).mesh)
    plug = InsertedPart.of(mesh, goal)
    swept = swept_solid(mesh, plug.axis)
    lifts = [limit + step for limit in (SEATED_LIMIT, STRICT_LIMIT) for step in (-45e-6, -5e-6, 35e-6)]
    poses = [off(goal, np.array([0, 0, lift, 0, 0, 0])) for lift in lifts] + [off(goal, e) for e in errors(1, 3)]
    found = said_of(*((truth, pose) for pose in poses), judge="all")
    assert found.exact.all()
    assert not found.disagrees.any()
    for i, pose in enumerate(poses):
        said = seating_result(contact_offset_by_booleans(swept, plug, plate, pose), plug, pose, goal, slot.depth)
        assert (found.seated[i], found.strict[i]) == (said.seated, said.strict), i


def body(name: str) -> tuple[Mesh, np.ndarray]:
    """A part and the axis (3,) it leaves along."""
    if name in QUICK:
        return sample_part(name).mesh, sample_kit(name).slot.goals[0].inverse().rotate(UP)
    return mesh_from_solid(SHAPES[name]().scale((1e-3, 1e-3, 1e-3))), UP


SHAPES = {
    "upturned tee": upturned_tee,
    "leaning prism": leaning_prism,
    "lying cylinder": lambda: lying_cylinder(20, 34),
    "random": lambda: random_solid(3),
}


@pytest.mark.parametrize("name", [*QUICK, *SHAPES])
def test_the_sheets_of_a_sweep_are_what_the_part_sweeps(name: str) -> None:
    """All of it, and nothing else but what a longer way sweeps."""
    mesh, axis = body(name)
    sheets = Manifold.batch_boolean(list(SweptVolume.of(mesh, axis).solids), OpType.Add)
    assert (swept_solid(mesh, axis) - sheets).volume() < NOTHING
    assert (sheets - swept_solid(mesh, axis, HOVER + np.ptp(mesh.vertices @ axis))).volume() < NOTHING


def test_a_thread_lies_over_itself_and_still_tells_what_it_meets() -> None:
    """Two turns of a ramp, one patch: a ball is met from below its lowest face to the end of the way, and not aside."""
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
    sweep = SweptVolume.of(mesh, UP)
    ball = Manifold.sphere(1e-3, 24)
    for height, clear in ((-2e-3, True), (3e-3, False), (10e-3, False), (60e-3, False), (-40e-3, True)):
        for turn in (0.0, 2.0, 4.0):
            at = (7.5e-3 * np.cos(turn), 7.5e-3 * np.sin(turn), height + 1e-3 * turn)
            assert sweep.is_collision_free(ball.translate(at), Pose.identity(), 0.0) == clear
    assert sweep.is_collision_free(ball.translate((0, 0, 50e-3)), Pose.identity(), 0.0)


@laws
@given(st.integers(0, 10_000))
def test_a_sweep_is_clear_from_contact_on(seed: int) -> None:
    """Closed form and booleans, on the two sides of contact."""
    truth = truth_of("channel+tee", seed % 2)
    name = truth.part_id
    mesh, goal = shelf().part(name).mesh, truth.slot.goals[0]
    plug = InsertedPart.of(mesh, goal)
    pose = off(goal, errors(seed, 1, 10e-3, 0.4)[0])
    rise = contact_offset(plug, convex_edges(sample_kit(name).mesh), pose)
    sweep, plate = SweptVolume.of(mesh, plug.axis), solid_from_mesh(sample_kit(name).mesh)
    assert sweep.is_collision_free(plate, pose, rise + BISECTION_STEP / 2)
    assert not sweep.is_collision_free(plate, pose, rise - BISECTION_STEP / 2)


@laws
@given(st.floats(-5e-3, 5e-3), st.floats(-4e-3, 4e-3), st.floats(-1, 1), st.floats(4e-3, 20e-3))
def test_a_window_holds_the_rises_that_the_verdict_takes(lift: float, rise: float, lean: float, depth: float) -> None:
    axis = np.array([np.sqrt(1 - lean**2), 0, lean])
    pose, goal = Pose.from_translation(np.array([0, 0, lift])), Pose.identity()
    plug = InsertedPart(convex_edges(sample_part("tee").mesh), axis)
    said = seating_result(rise, plug, pose, goal, depth)

    def unasked(end: float) -> bool:
        raise AssertionError(f"asked at {end}")

    for limit, wanted in ((SEATED_LIMIT, said.seated), (STRICT_LIMIT, said.strict)):
        window = ContactInterval.of(limit, depth, lean, lift)
        if not window.has_end_within(rise, 1e-9):
            assert contact_in_interval(window, rise, 0.0, unasked) == wanted
            assert contact_in_interval(window, 0.0, np.inf, lambda end, rise=rise: rise <= end) == wanted


def test_the_judge_is_asked_near_limits_alone() -> None:
    truth = truth_of("tee+foot")
    lifts = np.array([0.0, 0.8, 0.92, 1.05, 2.0, 2.93, 3.05, 3.2]) * 1e-3
    tries = [(truth, off(truth.slot.goals[0], np.array([0, 0, lift, 0, 0, 0]))) for lift in lifts]
    for judge in ("near", "all", "never"):
        found = said_of(*tries, judge=judge)
        near = np.isin(np.arange(8), (2, 3, 5, 6))
        assert found.exact.tolist() == {"near": near, "all": near | True, "never": near & False}[judge].tolist()
        assert found.strict.tolist() == (lifts < STRICT_LIMIT).tolist()
        assert found.seated.tolist() == (lifts < SEATED_LIMIT).tolist()


def test_a_part_in_the_slot_of_its_neighbour_is_not_seated() -> None:
    """Two kits for the same part: at goal height over the other plate it is in the wrong slot."""
    kit = sample_kit("tee")
    there = Pose.from_translation(np.array([APART, 0, 0]))
    two = mesh_from_solid(solid_from_mesh(kit.mesh) + solid_from_mesh(kit.mesh.moved(there)))
    twins = Assembly("twins", two, (Mount(kit, Pose.identity()),))
    truth = replace(truth_of("tee+foot"), assembly_id="twins")
    goal = truth.slot.goals[0]
    predicted = Pose.stack([moved(truth, goal), moved(truth, there @ goal)])
    for judge in ("near", "all"):
        found = seatings(predicted, [truth] * 2, Shelf(shelf().parts, {"twins": twins}), judge)
        assert np.abs(found.contact_height).max() < 0.01e-3
        assert found.seated.tolist() == found.strict.tolist() == [True, False]


def test_nothing_below_is_not_seated() -> None:
    truth = truth_of("tee+foot")
    away = Pose.from_translation(np.array([0, 5.0, 0])) @ truth.slot.goals[0]
    for judge in ("near", "all", "never"):
        found = said_of((truth, away), judge=judge)
        assert found.contact_offset[0] == found.contact_height[0] == -np.inf
        assert found.penetration[0] == 0
        assert not found.seated[0]


def test_penetration_is_how_far_below_contact_a_prediction_lies() -> None:
    truth = truth_of("tee+foot")
    for lift in (-2e-3, -0.5e-3, 1.5e-3):
        found = said_of((truth, off(truth.slot.goals[0], np.array([0, 0, lift, 0, 0, 0]))))
        assert found.penetration[0] == pytest.approx(max(-lift, 0), abs=1e-5)
        assert found.contact_offset[0] == pytest.approx(-lift, abs=1e-5)
        assert found.contact_height[0] == pytest.approx(0, abs=1e-5)


def test_the_answer_depends_on_nothing_but_the_query() -> None:
    """Neither on order, nor company, nor processes, nor on where the world stands."""
    truths = [truth_of(i, k, seed) for seed, (i, k) in enumerate([("tee+foot", 0), ("round", 0), ("tee+foot", 1)] * 3)]
    tries = [(t, off(t.slot.goals[0], e)) for t, e in zip(truths, errors(5, 9), strict=True)]
    whole, spread = said_of(*tries, judge="all"), said_of(*tries, judge="all", workers=2)
    back = said_of(*tries[::-1], judge="all")
    for name in ("seated", "strict", "judged", "rise", "height", "penetration"):
        assert np.array_equal(getattr(whole, name), getattr(spread, name)), name
        assert np.array_equal(getattr(whole, name), getattr(back, name)[::-1]), name
    stand = Pose(random_quaternions(np.random.default_rng(1), 1)[0], np.array([0.3, -0.2, 0.1]))
    carried = [
        replace(t, world_from_kit=stand @ t.world_from_kit, world_from_part=stand @ t.world_from_part) for t in truths
    ]
    elsewhere = said_of(*zip(carried, (pose for _, pose in tries), strict=True), judge="all")
    assert elsewhere.contact_offset == pytest.approx(whole.contact_offset, abs=1e-9)
    assert np.array_equal(elsewhere.seated, whole.seated)


def test_no_queries_have_no_verdicts() -> None:
    found = seatings(Pose.identity((0,)), [], shelf())
    assert found.seated.shape == found.contact_offset.shape == (0,)
    assert found.seated.dtype == bool


def test_what_is_said_is_read_only() -> None:
    truth = truth_of("round")
    with pytest.raises(ValueError, match="read-only"):
        said_of((truth, truth.slot.goals[0])).seated[0] = False


def test_what_is_no_input_is_refused() -> None:
    truth = truth_of("round")
    with pytest.raises(ShapeError, match=r"predicted: expected a batch of shape \(1,\)"):
        seatings(Pose.identity(), [truth], shelf())
    with pytest.raises(InputError, match="judge: expected near, all, never, got 'sometimes'"):
        seatings(Pose.identity((1,)), [truth], shelf(), "sometimes")
    with pytest.raises(InputError, match="workers: expected 1 or more, got 0"):
        seatings(Pose.identity((1,)), [truth], shelf(), workers=0)
    with pytest.raises(InputError, match=r"tee\+foot: expected one slot for round, found 0"):
        seatings(Pose.identity((1,)), [replace(truth, assembly_id="tee+foot")], shelf())
