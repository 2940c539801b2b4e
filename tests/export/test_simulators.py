"""Exports as URDF, MJCF and STL: simulators, physics and other readers find the assemblies, parts and scenes."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pybullet as bullet
import pytest
import trimesh
from hypothesis import given
from manifold3d import Manifold

from kit1000.dataset.geometry import Geometry
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.export import FORMATS, export, standing_mesh
from kit1000.export.urdf import roll_pitch_yaw, write_urdf
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.kits.kit import make_kit
from kit1000.mesh import Mesh, inertia, solid_from_mesh
from kit1000.parts.family import DENSITY
from kit1000.parts.files.read import read_mesh
from kit1000.pose import Pose, quaternion_angle
from kit1000.sim.world import FRICTION
from kit1000.symmetry import Symmetry
from kit1000.values import Assembly
from tests.samples.kits import sample_kit, sample_part
from tests.samples.labelled_scenes import shapes_folder
from tests.samples.shapes import as_part
from tests.samples.strategies import poses

LONGEST_LINE = 256  # [characters]
CLEARANCE = 2.5e-3  # [m]
MARGIN = 1e-3  # [m] that Bullet grows every convex piece of a URDF by, whatever its size
FILM = 60e-9  # [m] rounding of a mesh's vertices moves its surface by no more


@pytest.fixture(scope="module")
def assembly() -> Assembly:
    plan = AssemblyPlan(0.2, 1.0, (SidePlate(0, 0.6), SidePlate(3, 0.3)))
    return build_assembly("<kits & parts>", [sample_kit(family) for family in ("tee", "foot", "cover")], plan)


@pytest.fixture(scope="module")
def urdf(assembly: Assembly, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_urdf(assembly, tmp_path_factory.mktemp("export") / "assembly")


def read_obj(path: Path) -> Mesh:
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = [[float(x) for x in row[1:]] for row in rows if row[0] == "v"]
    return Mesh(np.array(vertices), np.array([[int(i) for i in row[1:]] for row in rows if row[0] == "f"]) - 1)


def read_pose(element: ElementTree.Element) -> Pose:
    xyz, rpy = ([float(x) for x in element.attrib[name].split()] for name in ("xyz", "rpy"))
    turns = [Pose.from_rotvec(angle * axis) for angle, axis in zip(rpy, np.eye(3), strict=True)]
    return Pose.from_translation(xyz) @ turns[2] @ turns[1] @ turns[0]


def elements(urdf: Path, path: str) -> list[ElementTree.Element]:
    return ElementTree.parse(urdf).getroot().findall(path)


def pieces(urdf: Path) -> list[Mesh]:
    """The collision meshes, in the frame of the link."""
    return [
        read_obj(urdf.parent / mesh.attrib["filename"]).moved(read_pose(collision.findall("origin")[0]))
        for collision in elements(urdf, "link/collision")
        for mesh in collision.findall("geometry/mesh")
    ]


def test_one_link_one_element_a_line(urdf: Path, assembly: Assembly) -> None:
    lines = urdf.read_text().splitlines()
    assert max(map(len, lines)) < LONGEST_LINE
    assert all(line.count("<") == 1 for line in lines)
    assert len(elements(urdf, "link")) == 1
    assert ElementTree.parse(urdf).getroot().attrib["name"] == assembly.id


def test_numbers_round_trip(urdf: Path, assembly: Assembly) -> None:
    visual = read_obj(urdf.parent / elements(urdf, "link/visual/geometry/mesh")[0].attrib["filename"])
    np.testing.assert_array_equal(visual.vertices, assembly.mesh.vertices)
    np.testing.assert_array_equal(visual.faces, assembly.mesh.faces)
    found = [read_pose(origin) for origin in elements(urdf, "link/collision/origin")]
    for mount in assembly.mounts:
        same = [pose for pose in found if np.array_equal(pose.xyz, mount.assembly_from_kit.xyz)]
        assert same
        assert all(quaternion_angle(pose.wxyz, mount.assembly_from_kit.wxyz) < 1e-12 for pose in same)


def test_every_collision_mesh_is_its_own_hull(urdf: Path) -> None:
    for piece in map(solid_from_mesh, pieces(urdf)):
        assert abs(piece.hull().volume() - piece.volume()) < 1e-6 * piece.volume()


def test_the_pieces_together_are_the_assembly(urdf: Path, assembly: Assembly) -> None:
    whole, union = solid_from_mesh(assembly.mesh), Manifold()
    for piece in map(solid_from_mesh, pieces(urdf)):
        union += piece
    assert (union - whole).volume() < FILM * whole.surface_area()
    assert union.volume() > 0.99 * whole.volume()
    assert union.volume() < sum(piece.volume for piece in pieces(urdf)) < 1.2 * whole.volume()


def test_seated_parts_intersect_no_piece(urdf: Path, assembly: Assembly) -> None:
    solids = [solid_from_mesh(piece) for piece in pieces(urdf)]
    for mount in assembly.mounts:
        pose = mount.assembly_from_kit @ mount.kit.slot.kit_from_part
        part = solid_from_mesh(sample_part(mount.kit.id).mesh.moved(pose))
        assert sum((part ^ solid).volume() for solid in solids) < FILM * part.surface_area()


def test_mass_and_inertia_are_those_of_the_solid(urdf: Path, assembly: Assembly) -> None:
    mass = float(elements(urdf, "link/inertial/mass")[0].attrib["value"])
    written = elements(urdf, "link/inertial/inertia")[0].attrib
    tensor = np.array([[float(written["i" + "".join(sorted(a + b))]) for a in "xyz"] for b in "xyz"])
    centre = read_pose(elements(urdf, "link/inertial/origin")[0]).xyz
    assert mass == DENSITY * assembly.mesh.volume
    np.testing.assert_array_equal(centre, assembly.mesh.centroid)
    np.testing.assert_allclose(tensor, inertia(assembly.mesh, mass), rtol=1e-12)


@given(poses())
def test_roll_pitch_yaw_give_the_same_rotation(pose: Pose) -> None:
    roll, pitch, yaw = roll_pitch_yaw(pose)
    x, y, z = (Pose.from_rotvec(a * axis) for a, axis in zip((roll, pitch, yaw), np.eye(3), strict=True))
    assert quaternion_angle((z @ y @ x).wxyz, pose.wxyz) < 1e-7


def dropped(urdf: Path, start: Pose, halves: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """The rest position (3,) [m] in Bullet of a box with some half extents, released 35 mm above a pose."""
    client = bullet.connect(bullet.DIRECT)
    try:
        bullet.setGravity(0, 0, -9.81 * scale, physicsClientId=client)
        bullet.loadURDF(str(urdf), useFixedBase=True, globalScaling=scale, physicsClientId=client)
        shape = bullet.createCollisionShape(
            bullet.GEOM_BOX, halfExtents=(halves * scale).tolist(), physicsClientId=client
        )
        place = ((start.xyz + [0, 0, 0.035]) * scale).tolist()
        box = bullet.createMultiBody(
            0.05, shape, basePosition=place, baseOrientation=start.wxyz[[1, 2, 3, 0]].tolist(), physicsClientId=client
        )
        for _ in range(480):
            bullet.stepSimulation(physicsClientId=client)
        return np.array(bullet.getBasePositionAndOrientation(box, physicsClientId=client)[0]) / scale
    finally:
        bullet.disconnect(client)


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Pose, np.ndarray, float]:
    """A level kit for a block as URDF; the seated pose, the block's half extents and the depth of its cavity."""
    part = as_part(Manifold.cube((40, 30, 28), center=True), Symmetry.dihedral(2))  # lies on its largest face
    kit = make_kit(part, clearance=CLEARANCE)
    assembly = build_assembly("block", [kit], AssemblyPlan(0.0, 0.0, ()))
    urdf = write_urdf(assembly, tmp_path_factory.mktemp("block") / "assembly")
    seated = assembly.mounts[0].assembly_from_kit @ kit.slot.kit_from_part
    return urdf, seated, part.mesh.extents / 2, kit.slot.depth


