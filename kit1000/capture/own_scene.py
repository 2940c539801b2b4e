"""A scene from depth frames of the user's own camera: one image, its table, what stands on it, and the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kit1000.capture.depth_frames import DepthFrame, assumed_unit, stated_unit
from kit1000.capture.depth_readings import check_assumed_unit, image_and_table, image_of_frames
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.known_sensors import is_scanner, known_baseline
from kit1000.capture.mask_networks import cut_back
from kit1000.capture.options import ImportOptions
from kit1000.capture.own_world import OwnWorld, world_of_bodies, world_of_pose
from kit1000.capture.pinhole_images import PinholeImage
from kit1000.capture.pose_files import read_pose
from kit1000.capture.seen_bodies import SeenBody, seen_bodies
from kit1000.capture.table_search import Table
from kit1000.errors import InputError
from kit1000.perception.sensor_facts import D415, SCANNER, SensorFacts
from kit1000.sim.sensors import on_depth_grid
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

UNKNOWN_DEVICE = "depth camera"


@dataclass(frozen=True, eq=False)
class OwnScene:
    """What the frames of one image show."""

    source: str
    table: Table
    bodies: tuple[SeenBody, ...]
    """The kit first, then the parts in order."""
    world: OwnWorld
    image: LabelledDepth
    """In that world, with masks, depths on the grid of recordings."""
    facts: SensorFacts
    intrinsics: str
    """Where the intrinsics come from."""

    @property
    def kit(self) -> SeenBody:
        """The body with the cavities."""
        return self.bodies[0]

    @property
    def outline(self) -> np.ndarray:
        """(k, 2) [m] world: convex, about what was seen of the table."""
        corners = self.table.outline @ self.table.axes[:2] - self.table.distance * self.table.axes[2]
        return self.world.world_from_camera.apply(corners)[:, :2]

    def place(self, body: SeenBody) -> np.ndarray:
        """(2,) [m] world: the middle of a body on the table."""
        axes, distance = self.table.axes, self.table.distance
        return self.world.world_from_camera.apply(body.centre @ axes[:2] - distance * axes[2])[:2]

    @property
    def parts(self) -> tuple[SeenBody, ...]:
        """The other bodies."""
        return self.bodies[1:]


def own_scene(
    frames: Sequence[DepthFrame],
    intrinsics: Intrinsics | None,
    options: ImportOptions,
    pose: Path | None = None,
    empty: Table | None = None,
) -> OwnScene:
    """The scene that frames of a camera at rest show.

    Args:
        frames: of one size; their median is taken.
        intrinsics: those given; None: the first frame brings its own.
        options: what the user says.
        pose: file of the hand-eye pose; None: the world follows from the bodies.
        empty: the table as the same camera sees it without bodies; None: it is found in the image itself.

    Raises:
        InputError: in one line, if the image shows no table or no bodies on it, or if a stated value does not fit it.
    """
    source, first = frames[0].source, frames[0]
    known = frame_intrinsics(first, intrinsics)
    stated = stated_unit(first, known, options.depth_scale, options.device)
    unit = stated or assumed_unit(first)
    if empty is None:
        (image, table), floor = image_and_table(frames, known, unit), None
    else:  # bodies may hide nearly all of the table, so it is not searched again
        image = image_of_frames(frames, known, unit)
        table, floor = _on_empty_table(image, source, empty)
    bodies = seen_bodies(table, floor)
    chosen = _with_kit_first(bodies.sure, options, source, table)
    if stated is None and first.integers:
        check_assumed_unit(source, unit, table.distance, chosen[0].sides)
    facts = _facts(first, known, image, table, options, unit)
    if options.networks:
        kit, parts = cut_back(table, on_depth_grid(image.depth), chosen, bodies.doubtful, facts)
        chosen = [kit, *parts]
    if pose is None:
        world = world_of_bodies(table, chosen[0], chosen[1:])
    else:
        world = world_of_pose(table, read_pose(pose), str(pose))
    labels = np.zeros(image.depth.shape, np.uint8)
    for number, body in enumerate(chosen):
        labels[body.mask] = ASSEMBLY_LABEL if number == 0 else FIRST_PART_LABEL + number - 1
    view = View(image.camera, world.world_from_camera, on_depth_grid(image.depth))
    return OwnScene(source, table, tuple(chosen), world, LabelledDepth(view, labels), facts, known.source)


def frame_intrinsics(frame: DepthFrame, given: Intrinsics | None) -> Intrinsics:
    """The given intrinsics, else those that came with a frame."""
    known = given or frame.intrinsics
    if known is None:
        raise InputError(
            f"{frame.source}: no intrinsics beside it: record CameraInfo too, or give --intrinsics FILE, or fx fy cx cy"
        )
    return known


def _on_empty_table(image: PinholeImage, source: str, empty: Table) -> tuple[Table, np.ndarray]:
    """The table of an image as it was without bodies, and its heights there."""
    if empty.image.camera != image.camera:
        raise InputError(f"--empty-table: of another camera or size than {source}: take both with the same settings")
    return replace(empty, image=image), empty.flat_heights


def _with_kit_first(bodies: list[SeenBody], options: ImportOptions, source: str, table: Table) -> list[SeenBody]:
    """Bodies with the kit first, the others as they are."""
    kit = options.kit
    if not bodies:
        raise InputError(
            f"{source}: nothing higher than {1e3 * max(2.5e-3, 2.5 * table.ripple):.1f} mm stands on the table "
            f"({100 * table.share:.0f} % of the image): put kit and parts on it, or come nearer"
        )
    if not 1 <= kit <= len(bodies):
        raise InputError(f"--kit {kit}: {source} shows {len(bodies)} bodies; expected 1 to {len(bodies)}")
    if kit == 1 and options.kit_size is not None:
        wanted = np.log((*sorted(options.kit_size[:2]), options.kit_size[2]))
        off = [np.abs(np.log((*body.sides, body.height)) - wanted).sum() for body in bodies]
        kit = 1 + int(np.argmin(off))
    return [bodies[kit - 1], *bodies[: kit - 1], *bodies[kit:]]


def _facts(
    frame: DepthFrame, known: Intrinsics, image: PinholeImage, table: Table, options: ImportOptions, unit: float
) -> SensorFacts:
    """The facts about the sensor: as the user says, else the files, else its name."""
    device = options.device or known.device or UNKNOWN_DEVICE
    scanner = is_scanner(device)
    model = SCANNER if scanner else D415
    stated = None if options.baseline_mm is None else 1e-3 * options.baseline_mm
    baseline = stated or known.baseline or known_baseline(device) or model.baseline
    return SensorFacts(
        device=device,
        baseline=baseline,
        fattening_px=model.fattening_px,
        focal_length=known.fx,
        unit=unit if frame.integers or unit != 1.0 else 0.0,
        noise_px=round(float(image.camera.fx * baseline * table.spread), 4),
        stream=options.stream or known.stream or ("raw" if scanner else "aligned"),
        simulated_table=False,
        scanner=scanner,
    )
