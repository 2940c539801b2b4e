"""A scene from depth frames of the user's own camera: one image, its table, what stands on it, and the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kit1000.capture.depth_frames import DepthFrame, mean_depth, metric_depth
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.known_sensors import is_scanner, known_baseline
from kit1000.capture.mask_networks import cut_back
from kit1000.capture.own_world import OwnWorld, read_pose, world_of_bodies, world_of_pose
from kit1000.capture.pinhole_images import PinholeImage, pinhole_image
from kit1000.capture.seen_bodies import SeenBody, seen_bodies
from kit1000.capture.table_search import Table, find_table
from kit1000.errors import InputError
from kit1000.perception.sensor_facts import D415, SCANNER, SensorFacts
from kit1000.sim.sensors import Stream, on_depth_grid
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

UNKNOWN_DEVICE = "depth camera"


@dataclass(frozen=True)
class Wanted:
    """What the user says about the images."""

    depth_scale: float | None = None
    """[m] that 1 in an image stands for; None: as the files say."""
    device: str = ""
    """Name of the camera; empty: as the files say. It tells a structured-light scanner from a stereo camera."""
    baseline: float | None = None
    """[m] between its imagers; None: by the name."""
    stream: Stream | None = None
    """None: as the files say, else raw of a scanner and aligned of other cameras."""
    kit: int = 1
    """Number of the body that is the kit, the largest first, from 1."""
    world_from_camera: Path | None = None
    """JSON file of a hand-eye pose."""
    networks: bool = False
    """Whether the networks of segmentation cut the masks back."""


@dataclass(frozen=True, eq=False)
class OwnScene:
    """A scene."""

    source: str
    table: Table
    bodies: tuple[SeenBody, ...]
    """The kit first, then the parts in order."""
    world: OwnWorld
    image: LabelledDepth
    """In that world, with masks, depths on the grid of recordings."""
    facts: SensorFacts

    @property
    def kit(self) -> SeenBody:
        """The body with the cavities."""
        return self.bodies[0]

    @property
    def outline(self) -> np.ndarray:
        """(k, 2) [m] world: convex, about what was seen of the table."""
        corners = self.table.outline @ self.table.axes[:2] - self.table.distance * self.table.axes[2]
        return self.world.world_from_camera.apply(corners)[:, :2]

    @property
    def parts(self) -> tuple[SeenBody, ...]:
        """The other bodies."""
        return self.bodies[1:]


def own_scene(
    frames: Sequence[DepthFrame], intrinsics: Intrinsics | None, wanted: Wanted, empty: Table | None = None
) -> OwnScene:
    """The scene that frames of a camera at rest show.

    Args:
        frames: of one size, averaged.
        intrinsics: those given; None: the first frame brings its own.
        wanted: what the user says.
        empty: the table as the same camera sees it without bodies; None: it is found in the image itself.

    Raises:
        InputError: in one line, where the image shows no table or no bodies on it.
    """
    source = frames[0].source
    known = frame_intrinsics(frames[0], intrinsics)
    image = image_of_frames(frames, known, wanted.depth_scale)
    table, floor = _table(image, source, empty)
    bodies = seen_bodies(table, floor)
    chosen = _with_kit_first(bodies.sure, wanted.kit, source, table)
    facts = _facts(frames[0], known, image, table, wanted)
    if wanted.networks:
        kit, parts = cut_back(table, on_depth_grid(image.depth), chosen, bodies.doubtful, facts)
        chosen = [kit, *parts]
    world = _world(table, chosen, wanted)
    labels = np.zeros(image.depth.shape, np.uint8)
    for number, body in enumerate(chosen):
        labels[body.mask] = ASSEMBLY_LABEL if number == 0 else FIRST_PART_LABEL + number - 1
    view = View(image.camera, world.world_from_camera, on_depth_grid(image.depth))
    return OwnScene(source, table, tuple(chosen), world, LabelledDepth(view, labels), facts)


def frame_intrinsics(frame: DepthFrame, given: Intrinsics | None) -> Intrinsics:
    """The given intrinsics, else those that came with a frame."""
    known = given or frame.intrinsics
    if known is None:
        raise InputError(
            f"{frame.source}: no intrinsics beside it: record CameraInfo too, or give --intrinsics FILE, or fx fy cx cy"
        )
    return known


def image_of_frames(frames: Sequence[DepthFrame], known: Intrinsics, scale: float | None) -> PinholeImage:
    """One image of several frames, without distortion."""
    first = frames[0].values.shape
    for frame in frames[1:]:
        if frame.values.shape != first:
            raise InputError(f"{frame.source}: {frame.values.shape[::-1]} px, the first frame has {first[::-1]}")
    unit = scale or known.unit
    return pinhole_image(mean_depth([metric_depth(frame, unit) for frame in frames]), known, frames[0].source)


def _table(image: PinholeImage, source: str, empty: Table | None) -> tuple[Table, np.ndarray | None]:
    """The table of an image, and the heights that it has without bodies, where that is known."""
    if empty is None:
        return find_table(image, source), None
    if empty.image.camera != image.camera:
        raise InputError(f"--empty-table: of another camera or size than {source}: take both with the same settings")
    return replace(empty, image=image), empty.flat_heights


def _with_kit_first(bodies: list[SeenBody], kit: int, source: str, table: Table) -> list[SeenBody]:
    """Bodies with the kit first, the others as they are."""
    if not bodies:
        raise InputError(
            f"{source}: nothing higher than {1e3 * max(2.5e-3, 2.5 * table.ripple):.1f} mm stands on the table "
            f"({100 * table.share:.0f} % of the image): put kit and parts on it, or come nearer"
        )
    if not 1 <= kit <= len(bodies):
        raise InputError(f"--kit {kit}: {source} shows {len(bodies)} bodies; expected 1 to {len(bodies)}")
    return [bodies[kit - 1], *bodies[: kit - 1], *bodies[kit:]]


def _world(table: Table, bodies: Sequence[SeenBody], wanted: Wanted) -> OwnWorld:
    if wanted.world_from_camera is None:
        return world_of_bodies(table, bodies[0], bodies[1:])
    return world_of_pose(table, read_pose(wanted.world_from_camera), str(wanted.world_from_camera))


def _facts(frame: DepthFrame, known: Intrinsics, image: PinholeImage, table: Table, wanted: Wanted) -> SensorFacts:
    """The facts about the sensor: as the user says, else the files, else its name."""
    device = wanted.device or known.device or UNKNOWN_DEVICE
    scanner = is_scanner(device)
    model = SCANNER if scanner else D415
    baseline = wanted.baseline or known.baseline or known_baseline(device) or model.baseline
    integers = frame.values.dtype.kind in "iu"
    unit = wanted.depth_scale or known.unit or frame.unit or (1e-3 if integers else 0.0)
    return SensorFacts(
        device=device,
        baseline=baseline,
        fattening_px=model.fattening_px,
        focal_length=known.fx,
        unit=unit,
        noise_px=round(float(image.camera.fx * baseline * table.spread), 4),
        stream=wanted.stream or known.stream or ("raw" if scanner else "aligned"),
        simulated_table=False,
        scanner=scanner,
    )