@pytest.mark.parametrize("gap", [CLEARANCE, 1.5e-3])
def test_a_peg_drops_into_the_cavity_in_bullet(block: tuple[Path, Pose, np.ndarray, float], gap: float) -> None:
    urdf, seated, halves, _ = block
    rest = dropped(urdf, seated, halves + [CLEARANCE - gap, CLEARANCE - gap, 0])
    assert rest[2] - seated.xyz[2] == pytest.approx(MARGIN, abs=2e-4)  # on the floor, but for the margin
    assert np.abs(rest - seated.xyz)[:2].max() < gap


def test_a_peg_wider_than_the_cavity_stays_on_the_rim(block: tuple[Path, Pose, np.ndarray, float]) -> None:
    urdf, seated, halves, depth = block
    rest = dropped(urdf, seated, halves + [CLEARANCE + 1e-3, CLEARANCE + 1e-3, 0])
    assert rest[2] - seated.xyz[2] == pytest.approx(depth + MARGIN, abs=2e-4)


def test_the_margin_is_bullets_own_and_shrinks_with_the_scale(block: tuple[Path, Pose, np.ndarray, float]) -> None:
    urdf, seated, halves, depth = block
    tight = halves + [CLEARANCE - 1e-3, CLEARANCE - 1e-3, 0]  # a gap no wider than the margin
    assert dropped(urdf, seated, tight)[2] - seated.xyz[2] > depth / 3  # it jams
    assert dropped(urdf, seated, tight, scale=10)[2] - seated.xyz[2] == pytest.approx(MARGIN / 10, abs=1e-4)


