"""Quality of the scenes that `kit1000 import` makes of simulated images in users' file formats.

    python bench/quality/own_camera.py data/kit1000 --scenes 13
    python bench/quality/own_camera.py data/kit1000 --scenes 13 --seat

The d415 image of each scene is saved as a user would save it, and imported. Table, masks and depths of the import are
compared with the scene. With --seat, a method predicts on the imported scene, on the original with predicted masks, and
with guesses on images from up to four places that are imported together.
"""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import tyro
from PIL import Image

from bench.measured import measured_dataset, run
from bench.quality.camera_conditions import AZIMUTHS, orbited
from benchmark.measurements import Column, Measurement, Table, rate
from kit1000.capture.importing import imported_scenes
from kit1000.capture.mask_networks import networks_available
from kit1000.capture.options import ImportOptions
from kit1000.capture.own_folder import write_own_folder
from kit1000.capture.own_scene import OwnScene
from kit1000.dataset.mcap_io import ObservationWriter
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.dataset.scene_data import Observation
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.perception.calibration.table import table_plane
from kit1000.pose import Pose
from kit1000.prediction.catalog import Method
from kit1000.prediction.making import PREDICTED_MASKS, make_predictor, method_of
from kit1000.rng import stream
from kit1000.sim.cameras import PRIMARY_TARGET
from kit1000.sim.render import render
from kit1000.sim.sensors import sense
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Query, Truth, View

SENSOR, TRACK, SNAP_TRACK = "d415", "place-d415", "snap-d415"
PLACES = (1, 2, 4)  # numbers of images, from the first of AZIMUTHS
MM, FINE = 1e-3, 1e-4  # [m] units
Format = Literal["mm-png", "fine-png", "npy", "foxglove"]
TRIP = (
    Column("format", "format"),
    Column("n", "scenes"),
    Column("distance", "table off, largest mm", 2),
    Column("angle", "largest degrees", 3),
    Column("depth", "depth off, largest mm", 3),
    Column("kit", "IoU of kits, %", 1, True),
    Column("parts", "IoU of parts, %", 1, True),
    Column("counted", "number of parts right, %", 1, True),
)
SEAT = (
    Column("image", "image"),
    Column("n", "n"),
    Column("seated", "seated, %", 1, True),
    Column("position", "position, median mm", 2),
)


@dataclass(frozen=True)
class OwnCamera:
    """Import simulated images, and print the errors of the imported scenes."""

    data: tyro.conf.Positional[Path | None] = None
    """Dataset folder with ground truth; without one a tiny dataset is generated."""
    scenes: int = 13
    """Number of scenes, those that have a query of place-d415, over all splits."""
    formats: tuple[Format, ...] = ("mm-png", "fine-png", "npy", "foxglove")
    """Files in which the images are saved."""
    method: str = "registration-completed"
    """Method that predicts with --seat."""
    seat: bool = False
    """Whether to predict on the imported scenes, and on the original ones with predicted masks."""
    out: Path | None = None
    """JSON file for the tables, such as results/own-camera.json."""


class Trip(NamedTuple):
    """A scene after the import."""

    distance: float
    """[m]"""
    angle_deg: float
    depth: float
    """[m]"""
    kit: float
    parts: float
    counted: bool


def main(options: OwnCamera) -> None:
    """Import, compare, print."""
    with measured_dataset(options.data) as (dataset, folder):
        measurement = Measurement.begin(dataset)
        scenes = _scenes(dataset, options.scenes)
        trips = measurement.table("round-trip", "Simulated d415 images saved, and imported again", *TRIP)
        for name in options.formats:
            _add_trips(trips, name, [_trip(scene, _imported(scene, name, folder)) for scene in scenes])
        if options.seat:
            seated = measurement.table("seated", f"{options.method} on {TRACK}", *SEAT)
            _add_seated(seated, options, dataset, scenes, folder)
            places = measurement.table("places", f"{options.method} on {SNAP_TRACK}, with hand-eye poses", *SEAT)
            _add_places(places, options, dataset, scenes, folder)
        measurement.report(options.out)


def _scenes(dataset: Dataset, count: int) -> list[RecordedScene]:
    """The first scenes with a query of TRACK, of `val` as far as it has them: the networks learned from `train`."""
    names = [name for name in ("val", "test-all", "train") if dataset.shards(name.partition("-")[0])]
    scenes = (scene for name in names for scene in dataset.split(name, truth=True))
    return [scene for scene in scenes if any(query.track == TRACK for query in scene.queries)][:count]


def _imported(scene: RecordedScene, name: str, folder: Path) -> OwnScene:
    """The scene that is imported from its image, saved as a format has it."""
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        source = Path(temporary)
        intrinsics = _saved(scene, name, source)
        saved = next(path for path in sorted(source.iterdir()) if path.suffix != ".json")
        (own,) = imported_scenes(_options((saved,), source / "out", intrinsics, device="D415", stream="raw"))
        return own


