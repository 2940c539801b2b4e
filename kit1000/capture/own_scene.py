"""A scene from depth frames of the user's own camera: one image, its table, what stands on it, and the world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kit1000.capture.depth_frames import DepthFrame, mean_depth, metric_depth, stated_unit
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.known_sensors import is_scanner, known_baseline
from kit1000.capture.mask_networks import outlined
from kit1000.capture.options import ImportOptions
from kit1000.capture.own_world import OwnWorld, world_of_bodies, world_of_pose
from kit1000.capture.pinhole_images import PinholeImage, pinhole_image
from kit1000.capture.pose_files import read_pose
from kit1000.capture.seen_bodies import SeenBody, seen_bodies, sure_height
from kit1000.capture.table_search import Table, find_table
from kit1000.errors import InputError
from kit1000.perception.sensor_facts import D415, SCANNER, SensorFacts
from kit1000.sim.sensors import on_depth_grid
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

UNKNOWN_DEVICE = "depth camera"
NEAR_TABLE, FAR_TABLE = 0.12, 1.5  # [m] of the camera above a table
BENT_SHARE = 0.8  # of the pixels with a return on the table: below it lengths of rays are tried, which bend a table
FLATTER = 1.25  # ratio of the shares from which the values surely are such lengths
SMALL_KIT, LARGE_KIT = 30e-3, 0.4  # [m] longer side of a kit
FINE_UNITS = (1e-4, 2e-4, 2.5e-4)  # [m] usual units beside 1 mm


@dataclass(frozen=True, eq=False)
class OwnScene:
    """What the frames of one image show."""

    source: str
    table: Table
    bodies: tuple[SeenBody, ...]  # the kit first, then the parts in order
    world: OwnWorld
    image: LabelledDepth  # in that world, with masks, depths on the grid of recordings
    facts: SensorFacts
    intrinsics: str  # where the intrinsics come from

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
    frames: Sequence[DepthFrame], intrinsics: Intrinsics | None, options: ImportOptions, pose: Path | None = None
) -> OwnScene:
    """The scene that frames of a camera at rest show.

    Args:
        frames: of one size; their median is taken.
        intrinsics: those given; None: the first frame brings its own.
        options: what the user says.
        pose: file of the hand-eye pose; None: the world follows from the bodies.

    Raises:
        InputError: in one line, if the image shows no table or no bodies on it, or if a stated value does not fit it.
    """
    source, first = frames[0].source, frames[0]
    known = intrinsics or first.intrinsics
    if known is None:
        advice = "record CameraInfo too, or give --intrinsics FILE, or fx fy cx cy"
        raise InputError(f"{source}: no intrinsics beside it: {advice}")
    stated = stated_unit(first, known, options.depth_scale, options.device)
    unit = stated or (1e-3 if first.integers else 1.0)
    image, table = _image_and_table(frames, known, unit)
    bodies = seen_bodies(table)
    chosen = _with_kit_first(bodies.sure, options, source, table)
    if stated is None and first.integers:
        _check_assumed_unit(source, unit, table.distance, chosen[0].sides)
    facts = _facts(first, known, image, table, options, unit)
    if options.networks:
        kit, parts = outlined(table, on_depth_grid(image.depth), chosen, bodies.doubtful, facts)
        chosen = [kit, *parts]
    if pose is None:
        world = world_of_bodies(table, chosen[0], chosen[1:])
    else:
        given = read_pose(pose)
        world = world_of_pose(table, given, str(pose))
        facts = replace(facts, height_ratio=round(table.distance / float(given.xyz[2]), 6))
    labels = np.zeros(image.depth.shape, np.uint8)
    for number, body in enumerate(chosen):
        labels[body.mask] = ASSEMBLY_LABEL if number == 0 else FIRST_PART_LABEL + number - 1
    view = View(image.camera, world.world_from_camera, on_depth_grid(image.depth))
    return OwnScene(source, table, tuple(chosen), world, LabelledDepth(view, labels), facts, known.source)


def _image_and_table(frames: Sequence[DepthFrame], known: Intrinsics, unit: float) -> tuple[PinholeImage, Table]:
    """The median of frames, undistorted, and its table.

    Raises InputError if the frames have several sizes, or no table is found.
    """
    first = frames[0]
    for frame in frames[1:]:
        if frame.values.shape != first.values.shape:
            sizes = f"{frame.values.shape[::-1]} px, the first frame has {first.values.shape[::-1]}"
            raise InputError(f"{frame.source}: {sizes}")
    depth = mean_depth([metric_depth(frame, unit) for frame in frames])
    image = pinhole_image(depth, known, first.source)
    table = find_table(image, first.source)
    _check_no_ray_lengths(depth, known, table, first.source)
    return image, table


def _check_no_ray_lengths(depth: np.ndarray, known: Intrinsics, table: Table, source: str) -> None:
    """Raise InputError if far more pixels lie on a table when depths (H, W) [m] are read as lengths of rays."""
    if table.share_of_returns >= BENT_SHARE:
        return
    v, u = np.indices(depth.shape)
    lengths = np.sqrt(((u - known.cx) / known.fx) ** 2 + ((v - known.cy) / known.fy) ** 2 + 1)  # of rays of depth 1
    try:
        flat = find_table(pinhole_image((depth / lengths).astype(np.float32), known, source), source)
    except InputError:
        return
    if flat.share_of_returns >= max(BENT_SHARE, FLATTER * table.share_of_returns):
        raise InputError(
            f"{source}: the table fills {100 * table.share_of_returns:.0f} % of the depths, but "
            f"{100 * flat.share_of_returns:.0f} % if they are lengths of rays: divide them by sqrt(x² + y² + 1) with "
            "x = (u - cx) / fx, y = (v - cy) / fy"
        )


def _check_assumed_unit(source: str, unit: float, distance: float, kit: tuple[float, float]) -> None:
    """Raise InputError if a unit that nothing states makes a scene so large that a finer unit fits better.

    unit: [m] that 1 was taken for. With it, distance: of the camera from the table [m]; kit: its sides [m], the shorter
    first.
    """
    if distance <= FAR_TABLE and kit[1] <= LARGE_KIT:
        return
    ratios = {other: other / unit for other in FINE_UNITS}
    fits = [
        f"--depth-scale {other:g} ({_scene_text(ratio * distance, ratio * kit[0], ratio * kit[1])})"
        for other, ratio in ratios.items()
        if NEAR_TABLE <= ratio * distance <= FAR_TABLE and SMALL_KIT <= ratio * kit[1] <= LARGE_KIT
    ]
    if fits:
        raise InputError(
            f"{source}: taken in mm, which nothing states, {_scene_text(distance, *kit)}; give --depth-scale {unit:g} "
            f"if that is so, or {' or '.join(fits)}"
        )


def _scene_text(distance: float, short: float, long: float) -> str:
    return f"camera {100 * distance:.0f} cm above the table, kit {1e3 * short:.0f} x {1e3 * long:.0f} mm"


def _with_kit_first(bodies: list[SeenBody], options: ImportOptions, source: str, table: Table) -> list[SeenBody]:
    """Bodies with the kit first, the others as they are."""
    kit = options.kit
    if not bodies:
        raise InputError(
            f"{source}: nothing higher than {1e3 * sure_height(table):.1f} mm stands on the table "
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
