"""Errors of known shapes that `kit1000 label` registers to noisy depth images.

    python bench/quality/labelling.py data/tiny --splits test train val --out results/labelling.json

The noisy image is rounded to a unit and labelled without its truth, by masks that are found in it. Poses are then
compared with the truth in the camera frame, up to the symmetry of the shape. The true camera is that of the ideal
image. "Relative" is the pose of a part relative to the kits; a score depends on it alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time
from typing import Any, Literal

import numpy as np
import tyro
from tqdm import tqdm

from bench.measured import run, timed
from benchmark.measurements import Column, Measurement, estimate, rate
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.known_kits import KITS
from kit1000.known_shapes.registration import RegisteredBody, RegisteredScene, register_scene, registered_from
from kit1000.known_shapes.scene_search import SceneSearch
from kit1000.known_shapes.shapes import KnownShape, ShapeDistance, StandingShape
from kit1000.known_shapes.support import seen_support
from kit1000.mesh import Mesh
from kit1000.metrics import seatings
from kit1000.perception.calibration.depth_scale import stated_scale
from kit1000.perception.segmentation.instances import segmented
from kit1000.perception.segmentation.predicted_masks import mask_networks
from kit1000.perception.sensor_facts import SensorFacts, sensor_of, simulated_sensor
from kit1000.pose import Pose
from kit1000.sim.sensors import DEPTH_GRID
from kit1000.symmetry import Symmetry
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View

SENSOR = "d415"
MM = 1e3
OFF = 2e-3  # [m] larger error, with which a body may not pass as certain
ERRORS = (
    Column("what", "body"),
    Column("n", "n"),
    Column("position", "mm, median", 2),
    Column("position_90", "mm, 90 %", 2),
    Column("rotation", "°, median", 2),
    Column("relative", "mm to the kits, median", 2),
)
SURE = (
    Column("what", "body"),
    Column("n", "n"),
    Column("sure", "certain"),
    Column("sure_off", "certain and over 2 mm off"),
    Column("worst", "worst of the certain, mm", 2),
    Column("wrong", "over 2 mm off"),
)
SEATED = (
    Column("what", "motions by"),
    Column("n", "n"),
    Column("seated", "seated, %", 1, True),
    Column("sure", "certain"),
    Column("sure_seated", "seated of these"),
)
SCALE = (
    Column("n", "scenes"),
    Column("true", "scale error, %, mean size", 3),
    Column("left", "left after labelling, %", 3),
    Column("before", "cost at the part before, mm, median", 2),
    Column("after", "after, mm, median", 2),
    Column("motion", "cost to a motion from part to kits, mm, median", 2),
    Column("seconds", "CPU s a scene", 1),
)

Row = dict[str, Any]


@dataclass(frozen=True)
class Labelling:
    """Label scenes of a dataset without their truth, and compare with it."""

    data: tyro.conf.Positional[Path]
    """Dataset folder with ground truth and views of the d415."""
    splits: tuple[str, ...] = ("test",)
    """Splits of the scenes."""
    scenes: int | None = None
    """Number of scenes of each split; all when absent."""
    unit_mm: float = 1.0
    """Unit of the depths."""
    masks: Literal["found", "given"] = "found"
    """Masks that are found in the depth image, as an import finds them, or those of the dataset."""
    stated_pose: bool = False
    """With the recorded pose of the camera, whose height is off by 0.9 mm: it tells the depth scale."""
    out: Path | None = None
    """JSON file of the tables, such as results/labelling.json."""


def main(options: Labelling) -> None:
    """Label the scenes and print the tables."""
    dataset, measurement, rows = Dataset(options.data), Measurement.begin(Dataset(options.data)), []
    chosen = [scene for split in options.splits for scene in list(dataset.split(split, truth=True))[: options.scenes]]
    for recorded in tqdm(chosen, desc="scenes", unit="", disable=None):
        image = rounded_image(recorded, options.unit_mm / MM)
        masked = with_found_masks(image) if options.masks == "found" else image
        rows += list(scene_rows(recorded, masked, options.stated_pose))
    pose = ", camera's pose stated" if options.stated_pose else ""
    setting = f"{len(chosen)} scenes, depths in {options.unit_mm:g} mm, masks {options.masks}{pose}"
    add_tables(measurement, rows, setting)
    measurement.report(options.out)


def rounded_image(recorded: RecordedScene, unit: float) -> LabelledDepth:
    """The noisy image of a scene with its masks, rounded to a unit [m] as by a camera's driver."""
    image = recorded.labelled_depth(SENSOR)
    steps = np.float32(unit / DEPTH_GRID)
    depth = np.rint(np.rint(image.view.depth / np.float32(unit)) * steps) * np.float32(DEPTH_GRID)
    view = View(image.view.camera, image.view.world_from_camera, depth)
    return LabelledDepth(view, image.labels)


