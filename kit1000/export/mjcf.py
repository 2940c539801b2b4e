"""Export of scenes as MJCF, which MuJoCo loads as it is: a folder with `scene.xml` and the visual meshes for each.

The table is a plane, the kits are fixed, parts are free bodies at their poses. Collision geometry is convex pieces,
written into the file as points whose hull MuJoCo takes; the file begins with what they measure. The camera is the
scene's, with its intrinsics; sites are at the goals. Metres, kilograms, seconds; quaternions are wxyz, as in MuJoCo.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from kit1000.export.bop import chosen_scenes
from kit1000.export.urdf import numbers, obj_text
from kit1000.files import new_folder
from kit1000.kits.brackets import support_meshes
from kit1000.kits.collision_pieces import clearance_left, kit_pieces, missing_and_extra, part_pieces
from kit1000.mesh import Mesh, inertia
from kit1000.parts.family import DENSITY
from kit1000.pose import Pose
from kit1000.sim.layout import TABLE_SIZE
from kit1000.sim.settle import ROLLING_FRICTION, SPINNING_FRICTION
from kit1000.sim.world import FRICTION, MARGIN
from kit1000.values import Assembly, View

if TYPE_CHECKING:
    from kit1000.dataset.reader import Dataset, RecordedScene

SCENE = "scene.xml"
DEVIATION = 0.1  # of a part's pieces, as a share of its clearance
# pybullet multiplies the coefficients of two bodies, MuJoCo takes the larger one
CONTACT_FRICTION = np.array([FRICTION, SPINNING_FRICTION, ROLLING_FRICTION]) * FRICTION
FLIPPED = Pose(np.array([0.0, 1.0, 0.0, 0.0]), np.zeros(3))  # MuJoCo's cameras look along -z, y is up
PIXEL = 1e-5  # [m] of the camera's sensor: MuJoCo asks for its size, and only the ratio to the focal length matters
TIME_STEP = 1e-3  # [s]
CONTACT_TIME = 4e-3  # [s] time constant of a contact: parts of a few grams sink in by some micrometres


@dataclass(frozen=True, eq=False)
class Shape:
    """A body's true mesh and convex pieces, and what the pieces miss and add [m^3]."""

    mesh: Mesh
    pieces: list[Mesh]
    missing: float
    extra: float

    @staticmethod
    def of(mesh: Mesh, pieces: list[Mesh]) -> Shape:
        """A shape, measured."""
        return Shape(mesh, pieces, *missing_and_extra(mesh, pieces))


@dataclass(frozen=True)
class Fit:
    """A part's and a kit's pieces."""

    part: Shape
    kit: Shape
    clearance: float  # [m] left between the pieces


class Shapes:
    """The pieces of parts and kits of a dataset by part id; those of the last ones are kept."""

    def __init__(self, dataset: Dataset) -> None:
        self.geometry = dataset.geometry
        self.fit = lru_cache(1024)(self._fit)

    def _fit(self, part_id: str) -> Fit:
        part, kit = self.geometry.part(part_id), self.geometry.kit(part_id)
        pieces, walls = part_pieces(part.mesh, DEVIATION * kit.slot.clearance), kit_pieces(kit)
        return Fit(Shape.of(part.mesh, pieces), Shape.of(kit.mesh, walls), clearance_left(kit.slot, pieces, walls))


def write_mjcf(dataset: Dataset, out: Path, ids: Sequence[str] = (), split: str | None = None) -> Path:
    """Write a folder for each scene, which appears when it is complete; returns `out`.

    Args:
        dataset: the dataset; its truth is read.
        out: gets a new folder a scene.
        ids: ids of the scenes; all of the split when empty.
        split: train, val or test; all three when None.

    Raises:
        InputError: no such split or scene, the truth is withheld, or a folder exists or cannot be written.
    """
    shapes = Shapes(dataset)
    chosen = [(name, scene) for name, scenes in chosen_scenes(dataset, ids, split).items() for _, scene in scenes]
    for name, scene in tqdm(chosen, desc="scenes", unit="", disable=None):
        with new_folder(out / scene, "MJCF scene") as folder:
            write_scene(dataset.split("test-all" if name == "test" else name, truth=True).scene(scene), shapes, folder)
    return out