def _options(sources: Sequence[Path], out: Path, intrinsics: tuple[str, ...], **values: Any) -> ImportOptions:
    """The options of an import whose masks are cut back by the networks, if torch is there."""
    networks = networks_available()
    return ImportOptions(sources=tuple(sources), out=out, intrinsics=intrinsics, networks=networks, **values)


def _saved(scene: RecordedScene, name: str, folder: Path) -> tuple[str, ...]:
    """Write the image of a scene; returns the intrinsics to give."""
    view = scene.view(SENSOR)
    camera = view.camera
    numbers = [camera.fx, camera.fy, camera.cx, camera.cy]
    if name == "foxglove":
        with ObservationWriter(folder / "scene.mcap") as writer:
            writer.add(Observation(scene.id, {SENSOR: view}))
        return ()
    if name == "npy":
        np.save(folder / "depth.npy", view.depth)
    else:
        (folder / "depth.png").write_bytes(_png(view, MM if name == "mm-png" else FINE))
    row = dict(zip(("fx", "fy", "ppx", "ppy"), numbers, strict=True)) | {"width": camera.width, "height": camera.height}
    units = {"mm-png": {"depth_units": MM}, "fine-png": {"depth_units": FINE}, "npy": {}}[name]
    (folder / "camera.json").write_text(json.dumps(row | units), encoding="utf-8")
    return (str(folder / "camera.json"),)


def _png(view: View, unit: float) -> bytes:
    """A PNG of the depths in a unit [m], 16 bits each."""
    file = io.BytesIO()
    Image.fromarray(np.rint(view.depth / unit).astype(np.uint16)).save(file, "PNG")
    return file.getvalue()


def _trip(scene: RecordedScene, own: OwnScene) -> Trip:
    """The imported scene compared with the original; the true table is the plane of the image's true background."""
    image = scene.labelled_depth(SENSOR)
    plane = table_plane(image.view, image.labels)
    assert plane is not None, "the scenes show their table"
    away = np.sqrt(plane.coefficients @ plane.coefficients)
    angle = float(np.degrees(np.arccos(np.clip(-plane.coefficients @ own.table.up / away, -1, 1))))
    depth = float(np.abs(own.image.view.depth - image.view.depth).max())
    homes = _homes(scene, own)
    parts = [max((_iou(image.labels == label, own.image.labels == FIRST_PART_LABEL + part)
                  for part, home in homes.items() if home == label - FIRST_PART_LABEL), default=0.0)
             for label in range(FIRST_PART_LABEL, int(image.labels.max()) + 1)]  # fmt: skip
    kit = _iou(image.labels == ASSEMBLY_LABEL, own.image.labels == ASSEMBLY_LABEL)
    counted = int(image.labels.max()) == int(own.image.labels.max())
    return Trip(own.table.distance - 1 / float(away), angle, depth, kit, float(np.mean(parts)), counted)


def _iou(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / max((one | other).sum(), 1))


def _homes(scene: RecordedScene, own: OwnScene) -> dict[int, int]:
    """The original part that most pixels of each imported part show, by the index of the imported part."""
    labels, homes = scene.labelled_depth(SENSOR).labels, {}
    for part in range(len(own.parts)):
        counts = np.bincount(labels[own.image.labels == FIRST_PART_LABEL + part], minlength=FIRST_PART_LABEL + 1)
        if counts[FIRST_PART_LABEL:].any():
            homes[part] = int(counts[FIRST_PART_LABEL:].argmax())
    return homes


def _add_trips(table: Table, name: str, trips: Sequence[Trip]) -> None:
    table.add(
        format=name,
        n=len(trips),
        distance=1e3 * max(abs(trip.distance) for trip in trips),
        angle=max(trip.angle_deg for trip in trips),
        depth=1e3 * max(trip.depth for trip in trips),
        kit=float(np.mean([trip.kit for trip in trips])),
        parts=float(np.mean([trip.parts for trip in trips])),
        counted=rate([trip.counted for trip in trips]),
    )


