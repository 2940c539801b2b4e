"""Training examples of kit completion: fresh views of assemblies of the train split, some of them with a fresh kit."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from baselines.training.tasks.kit_completion.sampled_kits import STRETCH, drawn_kit, stretched, with_kit
from baselines.training.tasks.noisy_images import noisy_view
from baselines.training.tasks.part_completion.views import OVERLAP
from kit1000.dataset.geometry import Geometry
from kit1000.errors import Redraw
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.perception.completion.parts import pixel_box
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
from kit1000.perception.restoration.restorer import Restorer
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.layout import KITS_CENTRE, MAX_KITS_SHIFT, table
from kit1000.sim.render import render
from kit1000.values import ASSEMBLY_LABEL, Assembly, Kit, LabelledDepth, Mount, View

D415_SHARE = 0.6  # of the views: measured by the d415, the others ideal
LEAST_COSINE = 0.25  # of the polar angle of a camera: of flatter plates hardly anything is seen
JITTER = 12e-3  # [m] most along x and y, of the middle of a relief from that of its plate
PLANE_ERRORS = {"ideal": (1e-3, 3e-5), "d415": (6e-3, 3e-4)}
"""Standard deviations [rad], [m] of the planes: about those of `find_planes`."""
BORDER = 12  # [px] around what is needed: the sensor's noise and fattened edges reach so far

Example = dict[str, np.ndarray]


@dataclass(frozen=True)
class KitViews:
    """The first views of a seed; each is made when it is first asked for, and kept in memory (64 KB)."""

    geometry: Geometry
    assemblies: Sequence[str]
    """Ids of those that are shown."""
    seed: int
    count: int
    drawn: int
    """Fresh kits of that seed."""
    drawn_share: float
    """Share of the views with one of these instead of the kit that is shown."""
    stretched_share: float
    """Share of the views with the kit that is shown stretched."""
    restorer: Restorer
    """Restorer of the images of the d415."""
    _kept: dict[int, Example] = field(default_factory=dict, repr=False, compare=False)
    _kits: dict[int, Kit] = field(default_factory=dict, repr=False, compare=False)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Example:
        if not 0 <= index < self.count:
            raise IndexError(index)
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
        image = _image(assembly, world_from_assembly, plane, middle, camera, noise)
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


def _image(
    assembly: Assembly,
    world_from_assembly: Pose,
    plane: Plane,
    middle: np.ndarray,
    world_from_camera: Pose,
    noise: np.random.Generator | None,
) -> LabelledDepth:
    """The depth image of an assembly on the table, as much of it as shows a relief about a middle.

    noise: of the calibrated d415; None for ideal depth.
    """
    around = height_grid(away_frame(plane, middle, world_from_camera.xyz))
    rows, columns = pixel_box(around, CAMERA, world_from_camera, BORDER)
    columns = slice(columns.start - (0 if noise is None else OVERLAP), columns.stop)
    size = columns.stop - columns.start, rows.stop - rows.start
    camera = replace(CAMERA, width=size[0], height=size[1], cx=CAMERA.cx - columns.start, cy=CAMERA.cy - rows.start)
    bodies = [(table(), Pose.identity()), (assembly.mesh, world_from_assembly)]
    rendered = render(camera, world_from_camera, bodies, threads=1)
    labels = np.where(rendered.body_ids == 2, ASSEMBLY_LABEL, 0).astype(np.uint8)
    view = View(camera, world_from_camera, rendered.depth)
    return LabelledDepth(view if noise is None else noisy_view(view, noise), labels)
