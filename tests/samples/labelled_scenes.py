"""One scene of two kits on a bracket and two parts beside them, as a noisy camera sees it, with its truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.dataset.json_rows import FORMAT, assembly_row, kit_row, part_row
from kit1000.dataset.mesh_files import glb_bytes
from kit1000.files import write_bytes, write_json
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.known_shapes.known_kits import KITS, KnownKits
from kit1000.known_shapes.registration import Agreement
from kit1000.labelling.label_records import LabelledBody, LabelRecord
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.cameras import CAMERA
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.sim.sensors import DEPTH_GRID
from kit1000.values import LabelledDepth, Part, View
from tests.samples.forgotten_truth import SENSOR, write_forgotten
from tests.samples.kits import sample_kit, sample_part

SMALL: Camera = CAMERA.scaled(0.6)
FAMILIES = ("bracket", "tee")
CLEARANCE = 2.5e-3
NOISE = 0.8e-3  # [m] of a depth, the same over a few pixels
SCENE = "test-s0000"


@dataclass(frozen=True, eq=False)
class SampleScene:
    """A scene and what is true in it."""

    image: LabelledDepth
    kits: KnownKits
    world_from_assembly: Pose
    world_from_parts: tuple[Pose, ...]
    """Of the parts as `kits` has them; they are p0, p1, ... in the masks."""

    @property
    def camera_from_world(self) -> Pose:
        return self.image.view.world_from_camera.inverse()


@cache
def sample_kits(families: tuple[str, str] = FAMILIES) -> KnownKits:
    plan = AssemblyPlan(0.0, 0.0, (SidePlate(0, float(np.radians(20))),))
    assembly = build_assembly(families[0], [sample_kit(family) for family in families], plan)
    source = {"shapes": "none", "assembly": families[0]}
    return KnownKits(assembly, tuple(sample_part(family) for family in families), source)


def standing(part: Part, turn: float, place: tuple[float, float]) -> Pose:
    """world_from_part of a part on its insertion face, turned by an angle [rad], at a place [m] of the table."""
    rotation = Pose.from_rotvec((0.0, 0.0, turn)) @ Pose(sample_kit(part.id).slot.kit_from_part.wxyz, np.zeros(3))
    return Pose(rotation.wxyz, np.array([*place, -rotation.apply(part.mesh.vertices)[:, 2].min()]))


@cache
def sample_scene(noise: float = NOISE, scale: float = 1.0, seed: int = 0) -> SampleScene:
    kits = sample_kits()
    assembly_pose = Pose.from_rotvec((0.0, 0.0, 0.7), (0.02, 0.16, 0.0))
    places = ((-0.09, -0.08), (0.08, -0.1))
    poses = tuple(
        standing(part, 1.0 + i, place) for i, (part, place) in enumerate(zip(kits.parts, places, strict=True))
    )
    camera_pose = look_at((0.15, -0.35, 0.6), (0.0, 0.04, 0.0))
    bodies: list[tuple[Mesh, Pose]] = [(table(), Pose.identity()), (kits.assembly.mesh, assembly_pose)]
    bodies += [(part.mesh, pose) for part, pose in zip(kits.parts, poses, strict=True)]
    frame = render(SMALL, camera_pose, bodies, threads=1)
    depth = scale * _noisy(frame.depth, noise, seed)
    depth = (np.rint(depth / DEPTH_GRID) * DEPTH_GRID).astype(np.float32)
    labels = np.maximum(frame.body_ids - 1, 0).astype(np.uint8)
    return SampleScene(LabelledDepth(View(SMALL, camera_pose, depth), labels), kits, assembly_pose, poses)


def _noisy(depth: np.ndarray, noise: float, seed: int) -> np.ndarray:
    """Depths with noise that is the same over 3 x 3 pixels."""
    coarse = np.random.default_rng(seed).normal(0, noise, (depth.shape[0] // 3 + 1, depth.shape[1] // 3 + 1))
    field = np.kron(coarse, np.ones((3, 3)))[: depth.shape[0], : depth.shape[1]]
    return np.where(depth > 0, depth + field, 0.0)


def own_folder(folder: Path, scene: SampleScene | None = None) -> Path:
    """A folder of own scenes with that scene."""
    return write_forgotten(folder, {SCENE: (scene or sample_scene()).image}, CLEARANCE)


def true_record(scene: SampleScene, source: dict[str, str], person: str | None = None) -> LabelRecord:
    """The record of a scene with its true poses; person: who confirmed all bodies."""
    fit = Agreement(unexplained=0.01, lead=400.0, depth=5e-4)
    poses = {KITS: scene.world_from_assembly}
    poses |= {part.id: pose for part, pose in zip(scene.kits.parts, scene.world_from_parts, strict=True)}
    bodies = (
        LabelledBody(name, label, scene.camera_from_world @ pose, fit, (), confirmed_by=person)
        for label, (name, pose) in enumerate(poses.items(), start=1)
    )
    return LabelRecord(SCENE, SENSOR, dict(source), 1.0, 1e-4, tuple(bodies))


def shapes_folder(folder: Path, families: tuple[str, str] = FAMILIES) -> dict[str, str]:
    """The shapes of a scene as a folder of tables and meshes; returns them as the source of a record."""
    kits = sample_kits(families)
    rows = {kit.kit.id: kit_row(kit.kit) | {"split": "test"} for kit in kits.assembly.mounts}
    parts = {part.id: part_row(part) | {"split": "test"} for part in kits.parts}
    assemblies = {kits.assembly.id: assembly_row(kits.assembly) | {"split": "test"}}
    for name, table_rows in (("kits", rows), ("parts", parts), ("assemblies", assemblies)):
        write_json(folder / f"{name}.json", table_rows)
    for kind, meshes in (
        ("kits", {mount.kit.id: mount.kit.mesh for mount in kits.assembly.mounts}),
        ("parts", {part.id: part.mesh for part in kits.parts}),
        ("assemblies", {kits.assembly.id: kits.assembly.mesh}),
    ):
        for name, mesh in meshes.items():
            write_bytes(folder / kind / f"{name}.glb", glb_bytes({name: mesh}))
    write_json(
        folder / "dataset.json", {"format": FORMAT, "dataset_id": "shapes", "data_version": "1.0.0", "config": {}}
    )
    return {"shapes": str(folder), "assembly": kits.assembly.id}