def write_scene(recorded: RecordedScene, shapes: Shapes, folder: Path) -> None:
    """Write `scene.xml` and the visual meshes of one scene into a folder."""
    geometry = shapes.geometry
    placed_assembly, *placed_parts = recorded.scene.bodies
    assembly, parts = geometry.assembly(placed_assembly.id), [geometry.part(body.id) for body in placed_parts]
    numbers_of_parts = {part.id: i for i, part in enumerate(parts)}
    root = _scene_frame(recorded.id, recorded.view("ideal"))
    asset, world = root.find("asset"), root.find("worldbody")
    assert asset is not None
    assert world is not None

    def add_body(name: str, pose: Pose, mesh: Mesh, mass: float, pieces: Sequence[Mesh]) -> ElementTree.Element:
        body = _add(world, "body", name=name, **_placed(pose))
        _add_inertia(body, mesh, mass)
        (folder / f"{name}.obj").write_text(obj_text(mesh), encoding="ascii")
        _add(asset, "mesh", name=name, file=f"{name}.obj")
        _add(body, "geom", {"class": "visual"}, mesh=name)
        for i, piece in enumerate(pieces):
            _add(asset, "mesh", name=f"{name}-{i}", vertex=numbers(piece.vertices.ravel()))
            _add(body, "geom", {"class": "collision"}, mesh=f"{name}-{i}")
        return body

    fits = {mount.kit.slot.part_id: shapes.fit(mount.kit.slot.part_id) for mount in assembly.mounts}
    pieces = assembly_pieces(assembly, {part_id: fit.kit.pieces for part_id, fit in fits.items()})
    mass = DENSITY * assembly.mesh.volume
    fixed = add_body("assembly", placed_assembly.world_from_body, assembly.mesh, mass, pieces)
    for mount in assembly.mounts:
        slot, number = mount.kit.slot, numbers_of_parts.get(mount.kit.slot.part_id)
        owner = mount.kit.id if number is None else f"p{number}"
        for j, goal in enumerate(slot.goals):
            _add(fixed, "site", name=f"{owner}-goal{j}", **_placed(mount.assembly_from_kit @ goal))
    for i, (body, part) in enumerate(zip(placed_parts, parts, strict=True)):
        fit = shapes.fit(part.id)
        free = add_body(f"p{i}", body.world_from_body, part.mesh, part.mass, fit.part.pieces)
        free.insert(0, ElementTree.Element("freejoint"))
    root.insert(0, ElementTree.Comment(_measured(fits, len(pieces))))
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(folder / SCENE, encoding="utf-8", xml_declaration=True)


def assembly_pieces(assembly: Assembly, pieces: dict[str, list[Mesh]]) -> list[Mesh]:
    """All convex pieces of an assembly in its frame. pieces: of its kits, by part id."""
    walls = [
        piece.moved(mount.assembly_from_kit) for mount in assembly.mounts for piece in pieces[mount.kit.slot.part_id]
    ]
    return walls + support_meshes(assembly.mounts)


def _scene_frame(name: str, view: View) -> ElementTree.Element:
    """The MJCF of a scene without bodies: options, defaults, table, light and camera."""
    root = ElementTree.Element("mujoco", model=name)
    _add(root, "compiler", angle="radian")
    option = _add(root, "option", timestep=TIME_STEP, cone="elliptic", integrator="implicitfast")
    _add(option, "flag", multiccd="enable")
    camera = view.camera
    visual = _add(root, "visual")
    _add(visual, "global", offwidth=camera.width, offheight=camera.height)
    _add(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.5 0.5 0.5", specular="0 0 0")
    _add(root, "statistic", center="0 0 0", extent=1)
    default = _add(root, "default")
    visible = _add(default, "default", {"class": "visual"})
    _add(visible, "geom", type="mesh", group=2, contype=0, conaffinity=0, mass=0, rgba="0.75 0.77 0.8 1")
    touching = _add(default, "default", {"class": "collision"})
    friction = {"friction": numbers(CONTACT_FRICTION), "condim": 6, "solref": f"{CONTACT_TIME} 1", "margin": MARGIN}
    _add(touching, "geom", type="mesh", group=3, mass=0, rgba="0.9 0.45 0.2 0.5", **friction)
    _add(default, "site", size="0.003", group=4, rgba="0.2 0.6 0.3 1")
    _add(root, "asset")
    world = _add(root, "worldbody")
    _add(world, "light", pos="0 0 1.5", dir="0.2 0.1 -1", diffuse="0.5 0.5 0.5", specular="0 0 0")
    half = numbers(np.array(TABLE_SIZE) / (2, 2, 1))
    _add(world, "geom", name="table", type="plane", size=half, rgba="0.45 0.5 0.55 1", **friction)
    pixels = np.array([camera.width, camera.height])
    intrinsics = {
        "resolution": f"{camera.width} {camera.height}",
        "sensorsize": numbers(pixels * PIXEL),
        "focalpixel": f"{camera.fx!r} {camera.fy!r}",
        "principalpixel": numbers((pixels - 1) / 2 - np.array([camera.cx, camera.cy])),
    }
    _add(world, "camera", name="camera", **_placed(view.world_from_camera @ FLIPPED), **intrinsics)
    return root


def _add_inertia(body: ElementTree.Element, mesh: Mesh, mass: float) -> None:
    tensor = inertia(mesh, mass)
    entries = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    _add(body, "inertial", pos=numbers(mesh.centroid), mass=mass, fullinertia=numbers(entries))


def _measured(fits: dict[str, Fit], pieces: int) -> str:
    """The comment of a scene: what its pieces measure."""
    lines = [
        "KIT1000: convex pieces beside the true solids, measured by booleans.",
        f"assembly: {pieces} pieces",
        *(
            f"{part_id}: part {_shape_text(fit.part)}; kit {_shape_text(fit.kit)}; "
            f"clearance left {1e3 * fit.clearance:.2f} mm"
            for part_id, fit in fits.items()
        ),
    ]
    return "\n".join(["", *lines, ""])


def _shape_text(shape: Shape) -> str:
    share = 100 / shape.mesh.volume
    return f"{len(shape.pieces)} pieces, {share * shape.missing:.2f} % missing, {share * shape.extra:.2f} % extra"


def _placed(pose: Pose) -> dict[str, str]:
    return {"pos": numbers(pose.xyz), "quat": numbers(pose.wxyz)}


def _add(
    parent: ElementTree.Element, tag: str, named: dict[str, str] | None = None, /, **attributes: str | float
) -> ElementTree.Element:
    """A new child. named: attributes whose names are words of Python."""
    return ElementTree.SubElement(parent, tag, (named or {}) | {name: str(each) for name, each in attributes.items()})
