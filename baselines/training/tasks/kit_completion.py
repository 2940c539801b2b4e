"""The training task of kit completion: new views of assemblies of the train split, some of them with a newly cut kit.

Kit i of a seed is the same whoever makes it. Stretched, it shows the network yet another cavity.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.training.tasks.part_completion import DrawnPart, drawn_part, rendered_box
from baselines.training.validation import RecordedTask, drawn_targets
from kit1000.dataset.geometry import Geometry
from kit1000.dataset.reader import Dataset
from kit1000.errors import InputError, Redraw
from kit1000.kits.assembly import join_mounts
from kit1000.kits.cavity import MIN_SEATED_HEIGHT
from kit1000.kits.face import RestingFace
from kit1000.kits.kit import design_kit
from kit1000.mesh import Mesh
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.parts.family import part_of_mesh
from kit1000.perception.completion.kits import KitCompletionNet, kit_loss, likely_depths
from kit1000.perception.networks.unet import UNetConfig
from kit1000.perception.observed.kits import (
    CELL,
    CELLS,
    SeenHeights,
    away_frame,
    height_grid,
    seen_heights,
    true_depths,
)
from kit1000.perception.observed.plates import Plane
from kit1000.perception.restoration import calibrated_image
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.cameras import draw_primary_pose
from kit1000.sim.layout import KITS_CENTRE, MAX_KITS_SHIFT
from kit1000.values import ASSEMBLY_LABEL, Assembly, Kit, Mount

MAX_DRAWS = 50  # of one kit
STRETCH = np.array([(0.75, 1.1), (0.75, 1.1), (0.7, 1.05)])
"""Range of `stretched`'s factors in x, y and z: a cavity of 20 mm keeps 1 mm of floor, and gaps between plates stay."""
UNDERSIDE = 1e-6  # [m] above it, vertices are the cavity's or the face's
D415_SHARE = 0.6  # of the views: measured by the d415, the others ideal
LEAST_COSINE = 0.25  # of the polar angle of a camera: of flatter plates hardly anything is seen
JITTER = 12e-3  # [m] most along x and y, of the middle of a relief from that of its plate
PLANE_ERRORS = {"ideal": (1e-3, 3e-5), "d415": (6e-3, 3e-4)}
"""Standard deviations [rad], [m] of the planes: about those of `find_planes`."""
BORDER = 12  # [px] around what is needed: the sensor's noise and fattened edges reach so far
Example = dict[str, np.ndarray]
VALIDATION_SCENES = 20  # spread evenly over the validation split; each with ideal depth and with the d415's
VIEWS = {
    "small": (2034,),
    "pretraining": (2032, 12_000, 0.75, 3000, 0.0),
    "pretraining-2": (2033, 10_000, 0.25, 600, 0.0),
}
"""Fields of `KitViews` from `seed` on, by preset, each run from the weights of the one before: `pretraining` sees more
kinds of kits than those of datasets, `pretraining-2` mostly theirs, `small` fresh and stretched ones of both."""
BESIDE = 0.2  # weight of a cell beside the plate
Batch = dict[str, Tensor]


def drawn_kit(seed: int, index: int) -> Kit:
    """Kit number `index` of a seed: the first of its draws whose part fits a plate of datasets."""
    for attempt in range(MAX_DRAWS):
        part = drawn_part(seed, MAX_DRAWS * index + attempt)
        face = _insertion_face(part, stream(seed, "completion-kit", index, attempt))
        if face.height < MIN_SEATED_HEIGHT:
            continue
        try:
            return design_kit(part_of_mesh("drawn", part.mesh), face=face).kit
        except Redraw:
            continue
    raise InputError(f"kit {index} of seed {seed}: none of {MAX_DRAWS} draws is a kit")


def with_kit(assembly: Assembly, number: int, kit: Kit) -> Assembly:
    """The assembly with another kit in one of its mounts. Raises Redraw when its mesh is unprintable."""
    mounts = list(assembly.mounts)
    mounts[number] = Mount(kit, mounts[number].assembly_from_kit)
    return join_mounts(assembly.id, tuple(mounts))


def stretched(kit: Kit, factors: np.ndarray) -> Kit:
    """The kit with its plate stretched along x and y, and along z its cavity alone: the plate keeps its thickness.

    Its slot is still that of the part before. factors: (3,), those of x, y and z. Raises InputError when the cavity
    would reach the plate's underside.
    """
    lowest = UNDERSIDE - kit.extent[2]
    above = kit.mesh.vertices[:, 2] > lowest
    vertices = kit.mesh.vertices * (*factors[:2], 1.0)
    vertices[above, 2] *= factors[2]
    if vertices[above, 2].min() <= lowest:
        raise InputError(f"factors: {factors[2]} along z stretches the cavity through the plate's underside")
    return replace(kit, mesh=Mesh(vertices, kit.mesh.faces), extent=kit.extent * (*factors[:2], 1.0))


