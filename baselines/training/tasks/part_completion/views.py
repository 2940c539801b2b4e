"""Training examples of a completion network: fresh views of fresh parts at rest on the table, some among neighbours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baselines.training.tasks.noisy_images import noisy_view
from baselines.training.tasks.part_completion.sampled_parts import DrawnPart, DrawnParts
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.perception.completion.parts import SHAPE, FramedPart, framed, grid_at, packed, pixel_box
from kit1000.perception.observed.occupancy import filled_share
from kit1000.pose import Pose, quaternion_between
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.footprints import footprint
from kit1000.sim.layout import DROP_BOUNDS, UPRIGHT_SHARE, table
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View

NEIGHBOURED_SHARE = 0.2  # of the examples: with neighbours that may hide some of the part
MOST_NEIGHBOURS = 3
GAP = 10e-3  # [m] the largest to a neighbour
LEAST_PIXELS = 150  # of the part
BORDER = 24  # [px] around what is needed: the sensor's noise and fattened edges reach so far
OVERLAP = 96  # [px] more to the left: there the d415's second imager sees nothing, up to its disparity at 0.53 m
MAX_DRAWS = 50  # views of an example
DOWN = np.array([0.0, 0.0, -1.0])

Example = dict[str, np.ndarray]
Body = tuple[Mesh, Pose]


@dataclass(frozen=True)
class DrawnViews:
    """Examples from fresh parts; nothing but the generator decides which."""

    parts: DrawnParts
    d415_share: float
    """Share of the examples that the d415 measures."""

    def example(self, rng: np.random.Generator) -> Example:
        """Evidence and truth of a view, see `example_of`."""
        noisy, neighboured = rng.random() < self.d415_share, rng.random() < NEIGHBOURED_SHARE
        for _ in range(MAX_DRAWS):
            bodies = self._bodies(rng, int(rng.integers(1, MOST_NEIGHBOURS + 1)) if neighboured else 0)
            image = _image(bodies, draw_primary_pose(rng, neighboured), rng if noisy else None)
            if np.count_nonzero(image.labels == FIRST_PART_LABEL) >= LEAST_PIXELS:
                part = framed(image, FIRST_PART_LABEL, flat=noisy)
                if part is not None:
                    return example_of(part, *bodies[0], mirrored=bool(rng.integers(2)))
        raise InputError(f"none of {MAX_DRAWS} views shows {LEAST_PIXELS} pixels of its part")

    def _bodies(self, rng: np.random.Generator, neighbours: int) -> list[Body]:
        """A part at rest somewhere on the table, and its neighbours, none of which touches it."""
        first = self._at_rest(rng)
        there = Pose.from_translation((*rng.uniform(*DROP_BOUNDS), 0.0))
        bodies = [(first[0], there @ first[1])]
        outline = footprint(*bodies[0])
        for direction in rng.uniform(0, 2 * np.pi) + rng.permutation(4)[:neighbours] * (np.pi / 2):
            mesh, pose = self._at_rest(rng)
            bodies.append((mesh, beside(outline, mesh, pose, float(direction), float(rng.uniform(0, GAP)))))
        return bodies

    def _at_rest(self, rng: np.random.Generator) -> Body:
        """Some part at rest, about the origin, at any yaw."""
        part = self.parts[int(rng.integers(len(self.parts)))]
        upright, face, yaw = rng.random() < UPRIGHT_SHARE / 2, rng.random(), rng.uniform(0, 2 * np.pi)
        likely = int(np.searchsorted(part.probability.cumsum(), face, side="right"))
        return part.mesh, resting_pose(part, 0 if upright else min(likely, len(part.down) - 1), float(yaw))


def resting_pose(part: DrawnPart, face: int, yaw: float) -> Pose:
    """world_from_part of a part on one of its faces, at a yaw [rad], above the origin of the table."""
    level = Pose(quaternion_between(part.down[face], DOWN), np.zeros(3))
    rotated = Pose.from_rotvec((0.0, 0.0, yaw)) @ level
    points = rotated.apply(part.mesh.vertices)
    low, high = points.min(0), points.max(0)
    return Pose(rotated.wxyz, np.array([*-(low + high)[:2] / 2, -low[2]]))


def beside(outline: np.ndarray, mesh: Mesh, pose: Pose, direction: float, gap: float) -> Pose:
    """The pose of a neighbour, moved along a direction [rad] until it is a gap [m] beyond an outline (n, 2) [m]."""
    axis = np.array([np.cos(direction), np.sin(direction)])
    centre = (outline.min(0) + outline.max(0)) / 2
    reach = (outline * axis).sum(1).max() - (footprint(mesh, pose) * axis).sum(1).min() + gap
    across = centre - (centre * axis).sum() * axis
    return Pose(pose.wxyz, pose.xyz + (*(across + reach * axis), 0.0))


def example_of(part: FramedPart, mesh: Mesh, world_from_part: Pose, mirrored: bool = False) -> Example:
    """`codes` int8 and `camera` (2,) float32 of the evidence, `solid` uint8: 255 times the filled share; packed."""
    solid = np.rint(255 * filled_share(mesh, world_from_part, part.grid)).astype(np.uint8)
    sides = slice(None, None, -1 if mirrored else None)
    return {"codes": packed(part.codes[:, sides]), "camera": part.camera, "solid": packed(solid[:, sides])}


def _image(bodies: list[Body], world_from_camera: Pose, noise: np.random.Generator | None) -> LabelledDepth:
    """The depth image of bodies on the table, as much of it as the first one needs.

    noise: of the calibrated d415; None for ideal depth.
    """
    pose = bodies[0][1]
    around = grid_at(float(pose.xyz[0]), float(pose.xyz[1]), 0.0)
    wide = replace(around, shape=(SHAPE[0] + 40, SHAPE[1] + 40, SHAPE[2])).moved(
        Pose.from_translation((-20 * around.voxel_size, -20 * around.voxel_size, 0.0))
    )
    rows, columns = pixel_box(wide, CAMERA, world_from_camera, BORDER)
    columns = slice(columns.start - (0 if noise is None else OVERLAP), columns.stop)
    size = columns.stop - columns.start, rows.stop - rows.start
    camera = replace(CAMERA, width=size[0], height=size[1], cx=CAMERA.cx - columns.start, cy=CAMERA.cy - rows.start)
    frame = render(camera, world_from_camera, [(table(), Pose.identity()), *bodies], threads=1)
    labels = np.where(frame.body_ids > 1, frame.body_ids - 2 + FIRST_PART_LABEL, 0).astype(np.uint8)
    view = View(camera, world_from_camera, frame.depth)
    return LabelledDepth(view if noise is None else noisy_view(view, noise), labels)