def with_found_masks(image: LabelledDepth) -> LabelledDepth:
    """The image with masks from its depths alone."""
    restorer, finder = mask_networks()
    return LabelledDepth(image.view, segmented(image.view, simulated_sensor(SENSOR), 1.0, restorer, finder))


def scene_rows(recorded: RecordedScene, image: LabelledDepth, stated_pose: bool = False) -> Iterator[Row]:
    """The errors of each body of a scene; all rows hold those of the depth scale."""
    (kits, kits_pose), *parts = recorded.bodies()[1:]
    sensor = sensor_of(recorded.split.dataset.summary, SENSOR)
    if stated_pose:
        sensor = replace(sensor, height_ratio=-seen_support(image).offset / image.view.world_from_camera.xyz[2])
    shown = set(np.unique(recorded.labelled_depth(SENSOR).labels).tolist())
    names = {f"part {i}": i for i in range(len(parts)) if FIRST_PART_LABEL + i in shown}
    shapes = [KnownShape.of(name, parts[i][0]) for name, i in names.items()]
    seconds, found = timed(lambda: register_scene(image, sensor, KnownShape.upright(KITS, kits), shapes), process_time)
    camera_from_world = recorded.view("ideal").world_from_camera.inverse()
    true_scale, kits_found = _true_scale(recorded), found.camera_from_body(found.bodies[0])
    bodies = [KnownShape.upright(KITS, kits), *shapes]
    poses = [camera_from_world @ pose for pose in (kits_pose, *(parts[i][1] for i in names.values()))]
    near = _refined_truth(image, sensor, bodies, poses, true_scale)
    from_truth = {body.name: body for body in near.bodies}
    for body in found.bodies:
        mesh, pose = (kits, kits_pose) if body.name == KITS else parts[names[body.name]]
        true, true_kits = camera_from_world @ pose, camera_from_world @ kits_pose
        symmetry = Symmetry.none() if body.name == KITS else _symmetry(recorded, names[body.name])
        row = _body_row(body, found, mesh, true, symmetry)
        middle = mesh.centroid
        seen = kits_found.inverse().apply(found.camera_from_body(body).apply(middle))
        relative = float(np.linalg.norm(seen - true_kits.inverse().apply(true.apply(middle))))
        distance = float(np.linalg.norm(true.xyz))
        motion = float(np.linalg.norm(true.xyz - true_kits.xyz))
        if body.name != KITS:
            row |= _seated(recorded, names[body.name], found, body, true_scale)
            near_row = _seated(recorded, names[body.name], near, from_truth[body.name], true_scale)
            row |= {f"{key}_from_truth": value for key, value in near_row.items()}
        yield row | {
            "scene": recorded.id,
            "relative": relative * MM,
            "scale_true": true_scale - 1,
            "scale_left": found.scale / true_scale - 1,
            "distance": distance,
            "motion": motion,
            "seconds": seconds,
        }


def _refined_truth(
    image: LabelledDepth, sensor: SensorFacts, shapes: Sequence[KnownShape], poses: Sequence[Pose], scale: float
) -> RegisteredScene:
    """The scene refined from the true poses: what the search loses is the rest."""
    search = SceneSearch(DisparityImage.of(image, sensor, seen_support(image)), image.labels)
    support = search.image.support
    start = (StandingShape.by_pose(shape, support, pose, scale) for shape, pose in zip(shapes, poses, strict=True))
    return registered_from(search, list(start), stated_scale(sensor, -support.offset))


def _body_row(body: RegisteredBody, found: RegisteredScene, mesh: Mesh, true: Pose, symmetry: Symmetry) -> Row:
    pose = found.camera_from_body(body)
    error = true.inverse() @ pose
    surface = ShapeDistance(mesh).between(true, pose)
    position = float(np.linalg.norm(error.apply(mesh.centroid) - mesh.centroid))
    rotation = float(np.degrees(symmetry.error(pose.wxyz, true.wxyz)))
    doubts = found.doubts(body)
    return {
        "what": "kits" if body.name == KITS else "part",
        "position": position * MM,
        "rotation": rotation,
        "surface": surface * MM,
        "sure": not doubts,
        "doubts": list(doubts),
    }