def _insertion_face(part: DrawnPart, rng: np.random.Generator) -> RestingFace:
    """One of the faces on which a part rests, as often as it rests on it."""
    number = int(rng.choice(len(part.down), p=part.probability))
    along = matmul(part.mesh.vertices, part.down[number])
    return RestingFace(part.down[number], float(part.probability[number]), float(np.ptp(along)))


@dataclass(frozen=True)
class KitViews:
    """The first views of a seed; each is made when it is first asked for, and kept in memory (64 KB)."""

    geometry: Geometry
    assemblies: Sequence[str]
    """Ids of those that are shown."""
    restorer: Restorer
    """Restorer of the images of the d415."""
    seed: int
    """Seed of views and kits."""
    count: int = 14_000
    drawn_share: float = 0.5
    """Share of the views with a newly cut kit instead of the kit that is shown."""
    drawn: int = 3000
    """Number of these newly cut kits."""
    stretched_share: float = 0.75
    """Share of the views with the kit that is shown stretched."""
    _kept: dict[int, Example] = field(default_factory=dict, repr=False, compare=False)
    _kits: dict[int, Kit] = field(default_factory=dict, repr=False, compare=False)

    def view(self, index: int) -> Example:
        """View number `index`."""
        if index not in self._kept:
            self._kept[index] = self._view(stream(self.seed, "kit-completion", index))
        return self._kept[index]

    def _view(self, rng: np.random.Generator) -> Example:
        """A view of a plate, its assembly anywhere on the kits' half of the table, at any yaw."""
        sensor = "d415" if rng.random() < D415_SHARE else "ideal"
        assembly, mount = self._shown(rng)
        shift = KITS_CENTRE + rng.uniform(-MAX_KITS_SHIFT, MAX_KITS_SHIFT, 2)
        world_from_assembly = Pose.from_rotvec((0.0, 0.0, rng.uniform(0, 2 * np.pi)), (*shift, 0.0))
        plane, middle = _near(world_from_assembly @ mount.assembly_from_kit, sensor, rng)
        camera, noise = _camera_before(plane, middle, rng), rng if sensor == "d415" else None
        around = height_grid(away_frame(plane, middle, camera.xyz))
        bodies = [(assembly.mesh, world_from_assembly)]
        image = rendered_box(around, BORDER, camera, bodies, ASSEMBLY_LABEL, noise)
        facts = simulated_sensor(sensor)
        restored = self.restorer(image, facts, (ASSEMBLY_LABEL,))
        relief = seen_heights(restored, plane, middle, facts.kind.best.noise)
        return example_of(relief, assembly, world_from_assembly, mount)

    def _shown(self, rng: np.random.Generator) -> tuple[Assembly, Mount]:
        """An assembly, and which of its mounts is shown."""
        assembly = self.geometry.assembly(self.assemblies[int(rng.integers(len(self.assemblies)))])
        number = int(rng.integers(len(assembly.mounts)))
        kit = assembly.mounts[number].kit
        if rng.random() < self.drawn_share:
            kit = self._kit(int(rng.integers(self.drawn)))
        if self.stretched_share and rng.random() < self.stretched_share:  # at 0 no draw, so earlier views stay
            kit = stretched(kit, rng.uniform(*STRETCH.T))
        if kit is not assembly.mounts[number].kit:
            with suppress(Redraw):
                assembly = with_kit(assembly, number, kit)
        return assembly, assembly.mounts[number]

    def _kit(self, index: int) -> Kit:
        if index not in self._kits:
            self._kits[index] = drawn_kit(self.seed, index)
        return self._kits[index]


def example_of(relief: SeenHeights, assembly: Assembly, world_from_assembly: Pose, mount: Mount) -> Example:
    """`least`, `seen`, `camera` as of the evidence, `depth` [mm] the truth, `plate` bool: the cells of the plate."""
    plate_from_kit = relief.world_from_plate.inverse() @ world_from_assembly @ mount.assembly_from_kit
    depth = true_depths(assembly.mesh, world_from_assembly, relief.world_from_plate)
    plate = on_plate(plate_from_kit, mount.kit.extent)
    return {"least": relief.least, "seen": relief.seen, "camera": relief.camera, "depth": depth, "plate": plate}


def mirrored(example: Example) -> Example:
    """The example with its images mirrored about the plane of the camera."""
    images = {name: np.ascontiguousarray(value[:, ::-1]) for name, value in example.items() if value.ndim == 2}
    return {**example, **images}