def _add_seated(
    table: Table, options: OwnCamera, dataset: Dataset, scenes: Sequence[RecordedScene], folder: Path
) -> None:
    """Predictions on original images with predicted masks, and on imported ones, for the same queries."""
    found: dict[str, list[Pose]] = {"original, predicted masks": [], "imported, 1 mm PNG": []}
    truths = []
    method, clearance = method_of(options.method), dataset.summary["config"]["clearance"]
    original = make_predictor(method_of(f"{options.method}{PREDICTED_MASKS}"), dataset, 0)
    for number, scene in enumerate(scenes):
        own = _imported(scene, "mm-png", folder)
        write_own_folder(folder / f"own-{number}", [own], clearance)
        queries = [query for query in scene.queries if query.track == TRACK]
        motions = _own_motions(scene, own, queries, Dataset(folder / f"own-{number}"), method)
        world_from_own = scene.view("ideal").world_from_camera @ own.world.world_from_camera.inverse()
        truths += [scene.truth_of(query.id) for query in queries]
        found["original, predicted masks"] += [original(query, None).goal_from_now for query in queries]
        found["imported, 1 mm PNG"] += [world_from_own @ motion @ world_from_own.inverse() for motion in motions]
    for name, poses in found.items():
        _add_motions(table, name, poses, truths, dataset)


def _add_places(
    table: Table, options: OwnCamera, dataset: Dataset, scenes: Sequence[RecordedScene], folder: Path
) -> None:
    """Predictions with guesses, in the world of the hand-eye poses, by images from one place and from several."""
    truths, clearance = list[Truth](), dataset.summary["config"]["clearance"]
    found: dict[int, list[Pose]] = {count: [] for count in PLACES}
    for number, scene in enumerate(scenes):
        several = _imported_from_places(scene, folder)
        queries = [query for query in scene.queries if query.track == SNAP_TRACK]
        truths += [scene.truth_of(query.id) for query in queries]
        for count, poses in found.items():
            out = folder / f"places-{number}-{count}"
            write_own_folder(out, several[:count], clearance, one_scene=count > 1)
            poses += _own_motions(scene, several[0], queries, Dataset(out), method_of(options.method))
    for count, poses in found.items():
        _add_motions(table, f"{count} place{'s' if count > 1 else ''}", poses, truths, dataset)


def _add_motions(table: Table, name: str, poses: Sequence[Pose], truths: Sequence[Truth], dataset: Dataset) -> None:
    """Add the row of predicted motions, of which the truth is known."""
    motions = Pose.stack(poses)
    errors = pose_errors(motions, Targets.of(truths, lambda part: dataset.geometry.part(part).mesh.vertices))
    seated = seatings(motions, truths, dataset.geometry).seated
    table.add(image=name, n=len(truths), seated=rate(seated), position=1e3 * float(np.median(errors.position)))


def _own_motions(
    scene: RecordedScene, own: OwnScene, queries: Sequence[Query], imported: Dataset, method: Method
) -> list[Pose]:
    """The motion for each query about a scene, predicted on its import; no motion if the import has no such part."""
    recorded, homes = next(iter(imported.split("test"))), _homes(scene, own)
    predictor, motions = make_predictor(method, imported, 0), list[Pose]()
    for query in queries:
        same = (each for each in recorded.queries if (each.track, homes.get(each.part)) == (query.track, query.part))
        found = next(same, None)
        answer = None if found is None else predictor(replace(found, guess=query.guess), None)
        motions.append(Pose.identity() if answer is None else answer.goal_from_now)
    return motions


def _imported_from_places(scene: RecordedScene, folder: Path) -> list[OwnScene]:
    """The import of images from several places, each with the pose that the robot believes the camera to have."""
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        sources, poses = [], []
        for number, azimuth in enumerate(AZIMUTHS):
            view, stem = _view_from(scene, azimuth, number), Path(temporary) / str(number)
            stem.with_suffix(".png").write_bytes(_png(view, MM))
            pose = view.world_from_camera
            row = {"wxyz": pose.wxyz.tolist(), "xyz": pose.xyz.tolist()}
            stem.with_suffix(".json").write_text(json.dumps(row), encoding="utf-8")
            sources.append(stem.with_suffix(".png"))
            poses.append(stem.with_suffix(".json"))
        camera = scene.view(SENSOR).camera
        intrinsics = tuple(str(number) for number in (camera.fx, camera.fy, camera.cx, camera.cy))
        given = {"device": "D415", "stream": "raw", "world_from_camera": tuple(poses), "one_scene": True}
        return imported_scenes(_options(sources, Path(temporary) / "out", intrinsics, **given))


def _view_from(scene: RecordedScene, azimuth: float, number: int) -> View:
    """The image from a place: the recorded one, or from an azimuth [rad] about the middle of the table."""
    if number == 0:
        return scene.view(SENSOR)
    ideal = scene.view("ideal")
    pose = orbited(ideal.world_from_camera, np.array(PRIMARY_TARGET), azimuth)
    depth = render(ideal.camera, pose, scene.bodies(), threads=1).depth
    return sense(SENSOR, View(ideal.camera, pose, depth), stream(0, "own-camera", scene.id, number), 1)


if __name__ == "__main__":
    run(main, OwnCamera, __doc__)