@pytest.fixture(scope="module")
def recorded(mini: Path) -> RecordedScene:
    return next(iter(Dataset(mini).split("test-all", truth=True)))


@pytest.fixture(scope="module")
def scene(mini: Path, recorded: RecordedScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mjcf")
    export(mini, "mjcf", out, [recorded.id])
    return out / recorded.id / "scene.xml"


def floats(text: str) -> np.ndarray:
    return np.array([float(word) for word in text.split()])


def pose_of(element: ElementTree.Element) -> Pose:
    return Pose(floats(element.attrib["quat"]), floats(element.attrib["pos"]))


def test_bodies_stand_where_they_do(scene: Path, recorded: RecordedScene) -> None:
    bodies = ElementTree.parse(scene).getroot().findall("worldbody/body")
    assert [body.attrib["name"] for body in bodies] == [
        "assembly",
        *(f"p{i}" for i in range(len(recorded.scene.bodies) - 1)),
    ]
    for body, true in zip(bodies, recorded.scene.bodies, strict=True):
        np.testing.assert_array_equal(pose_of(body).matrix(), true.world_from_body.matrix())
    assert [body.find("freejoint") is not None for body in bodies] == [False] + [True] * (len(bodies) - 1)


def test_masses_and_friction_are_ours(scene: Path, recorded: RecordedScene) -> None:
    root, geometry = ElementTree.parse(scene).getroot(), recorded.split.dataset.geometry
    masses = [float(each.attrib["mass"]) for each in root.findall("worldbody/body/inertial")]
    assert masses[1:] == [geometry.part(body.id).mass for body in recorded.scene.bodies[1:]]
    friction = {each.attrib["friction"] for each in root.iter("geom") if "friction" in each.attrib}
    assert {floats(text)[0] for text in friction} == {FRICTION**2}


def test_every_goal_is_a_site(scene: Path, recorded: RecordedScene) -> None:
    assembly = recorded.split.dataset.geometry.assembly(recorded.scene.bodies[0].id)
    sites = [pose_of(site).matrix() for site in ElementTree.parse(scene).getroot().findall("worldbody/body/site")]
    goals = [mount.assembly_from_kit @ goal for mount in assembly.mounts for goal in mount.kit.slot.goals]
    np.testing.assert_allclose(sites, [goal.matrix() for goal in goals], atol=1e-12)


def test_mujoco_sees_the_scene_and_leaves_it_at_rest(scene: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    before = data.qpos.copy()
    mujoco.mj_step(model, data, nstep=300)
    assert np.abs(data.qpos - before).max() < 1e-3


def test_an_unknown_scene_and_an_existing_folder_are_refused(mini: Path, scene: Path) -> None:
    with pytest.raises(InputError, match="test-s9999"):
        export(mini, "mjcf", scene.parents[1], ["test-s9999"])
    with pytest.raises(InputError, match="exists already"):
        export(mini, "mjcf", scene.parents[1], [scene.parent.name])


@pytest.fixture(scope="module")
def shapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset shapes of an assembly of two kits; it is exported to the shapes `stl` beside it."""
    shapes = tmp_path_factory.mktemp("export") / "data"
    shapes_folder(shapes)
    assert export(shapes, "stl", shapes.parent / "stl") == shapes.parent / "stl"
    return shapes


@pytest.fixture(scope="module")
def tables_of(shapes: Path) -> Geometry:
    return Geometry(shapes)


def meshes(tables_of: Geometry) -> dict[str, Mesh]:
    """What is exported, by the name of the file without its ending."""
    parts = {f"part-{i}": standing_mesh(tables_of.part(i), tables_of.kit(i)) for i in tables_of.parts}
    return parts | {i: tables_of.assembly(i).mesh for i in tables_of.assemblies}


def test_files_read_back_are_the_assemblies_and_parts_in_millimetres(tables_of: Geometry) -> None:
    expected = meshes(tables_of)
    paths = {path.stem: path for path in (tables_of.root.parent / "stl").iterdir()}
    assert paths.keys() == expected.keys()
    for name, mesh in expected.items():
        seen = trimesh.load_scene(paths[name]).to_mesh()
        assert seen.is_watertight
        assert seen.volume == pytest.approx(mesh.volume * 1e9, rel=1e-6)
        np.testing.assert_allclose(seen.bounds, mesh.bounds * 1e3, atol=1e-4)
        assert seen.bounds[0, 2] == pytest.approx(0, abs=1e-4)  # it stands, z up
        reading = read_mesh(paths[name], "mm")
        assert (reading.unit, reading.unit_guessed) == ("mm", False)
        np.testing.assert_allclose(reading.mesh.extents, mesh.extents, atol=1e-7)


def test_parts_seat_in_the_assembly_read_back(tables_of: Geometry) -> None:
    (assembly_id,) = tables_of.assemblies
    assembly = tables_of.assembly(assembly_id)
    seen = trimesh.load_scene(tables_of.root.parent / "stl" / f"{assembly_id}.stl").to_mesh()
    solid = solid_from_mesh(Mesh(seen.vertices, seen.faces))
    for mount in assembly.mounts:
        up = mount.assembly_from_kit.rotate([0.0, 0.0, 1.0])
        seated = mount.assembly_from_kit @ mount.kit.slot.kit_from_part
        part = solid_from_mesh(tables_of.part(mount.kit.id).mesh.moved(seated).scaled(1e3))
        assert part.translate(tuple(up)).min_gap(solid, 5) == pytest.approx(1, abs=0.01)  # a millimetre off its floor


@pytest.mark.parametrize("format", ["urdf", "stl"])
def test_the_given_ids_or_those_of_a_split_are_exported(format: str, shapes: Path, tmp_path: Path) -> None:
    (assembly_id,) = Geometry(shapes).assemblies
    name = assembly_id if format == "urdf" else f"{assembly_id}.stl"
    for options in ({"ids": (assembly_id,)}, {"split": "test"}):
        out = export(shapes, format, tmp_path / "_".join(options), **options)  # type: ignore[arg-type]
        assert name in {path.name for path in out.iterdir()}


def test_an_unknown_format_or_split_is_one_line(shapes: Path, tmp_path: Path) -> None:
    for format, split, fact in (("step", None, ", ".join(FORMATS)), ("stl", "val", "val")):
        with pytest.raises(InputError, match=fact):
            export(shapes, format, tmp_path, split=split)
