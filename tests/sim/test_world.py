"""The physics world and parts that settle in it: closed forms, reproducible bytes, pybullet's leaks and errors."""

from __future__ import annotations

import builtins
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold
from scipy.spatial import ConvexHull

from kit1000.cli import main
from kit1000.errors import InputError, ShapeError
from kit1000.generation.build import generate
from kit1000.generation.verify import verify
from kit1000.kits.face import resting_faces
from kit1000.mesh import Mesh, inertia, mesh_from_solid
from kit1000.pose import Pose, random_quaternions
from kit1000.sim.settle import DOWN, POSE_GRID, Release, RestPose, is_stable_facet, principal_axes, rounded_pose, settle
from kit1000.sim.world import GRAVITY, MAX_HULL_VERTICES, STEP_RATE, PhysicsMissing, World, hull_vertices
from tests.samples.mini import MINI
from tests.samples.shapes import box, cylinder, ell, leaning_prism, lying_cylinder, random_solid, standing, upturned_tee
from tests.samples.strategies import poses

CUBE = (np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.01).astype(float)
MOMENTS = np.full(3, 0.05 / 6 * 0.02**2)


def test_a_body_in_the_air_is_in_free_fall() -> None:
    with World() as world:
        cube = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_translation([0, 0, 10.0]), linearDamping=0.0)
        world.step(STEP_RATE // 2)
        assert world.pose(cube).xyz[2] == pytest.approx(10 - GRAVITY * 0.5**2 / 2, abs=GRAVITY * 0.5 / STEP_RATE)
        assert world.speeds(cube) == pytest.approx((GRAVITY * 0.5, 0.0), rel=1e-6)


def test_a_sliding_cube_stops_after_the_distance_of_its_friction() -> None:
    """The coefficient is the product of those of both surfaces; from an initial speed v: v^2 = 2 mu g s."""
    with World() as world:
        world.add_ground(friction=1.0)
        cube = world.add_hull(CUBE, 0.05, MOMENTS, Pose.from_translation([0, 0, 0.01]), lateralFriction=0.3)
        world.push(cube, force=np.array([0.05 * 0.5 * STEP_RATE, 0, 0]), torque=np.zeros(3))
        world.step(STEP_RATE)
        assert world.pose(cube).xyz[0] == pytest.approx(0.5**2 / (2 * 0.3 * GRAVITY), rel=0.05)


def memory() -> int:
    """Bytes of main memory that this process uses."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="reads memory use from /proc")
def test_many_worlds_leak_no_memory() -> None:
    points = mesh_from_solid(standing(cylinder(30, 10, segments=200))).vertices - [0, 0, 0.005]

    def use() -> None:
        with World() as world:
            world.add_ground()
            for i in range(5):
                world.add_hull(points, 0.05, MOMENTS, Pose.from_translation([0.1 * i, 0, 0.1]))
            world.step()

    for _ in range(5):
        use()
    growth = []
    for _ in range(3):  # a leak grows in each round, the heap of the interpreter in one
        before = memory()
        for _ in range(20):  # each would leak 300 kB if the rows of points were allocated anew
            use()
        growth.append(memory() - before)
    assert min(growth) < 3e6


def test_a_world_ends_with_its_block_also_after_an_error() -> None:
    world = World()

    def fail() -> None:
        with world:
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    with pytest.raises(InputError, match="inside its `with` block"):
        world.step()
    with world:  # and can be opened again, empty
        assert world.add_ground() == 0


def test_points_that_span_no_solid_are_rejected() -> None:
    with pytest.raises(ShapeError, match="span a solid"):
        hull_vertices(CUBE * (1, 1, 0))
    with pytest.raises(ShapeError, match="span a solid"):
        hull_vertices(CUBE[:3])


def test_a_hull_keeps_its_vertices_and_drops_interior_points() -> None:
    inside = np.random.default_rng(0).uniform(-0.009, 0.009, (50, 3))
    assert np.array_equal(hull_vertices(np.concatenate([inside, CUBE])), CUBE)


@given(seed=st.integers(0, 100))
@settings(max_examples=3)
def test_a_round_hull_is_simplified_but_keeps_its_shape(seed: int) -> None:
    ball = np.random.default_rng(seed).standard_normal((4000, 3))
    ball *= 0.02 / np.linalg.norm(ball, axis=1, keepdims=True)
    thin = hull_vertices(ball)
    assert len(thin) <= MAX_HULL_VERTICES
    assert -ConvexHull(thin).equations[:, 3].max() > 0.02 * (1 - 0.01)  # the nearest facet
    assert {tuple(corner) for corner in thin} <= {tuple(corner) for corner in ball}


def without_physics(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """As where pybullet is not installed, or is built for another system."""
    imported = builtins.__import__

    def refuse(name: str, *rest: Any, **options: Any) -> Any:
        if name == "pybullet":
            raise error
        return imported(name, *rest, **options)

    monkeypatch.delitem(sys.modules, "pybullet", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)


@pytest.mark.parametrize("error", [ImportError("no module"), OSError("invalid ELF header")])
def test_a_missing_physics_engine_is_no_fault_of_a_dataset(
    mini: Path, error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without_physics(monkeypatch, error)
    report = verify(mini, sample=1)
    assert (report.faults, report.rebuilt) == ((), ())
    (note,) = report.notes
    assert note.startswith("no scene generated again: physics: pybullet is missing or does not load")
    assert "kit1000[sim]" in note
    assert main(["verify", str(mini), "--sample", "1"]) == 0
    assert "faults: none" in capsys.readouterr().out


def test_generate_names_the_missing_engine_before_any_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_physics(monkeypatch, ImportError())
    with pytest.raises(PhysicsMissing, match=r"pip install 'kit1000\[sim\]'; it has wheels for Python 3.10 and 3.11"):
        generate(MINI, tmp_path / "out", workers=1)
    assert not (tmp_path / "out/plan.json").exists()
    assert issubclass(PhysicsMissing, InputError)


DENSITY = 1000.0
SHAPES = {
    "box": lambda: box(40, 30, 20),
    "ell": ell,
    "tee": upturned_tee,
    "leaning": leaning_prism,
    "disc": lambda: cylinder(40, 8),
    "roller": lambda: lying_cylinder(20, 45),
    "cone": lambda: cylinder(40, 30, top=5),
}


def part_of(solid: Manifold) -> Mesh:
    """In metres about its centroid."""
    mesh = mesh_from_solid(standing(solid))
    return Mesh(mesh.vertices - mesh.centroid, mesh.faces)


def dropped_release(
    mesh: Mesh, wxyz: np.ndarray, height: float = 5e-3, at: tuple[float, float] = (0.0, 0.0)
) -> Release:
    """A release with the lowest point `height` above the table."""
    rotation = Pose(wxyz, np.zeros(3))
    lift = height - rotation.apply(mesh.vertices)[:, 2].min()
    return Release(mesh, DENSITY * mesh.volume, Pose(wxyz, np.array([*at, lift])))


def over_support(mesh: Mesh, rest: RestPose) -> bool:
    """Whether the centroid is above the convex hull of the contact points: by Qhull, in the plane."""
    points = rest.world_from_part.apply(mesh.vertices)
    outline = ConvexHull(points[points[:, 2] < points[:, 2].min() + 2e-6, :2])
    centre = rest.world_from_part.apply(mesh.centroid)[:2]
    return bool((outline.equations[:, :2] @ centre + outline.equations[:, 2] < 0).all())


def drops(mesh: Mesh, n: int, seed: int = 0) -> list[RestPose]:
    """Rest poses after drops from uniform rotations, five at a time and far apart."""
    releases = [
        dropped_release(mesh, wxyz, at=(0.2 * (i % 5), 0.0))
        for i, wxyz in enumerate(random_quaternions(np.random.default_rng(seed), n))
    ]
    return [rest for k in range(0, n, 5) for rest in settle(releases[k : k + 5])]


@pytest.mark.parametrize("name", SHAPES)
def test_a_dropped_part_ends_in_static_equilibrium_on_the_table(name: str) -> None:
    mesh = part_of(SHAPES[name]())
    at_rest = [rest for rest in drops(mesh, 5) if rest.stable]
    assert len(at_rest) >= (4 if name == "roller" else 5)  # one roller of twenty rolls for longer than MAX_TIME
    for rest in at_rest:
        assert abs(rest.world_from_part.apply(mesh.vertices)[:, 2].min()) < 1e-6
        assert over_support(mesh, rest)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=8)
def test_any_part_at_rest_is_in_static_equilibrium(seed: int) -> None:
    mesh = part_of(random_solid(seed))
    (rest,) = settle([dropped_release(mesh, random_quaternions(np.random.default_rng(seed), 1)[0])])
    if rest.stable:
        assert abs(rest.world_from_part.apply(mesh.vertices)[:, 2].min()) < 1e-6
        assert over_support(mesh, rest)


def test_settling_twice_gives_the_same_bytes() -> None:
    mesh = part_of(ell())
    first, second = drops(mesh, 5), drops(mesh, 5)
    for a, b in zip(first, second, strict=True):
        assert a.world_from_part.wxyz.tobytes() == b.world_from_part.wxyz.tobytes()
        assert a.world_from_part.xyz.tobytes() == b.world_from_part.xyz.tobytes()


def test_the_last_bits_of_a_release_pose_have_no_effect() -> None:
    mesh = part_of(ell())
    wxyz = rounded_pose(Pose(random_quaternions(np.random.default_rng(1), 1)[0], np.zeros(3))).wxyz
    release = dropped_release(mesh, wxyz)
    pose = release.world_from_part
    # more than last bits, but far less than the grid
    nudged = Release(mesh, release.mass, Pose(pose.wxyz + (1e-10, 0, 0, 0), np.round(pose.xyz, 6) + 1e-10))
    plain = Release(mesh, release.mass, Pose(pose.wxyz, np.round(pose.xyz, 6)))
    (a,), (b,) = settle([plain]), settle([nudged])
    assert a.world_from_part.wxyz.tobytes() == b.world_from_part.wxyz.tobytes()
    assert a.world_from_part.xyz.tobytes() == b.world_from_part.xyz.tobytes()


@pytest.mark.parametrize("yaw", [0.0, 1.0, 4.0])
def test_a_box_released_flat_does_not_move(yaw: float) -> None:
    mesh = part_of(box(40, 30, 20))
    release = dropped_release(mesh, Pose.from_rotvec([0, 0, yaw]).wxyz, height=2e-4, at=(0.1, -0.2))
    (rest,) = settle([release])
    assert rest.stable
    assert rest.world_from_part.xyz == pytest.approx([0.1, -0.2, 0.01], abs=2e-5)
    assert (rest.world_from_part.inverse() @ release.world_from_part).angle() < 1e-3


def test_a_part_far_from_others_rests_as_if_alone() -> None:
    mesh = part_of(ell())
    rotations = random_quaternions(np.random.default_rng(5), 2)
    one, other = dropped_release(mesh, rotations[0]), dropped_release(mesh, rotations[1], at=(0.3, 0.0))
    apart, alone = settle([one, other])[0].world_from_part, settle([one])[0].world_from_part
    # the steps until the others are at rest too may move it by micrometres
    assert apart.xyz == pytest.approx(alone.xyz, abs=5e-5)
    assert (apart.inverse() @ alone).angle() < 5e-3


@given(seed=st.integers(0, 10_000))
@settings(max_examples=10)
def test_the_principal_axes_make_the_inertia_diagonal(seed: int) -> None:
    mesh = part_of(random_solid(seed))
    tensor = inertia(mesh, DENSITY * mesh.volume)
    other = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    other.density = DENSITY
    assert tensor == pytest.approx(other.moment_inertia, rel=1e-6, abs=1e-12)
    rotation = Pose(principal_axes(tensor), np.zeros(3)).rotation_matrix()
    rotated = rotation.T @ tensor @ rotation
    assert np.abs(rotated - np.diag(np.diag(rotated))).max() < 1e-5 * np.trace(tensor)


@given(pose=poses())
def test_a_rounded_pose_is_near_and_does_not_depend_on_the_sign_of_the_quaternion(pose: Pose) -> None:
    rounded = rounded_pose(pose)
    assert (rounded.inverse() @ pose).angle() < 4 * POSE_GRID
    assert np.abs(rounded.xyz - pose.xyz).max() <= POSE_GRID / 2 + 1e-12
    negated = rounded_pose(Pose(-pose.wxyz, pose.xyz))
    assert negated.wxyz.tobytes() == rounded.wxyz.tobytes()


def test_a_facet_is_stable_below_the_centre_of_mass_and_an_edge_never() -> None:
    points = part_of(box(40, 30, 20)).vertices
    assert is_stable_facet(points, DOWN)
    assert not is_stable_facet(points, np.array([0.6, 0.0, -0.8]))  # on an edge
    assert not is_stable_facet(points + [0.03, 0, 0], DOWN)  # the centre of mass beside the face
    assert is_stable_facet(points + [0.0199, 0, 0], DOWN)


@pytest.mark.slow
def test_a_box_falls_on_its_faces_with_the_probabilities_of_the_quasi_static_model() -> None:
    """Within twice the standard error of 400 drops."""
    mesh = part_of(box(40, 32, 24))
    axes = np.array([np.abs(rest.world_from_part.rotation_matrix()[2]).argmax() for rest in drops(mesh, 400)])
    observed = np.bincount(axes, minlength=3) / len(axes)
    expected = np.zeros(3)
    for face in resting_faces(mesh):
        expected[np.abs(face.normal).argmax()] += face.probability
    assert observed == pytest.approx(expected, abs=0.05)
