"""Completers that know the part or the plate, for tests of what is made of their answers, and that plate."""

from __future__ import annotations

import numpy as np
import trimesh

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh
from kit1000.perception.completion.kits import KitCompleter
from kit1000.perception.completion.parts import FillLogits, FramedPart, PartCompleter
from kit1000.perception.observed.kits import CompletedHeights, SeenHeights, true_depths
from kit1000.perception.observed.occupancy import filled_share
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View

CAMERA = Camera(width=400, height=300, fx=500.0, fy=500.0, cx=199.5, cy=149.5)
EYE = look_at((0.4, 0.1, 0.45), (0, 0, 0))
DEEP, WIDE = 12e-3, 30e-3  # [m] of the cavity


class Oracle(PartCompleter):
    """Knows the part that stands at the origin."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh

    def __call__(self, part: FramedPart) -> FillLogits:
        """The true share of each cell, as a logit."""
        share = filled_share(self.mesh, Pose.identity(), part.grid)
        return FillLogits(part.grid, (20 * (share - 0.5)).astype(np.float32))


def tray() -> Mesh:
    """A plate with a square cavity, its face at z = 0."""
    plate = trimesh.creation.box((0.099, 0.099, 0.022)).apply_translation((0, 0, -0.011))
    body = trimesh.boolean.difference([plate, trimesh.creation.box((WIDE, WIDE, 2 * DEEP))], engine="manifold")
    return Mesh(body.vertices, body.faces)


def plate_image(moved: Pose) -> LabelledDepth:
    """The plate seen by the camera, the whole scene moved in the world."""
    bodies = [(Mesh(*_table()), moved), (tray(), moved)]
    image = render(CAMERA, moved @ EYE, bodies, 1)
    labels = np.where(image.body_ids == 2, ASSEMBLY_LABEL, 0).astype(np.uint8)
    return LabelledDepth(View(CAMERA, moved @ EYE, image.depth), labels)


def _table() -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box((2, 2, 0.1)).apply_translation((0, 0, -0.2))
    return np.array(box.vertices), np.array(box.faces)


class KnownPlate(KitCompleter):
    """Knows the plate."""

    def __init__(self, world_from_kit: Pose) -> None:
        self.world_from_kit = world_from_kit

    def __call__(self, relief: SeenHeights) -> CompletedHeights:
        """The true depths, in hidden and seen cells alike."""
        return CompletedHeights(relief, true_depths(tray(), self.world_from_kit, relief.world_from_plate))