def on_plate(plate_from_kit: Pose, extent: np.ndarray) -> np.ndarray:
    """(CELLS, CELLS) bool: the cells of a relief that lie on a plate of an extent (3,) [m]."""
    at = (np.arange(CELLS) - (CELLS - 1) / 2) * CELL
    points = np.stack([*np.meshgrid(at, at, indexing="ij"), np.zeros((CELLS, CELLS))], -1)
    return np.all(np.abs(plate_from_kit.inverse().apply(points)[..., :2]) < extent[:2] / 2, axis=-1)


def plane_of(world_from_kit: Pose) -> Plane:
    """The true face of a plate."""
    return Plane(world_from_kit.rotate((0.0, 0.0, 1.0)), world_from_kit.xyz, 0.0)


def _near(world_from_kit: Pose, sensor: str, rng: np.random.Generator) -> tuple[Plane, np.ndarray]:
    """The face of a plate, about as it is found in an image, and a middle (3,) [m] near that of the plate."""
    tilt, shift = PLANE_ERRORS[sensor]
    error = Pose.from_rotvec((*(tilt * rng.normal(size=2)), 0.0), (0.0, 0.0, shift * rng.normal()))
    middle = world_from_kit.apply((*rng.uniform(-JITTER, JITTER, 2), 0.0))
    return plane_of(world_from_kit @ error), middle


def _camera_before(plane: Plane, middle: np.ndarray, rng: np.random.Generator) -> Pose:
    """A primary camera before a plate's face."""
    while True:
        pose = draw_primary_pose(rng)
        towards = pose.xyz - middle
        if matmul(plane.normal, towards) > LEAST_COSINE * length(towards):
            return pose


class Key(NamedTuple):
    """A validation example: the kit of the drawn target of a scene, seen by a sensor."""

    scene_id: str
    query_id: str
    sensor: str


@dataclass
class KitCompletionTask(RecordedTask[Key]):
    """Complete the relief of a plate from one image."""

    training: KitViews
    dataset: Dataset
    split: str
    model: KitCompletionNet

    def example(self, rng: np.random.Generator) -> Example:
        """One of the fresh views, or its mirror image."""
        view = self.training.view(int(rng.integers(self.training.count)))
        return mirrored(view) if rng.integers(2) else view

    def validation_keys(self) -> Sequence[Key]:
        """The kits of the drawn targets of VALIDATION_SCENES scenes, by both sensors where the dataset has both."""
        targets = drawn_targets(self.dataset, self.split, VALIDATION_SCENES)
        return [Key(query.scene_id, query.id, sensor) for query, sensor in targets]

    def recorded(self, key: Key) -> Example:
        """The kit as its image shows it; that of the d415 is calibrated by the table and restored."""
        scene = self.dataset.split(self.split, truth=True).scene(key.scene_id)
        truth = scene.truth_of(key.query_id)
        assembly = self.dataset.geometry.assembly(truth.assembly_id)
        mount = next(mount for mount in assembly.mounts if mount.kit.id == truth.part_id)
        pose = truth.world_from_kit
        sensor = simulated_sensor(key.sensor)
        image = calibrated_image(scene.labelled_depth(key.sensor), sensor)
        restored = self.training.restorer(image, sensor, (ASSEMBLY_LABEL,))
        relief = seen_heights(restored, plane_of(pose), pose.xyz, sensor.kind.best.noise)
        return example_of(relief, assembly, pose @ mount.assembly_from_kit.inverse(), mount)

    def loss(self, batch: Batch) -> Tensor:
        """() cross-entropy of the layers of hidden cells."""
        logits = self.model(batch["least"], batch["seen"], batch["camera"])
        weight = BESIDE + (1 - BESIDE) * batch["plate"].float()
        return kit_loss(logits, batch["least"], batch["seen"], batch["depth"], weight)

    def measure(self, batch: Batch) -> Batch:
        """(B,) `hidden_mm`: mean absolute error of the depth of hidden cells of the plate; 0 where none is."""
        logits = self.model(batch["least"], batch["seen"], batch["camera"])
        depth = torch.maximum(likely_depths(logits), batch["least"])
        hidden = batch["plate"] & ~batch["seen"]
        wrong = ((depth - batch["depth"]).abs() * hidden).sum((1, 2))
        return {"hidden_mm": wrong / hidden.sum((1, 2)).clamp(min=1)}


def kit_completion_task(dataset: Dataset, preset: str, restoration: Path) -> KitCompletionTask:
    """The task with new weights. restoration: stem of the weights of the network that restores images of the d415."""
    ids = sorted(id for id, row in dataset.geometry.assemblies.items() if row["split"] == "train")
    views = KitViews(dataset.geometry, ids, Restorer(restoration), *VIEWS[preset])
    return KitCompletionTask(views, dataset, "val", KitCompletionNet(UNetConfig()))