def _seated(recorded: RecordedScene, index: int, found: RegisteredScene, body: RegisteredBody, scale: float) -> Row:
    """Whether the motions from the part's pose to its goal in the kits are seated, by the scale found and the true one.

    Empty if the part has no query.
    """
    query = next((each for each in recorded.queries if each.part == index), None)
    if query is None:
        return {}
    part_id = recorded.scene.bodies[1 + index].id
    mounts = recorded.split.dataset.geometry.assembly(recorded.scene.bodies[0].id).mounts
    mount = next(mount for mount in mounts if mount.kit.slot.part_id == part_id)
    goals = mount.assembly_from_kit @ mount.kit.slot.goals
    world_from_camera, truth = recorded.view("ideal").world_from_camera, recorded.truth_of(query.id)
    motions = Pose.stack([replace(found, scale=by).surest_motion(body, goals) for by in (found.scale, scale)])
    in_world = world_from_camera @ motions @ world_from_camera.inverse()
    both = seatings(in_world, [truth, truth], recorded.split.dataset.geometry).seated
    return {
        "seated": bool(both[0]),
        "seated_true_scale": bool(both[1]),
        "sure_motion": not found.motion_doubts(body, motions[0]),
    }


def _true_scale(recorded: RecordedScene) -> float:
    """The median ratio of measured and true depth in the image of a scene."""
    measured, ideal = recorded.view(SENSOR).depth, recorded.view("ideal").depth
    both = (measured > 0) & (ideal > 0)
    return float(np.median(measured[both] / ideal[both]))


def _symmetry(recorded: RecordedScene, index: int) -> Symmetry:
    part_id = recorded.scene.bodies[1 + index].id
    return recorded.split.dataset.geometry.part(part_id).symmetry


def add_tables(measurement: Measurement, rows: Sequence[Row], setting: str) -> None:
    """Add the tables of errors, of bodies that are reported as certain, and of the depth scale."""
    errors = measurement.table("errors", f"Poses of known shapes; {setting}", *ERRORS)
    sure = measurement.table("sure", f"Bodies whose pose the image alone determines; {setting}", *SURE)
    for what in ("kits", "part"):
        own = [row for row in rows if row["what"] == what]
        if not own:
            continue
        position, surface = np.array([r["position"] for r in own]), np.array([r["surface"] for r in own])
        off = np.maximum(position, surface) > OFF * MM
        passed = np.array([r["sure"] for r in own])
        errors.add(
            what=what,
            n=len(own),
            position=np.median(position),
            position_90=np.quantile(position, 0.9),
            rotation=np.median([r["rotation"] for r in own]),
            relative=np.median([r["relative"] for r in own]) if what == "part" else None,
        )
        worst = np.maximum(position, surface)[passed].max() if passed.any() else None
        sure.add(
            what=what, n=len(own), sure=int(passed.sum()), sure_off=int((passed & off).sum()), worst=worst,
            wrong=int(off.sum()),
        )  # fmt: skip
    tried = [row for row in rows if "seated" in row]
    seated = measurement.table("seated", f"Parts seated by the poses of part and kits; {setting}", *SEATED)
    for what, ending in (("poses found", ""), ("poses refined from the true ones", "_from_truth")):
        for scale_of, key in (("", "seated"), (", true depth scale", "seated_true_scale")):
            won, certain = (np.array([row[name + ending] for row in tried], bool) for name in (key, "sure_motion"))
            counts = {"sure": int(certain.sum()), "sure_seated": int((certain & won).sum())}
            seated.add(what=what + scale_of, n=len(won), seated=rate(won), **counts)
    scale = measurement.table("scale", f"The depth scale of the camera; {setting}", *SCALE)
    parts = [row for row in rows if row["what"] == "part"]
    true, left = (np.abs([row[key] for row in parts]) for key in ("scale_true", "scale_left"))
    reach, motion = (np.array([row[key] for row in parts]) * MM for key in ("distance", "motion"))
    scale.add(
        n=len({row["scene"] for row in rows}),
        true=100 * estimate(true)["mean"],
        left=100 * estimate(left)["mean"],
        before=np.median(true * reach),
        after=np.median(left * reach),
        motion=np.median(true * motion),
        seconds=np.mean([row["seconds"] for row in rows]),
    )


if __name__ == "__main__":
    run(main, Labelling, __doc__)
