"""One scene of two kits on a bracket and two parts beside them, as a noisy camera sees it, with its truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from bench.quality.forgotten_truth import write_forgotten
from kit1000.camera import Camera, look_at
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.labelling.known_kits import KnownKits
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.cameras import CAMERA
from kit1000.sim.layout import table
from kit1000.sim.render import render
from kit1000.sim.sensors import DEPTH_GRID
from kit1000.values import LabelledDepth, Part, View
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
def sample_kits() -> KnownKits:
    plan = AssemblyPlan(0.0, 0.0, (SidePlate(0, float(np.radians(20))),))
    assembly = build_assembly("bracket", [sample_kit(family) for family in FAMILIES], plan)
    return KnownKits(
        assembly, tuple(sample_part(family) for family in FAMILIES), {"shapes": "none", "assembly": "bracket"}
    )


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
