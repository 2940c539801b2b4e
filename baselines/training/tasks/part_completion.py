"""The training task of part completion: new views of newly sampled parts at rest, some of them among neighbours.

Part i of a seed is the same whoever makes it, so shards are only a cache: a run that finds none makes its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from joblib import Memory
from torch import Tensor

from baselines.training.tasks.noisy_images import noisy_view
from baselines.training.validation import RecordedTask, drawn_targets
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, MeshRefused, Redraw
from kit1000.files import user_cache
from kit1000.generation.plan import family_weights
from kit1000.generation.presets import PRESETS
from kit1000.kits.face import resting_faces
from kit1000.mesh import Mesh, defect_float32, mesh_from_solid, solid_from_mesh
from kit1000.numerics.linear_algebra import length
from kit1000.parts.family import make_part, part_of_mesh
from kit1000.parts.family_catalog import FAMILIES
from kit1000.parts.mixtures import choose_family
from kit1000.perception.completion.parts import (
    CODE,
    SHAPE,
    CompletionNet,
    FramedPart,
    completion_loss,
    framed,
    grid_at,
    packed,
    pixel_box,
    scale_of,
)
from kit1000.perception.networks.unet import UNetConfig
from kit1000.perception.observed.occupancy import filled_share
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose, quaternion_between
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.footprints import footprint
from kit1000.sim.layout import DROP_BOUNDS, UPRIGHT_SHARE, table
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View
from kit1000.voxels import Grid

PRESET = PRESETS["kit1000"]
PARTS_SHOWN = 20_000  # newly sampled parts that the examples show
PARTS = {"small": (2027, 0.0), "pretraining": (2026, 0.35), "measured": (2051, 0.35)}
"""Seed of the parts, and share of the examples that the d415 measures, by preset. `small` starts from the weights of
`pretraining`, `measured` of noisy parts from those of `small`."""
SHARD = 100  # parts of a file
STRETCHED = 0.25  # share of parts whose axes are scaled apart, by up to STRETCH
STRETCH = 1.5
JOINED = 0.1  # share that is the union of two drawings
LEAST_PROBABILITY = 0.004  # of a resting face: rarer ones are not learned
MOST_PART_DRAWS = 200  # of one part
NEIGHBOURED_SHARE = 0.2  # of the examples: with neighbours that may hide some of the part
MOST_NEIGHBOURS = 3
GAP = 10e-3  # [m] the largest to a neighbour
LEAST_PIXELS = 150  # of the part
BORDER = 24  # [px] around what is needed: the sensor's noise and fattened edges reach so far
OVERLAP = 96  # [px] more to the left: there the d415's second imager sees nothing, up to its disparity at 0.53 m
MOST_VIEWS = 50  # views of an example
DOWN = np.array([0.0, 0.0, -1.0])
Example = dict[str, np.ndarray]
Body = tuple[Mesh, Pose]
VALIDATION_SCENES = 50  # spread evenly over the validation split; each with ideal depth and with the d415's
Batch = dict[str, Tensor]


@dataclass(frozen=True, eq=False)
class DrawnPart:
    """A part and how it may rest on a table."""

    mesh: Mesh
    """[m] about its centre of mass."""
    down: np.ndarray
    """(k, 3) outward unit normals of the faces it rests on, the most probable first."""
    probability: np.ndarray
    """(k,) of each, the sum is 1."""


@dataclass(frozen=True)
class DrawnParts:
    """The first parts of a seed."""

    seed: int
    count: int
    folder: Path | None = None
    """Folder of the shards; None keeps them in memory alone."""
    _shards: dict[int, list[DrawnPart]] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> DrawnPart:
        number, place = divmod(index, SHARD)
        if number not in self._shards:
            made = Memory(self.folder, verbose=0).cache(drawn_shard)(self.seed, number)
            self._shards[number] = made  # pyright: ignore[reportArgumentType]
        return self._shards[number][place]


def drawn_shard(seed: int, number: int) -> list[DrawnPart]:
    """SHARD parts of a seed."""
    return [drawn_part(seed, i) for i in range(SHARD * number, SHARD * (number + 1))]


def drawn_part(seed: int, index: int) -> DrawnPart:
    """Part number `index` of a seed: the first of its draws that is a part."""
    for attempt in range(MOST_PART_DRAWS):
        rng = stream(seed, "completion-part", index, attempt)
        try:
            mesh = _mesh(seed, index, attempt, rng)
            faces = resting_faces(mesh, LEAST_PROBABILITY)
        except (Redraw, MeshRefused):
            continue
        if faces and length(mesh.extents) / 2 <= PRESET.max_part_radius:
            probability = np.array([face.probability for face in faces])
            return DrawnPart(mesh, np.stack([face.normal for face in faces]), probability / probability.sum())
    raise InputError(f"part {index} of seed {seed}: none of {MOST_PART_DRAWS} draws is a part")


def _mesh(seed: int, index: int, attempt: int, rng: np.random.Generator) -> Mesh:
    """A closed mesh about its centre of mass; raises Redraw or MeshRefused."""
    longest = float(rng.uniform(*PRESET.longest))
    stretched, joined = rng.random() < STRETCHED, rng.random() < JOINED
    mesh = _drawing(seed, (index, attempt, 0), longest)
    if joined:
        other = _drawing(seed, (index, attempt, 1), longest * float(rng.uniform(0.5, 1)))
        yaw = 0.25 * np.pi * rng.integers(8)
        mesh = _union(mesh, other, yaw, rng.uniform(-0.4, 0.4, 3) * mesh.extents)
    if stretched:
        factors = STRETCH ** rng.uniform(-0.5, 0.5, 3)
        mesh = Mesh(mesh.vertices * factors, mesh.faces)
    if not (stretched or joined):
        return mesh
    mesh = part_of_mesh("drawn", mesh, longest).mesh.merged()
    if fault := defect_float32(mesh):
        raise Redraw(fault)
    return mesh


def _drawing(seed: int, key: Sequence[int], longest: float) -> Mesh:
    weights = family_weights(PRESET, "train")
    family = choose_family(seed, "completion-part", *key, weights=weights)
    drawing = FAMILIES[family].draw(stream(seed, "completion-part", *key, family))
    return make_part("drawn", family, drawing, longest).mesh


def _union(mesh: Mesh, other: Mesh, yaw: float, shift: np.ndarray) -> Mesh:
    """The union of two meshes, the other rotated about a vertical [rad] and shifted (3,) [m]; one body."""
    moved = solid_from_mesh(other).rotate((0.0, 0.0, float(np.degrees(yaw)))).translate(tuple(shift.tolist()))
    pieces = (solid_from_mesh(mesh) + moved).decompose()
    return mesh_from_solid(max(pieces, key=lambda piece: piece.volume()))


@dataclass(frozen=True)
class DrawnViews:
    """Examples from fresh parts; nothing but the generator decides which."""

    parts: DrawnParts
    d415_share: float
    """Share of the examples that the d415 measures."""

    def example(self, rng: np.random.Generator) -> Example:
        """Evidence and truth of a view, see `example_of`."""
        noisy, neighboured = rng.random() < self.d415_share, rng.random() < NEIGHBOURED_SHARE
        for _ in range(MOST_VIEWS):
            bodies = self._bodies(rng, int(rng.integers(1, MOST_NEIGHBOURS + 1)) if neighboured else 0)
            image = _image(bodies, draw_primary_pose(rng, neighboured), rng if noisy else None)
            if np.count_nonzero(image.labels == FIRST_PART_LABEL) >= LEAST_PIXELS:
                part = framed(image, FIRST_PART_LABEL, flat=noisy)
                if part is not None:
                    return example_of(part, *bodies[0], mirrored=bool(rng.integers(2)))
        raise InputError(f"none of {MOST_VIEWS} views shows {LEAST_PIXELS} pixels of its part")

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
    """The depth image of bodies on the table, as much of it as the first one needs; noise: see `rendered_box`."""
    pose = bodies[0][1]
    around = grid_at(float(pose.xyz[0]), float(pose.xyz[1]), 0.0)
    wide = replace(around, shape=(SHAPE[0] + 40, SHAPE[1] + 40, SHAPE[2])).moved(
        Pose.from_translation((-20 * around.voxel_size, -20 * around.voxel_size, 0.0))
    )
    return rendered_box(wide, BORDER, world_from_camera, bodies, FIRST_PART_LABEL, noise)


def rendered_box(
    grid: Grid,
    border: int,
    world_from_camera: Pose,
    bodies: Sequence[Body],
    first_label: int,
    noise: np.random.Generator | None,
) -> LabelledDepth:
    """The depth image of bodies on the table, as much of it as shows a grid.

    Args:
        grid: that is shown.
        border: [px] about it.
        world_from_camera: of the primary camera.
        bodies: on the table.
        first_label: label of the first body; the others count on.
        noise: of the calibrated d415; None for ideal depth.
    """
    rows, columns = pixel_box(grid, CAMERA, world_from_camera, border)
    columns = slice(columns.start - (0 if noise is None else OVERLAP), columns.stop)
    size = columns.stop - columns.start, rows.stop - rows.start
    camera = replace(CAMERA, width=size[0], height=size[1], cx=CAMERA.cx - columns.start, cy=CAMERA.cy - rows.start)
    frame = render(camera, world_from_camera, [(table(), Pose.identity()), *bodies], threads=1)
    labels = np.where(frame.body_ids > 1, frame.body_ids - 2 + first_label, 0).astype(np.uint8)
    view = View(camera, world_from_camera, frame.depth)
    return LabelledDepth(view if noise is None else noisy_view(view, noise), labels)


class Key(NamedTuple):
    """A validation example: the drawn target of a scene, seen by a sensor."""

    scene_id: str
    part: int
    sensor: str


@dataclass
class CompletionTask(RecordedTask[Key]):
    """Complete a part from one image."""

    training: DrawnViews
    dataset: Dataset
    split: str
    model: CompletionNet

    def example(self, rng: np.random.Generator) -> Example:
        """A fresh view of a fresh part."""
        return self.training.example(rng)

    def validation_keys(self) -> Sequence[Key]:
        """The drawn targets of VALIDATION_SCENES scenes, by the sensors of the training examples."""
        targets = drawn_targets(self.dataset, self.split, VALIDATION_SCENES)
        share = self.training.d415_share
        sensors = [name for name, of_all in (("ideal", 1 - share), ("d415", share)) if of_all > 0]
        return [Key(query.scene_id, query.part, sensor) for query, sensor in targets if sensor in sensors]

    def recorded(self, key: Key) -> Example:
        """The part as its image shows it; that of the d415 is calibrated by the table."""
        scene = self.dataset.split(self.split, truth=True).scene(key.scene_id)
        image = calibrated_image(scene.labelled_depth(key.sensor), simulated_sensor(key.sensor))
        mesh, pose = scene.bodies()[2 + key.part]
        label = FIRST_PART_LABEL + key.part
        part = framed(image, label, scale=scale_of(image, label))
        if part is None:
            raise InputError(f"{key.scene_id}: the image shows no pixel of part {key.part}")
        return example_of(part, mesh, pose)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy and soft Jaccard distance of the cells that are not seen free."""
        return completion_loss(self.model(batch["codes"], batch["camera"]), batch["codes"], batch["solid"])

    def measure(self, batch: Batch) -> Batch:
        """(B,) `wrong`: 1 - IoU of the solid at p > 0.5; the same for the hidden cells; and the Brier score."""
        logits = self.model(batch["codes"], batch["camera"]).float().flatten(1)
        codes, share = batch["codes"].flatten(1), batch["solid"].flatten(1).float() / 255
        filled = torch.sigmoid(logits) * (codes < CODE)
        hidden = codes <= -CODE
        brier = (((filled - share) ** 2) * hidden).sum(1) / hidden.sum(1)
        return {
            "wrong": _wrong(filled > 0.5, share > 0.5),
            "wrong_hidden": _wrong((filled > 0.5) & hidden, (share > 0.5) & hidden),
            "brier_hidden": brier,
        }


def _wrong(filled: Tensor, solid: Tensor) -> Tensor:
    """(B,) 1 - IoU of bool (B, n)."""
    return 1 - (filled & solid).sum(1) / (filled | solid).sum(1).clamp(min=1)


def completion_task(dataset: Dataset, preset: str, d415_share: float | None = None) -> CompletionTask:
    """The task with new weights, validated on the split val. d415_share: instead of that of the preset."""
    seed, share = PARTS[preset]
    parts = DrawnParts(seed, PARTS_SHOWN, user_cache("drawn-parts"))
    views = DrawnViews(parts, share if d415_share is None else d415_share)
    return CompletionTask(views, dataset, "val", CompletionNet(UNetConfig(widths=(96, 128, 192, 256), blocks=2)))
