"""What a method seats in images of an own camera: simulated ones, saved as users save them and imported.

    python bench/quality/own_images.py data/kit1000 --scenes 12 --out results/own-images.json

The d415 looks at each scene of `val` from four places, with hand-eye poses that are off as the recorded ones are. The
first image is the recorded one, which shows each part and its cavity. Each is saved as a 1 mm PNG and imported with
networks that find its masks. The method predicts by the images of the first one, two and four places, with the guess of
the query (task snap) and without one (place).
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from PIL import Image
from tqdm import tqdm

from bench.measured import run
from benchmark.measurements import Column, Measurement, rate
from kit1000.capture.importing import imported_scenes
from kit1000.capture.options import ImportOptions
from kit1000.capture.own_folder import write_own_folder
from kit1000.capture.own_scene import OwnScene
from kit1000.dataset.json_rows import pose_row
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.metrics import mean_iou, seatings
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor, method_of
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.render import render
from kit1000.sim.sensors import sense
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, Query, View

SENSOR, SPLIT, UNIT = "d415", "val", 1e-3  # the last: [m] of the depths in a file
PLACES = (1, 2, 4)
TASKS = ("snap", "place")
COUNTED = (
    Column("n", "images"),
    Column("right", "number of parts right, %", 1, True),
    Column("fewer", "too few"),
    Column("more", "too many"),
    Column("kits", "IoU of the kits, median", 2),
)
SEATED = (
    Column("task", "task"),
    Column("places", "places"),
    Column("n", "n"),
    Column("seated", "seated, %", 1, True),
)

Row = dict[str, Any]


@dataclass(frozen=True)
class OwnImages:
    """Import simulated images, predict on them, and print what is seated."""

    data: tyro.conf.Positional[Path]
    """Dataset folder with ground truth."""
    scenes: int = 12
    """Number of scenes, the first of the split."""
    method: str = "registration-completed"
    """The method that predicts; one of known shapes gets those of the scene."""
    out: Path | None = None
    """JSON file of the tables, such as results/own-images.json."""


def main(options: OwnImages) -> None:
    """Import, predict, print."""
    dataset = Dataset(options.data)
    measurement, images, motions = Measurement.begin(dataset), list[Row](), list[Row]()
    for scene in tqdm(list(dataset.split(SPLIT, truth=True))[: options.scenes], desc="scenes", disable=None):
        with tempfile.TemporaryDirectory() as folder:
            views = [view_from(scene, place) for place in range(max(PLACES))]
            own = imported([view for view, _ in views], Path(folder))
            images += [counted(one, labels) for one, (_, labels) in zip(own, views, strict=True)]
            motions += seated(options.method, scene, own, views[0][1], Path(folder))
    off = [row["off"] for row in images]
    title = f"Imported images of {options.scenes} scenes of {SPLIT}"
    measurement.table("images", title, *COUNTED).add(
        n=len(off),
        right=rate([each == 0 for each in off]),
        fewer=sum(each < 0 for each in off),
        more=sum(each > 0 for each in off),
        kits=float(np.median([row["kits"] for row in images])),
    )
    table = measurement.table("seated", f"Motions by {options.method}, seated in the robot's frame", *SEATED)
    for task, places in product(TASKS, PLACES):
        found = [row["seated"] for row in motions if (row["task"], row["places"]) == (task, places)]
        table.add(task=task, places=places, n=len(found), seated=rate(found))
    measurement.report(options.out)


def view_from(scene: RecordedScene, place: int) -> tuple[View, np.ndarray]:
    """The image of a scene from a place, with the pose that the robot believes, and its true masks (H, W).

    From the first place it is the recorded one.
    """
    if place == 0:
        recorded = scene.labelled_depth(SENSOR)
        return recorded.view, recorded.labels
    rng = stream(0, "own-images", scene.id, place)
    pose = draw_primary_pose(rng)
    frame = render(CAMERA, pose, scene.bodies(), threads=1)
    return sense(SENSOR, View(CAMERA, pose, frame.depth), rng, 1), np.maximum(frame.body_ids - 1, 0)


def imported(views: Sequence[View], folder: Path) -> list[OwnScene]:
    """The import of images, each saved with its pose."""
    for number, view in enumerate(views):
        Image.fromarray(np.rint(view.depth / UNIT).astype(np.uint16)).save(folder / f"{number}.png")
        (folder / f"{number}.json").write_text(json.dumps(pose_row(view.world_from_camera)), encoding="utf-8")
    return imported_scenes(
        ImportOptions(
            sources=tuple(folder / f"{number}.png" for number in range(len(views))),
            out=folder / "own",
            intrinsics=tuple(str(value) for value in (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)),
            device="D415",
            stream="raw",
            world_from_camera=tuple(folder / f"{number}.json" for number in range(len(views))),
            networks=True,
            one_scene=True,
        )
    )


def counted(own: OwnScene, labels: np.ndarray) -> Row:
    """The number of parts too many, and the IoU of the kits, in an import. labels: (H, W) the true masks."""
    kits = ((image == ASSEMBLY_LABEL).astype(np.uint8) for image in (own.image.labels, labels))
    seen = np.unique(labels[labels >= FIRST_PART_LABEL])
    return {"off": len(own.parts) - len(seen), "kits": mean_iou(*kits)}


def seated(
    method: str, scene: RecordedScene, own: Sequence[OwnScene], labels: np.ndarray, folder: Path
) -> Iterator[Row]:
    """Whether each motion is, by task and number of places. labels: (H, W) the true masks of the first image."""
    dataset, homes = scene.split.dataset, _homes(own[0], labels)
    chosen = method_of(method)
    shapes = scene.shapes if chosen.reads == "shapes" else None
    for places in PLACES:
        out = folder / f"own-{places}"
        write_own_folder(out, own[:places], dataset.summary["config"]["clearance"], one_scene=places > 1)
        data = Dataset(out)
        predictor, known = make_predictor(chosen, data, 0), next(iter(data.split("test"))).queries
        for query in scene.queries:
            task = query.track.removesuffix(f"-{SENSOR}")
            if query.sensor == SENSOR and task in TASKS:
                found = _imported_query(query, known, homes)
                motion = Pose.identity() if found is None else predictor(found, shapes).goal_from_now
                ok = seatings(Pose.stack([motion]), [scene.truth_of(query.id)], dataset.geometry).seated[0]
                yield {"task": task, "places": places, "seated": bool(ok)}


def _homes(own: OwnScene, labels: np.ndarray) -> Mapping[int, int]:
    """The true part that most pixels of each imported part show, by the index of the imported part."""
    homes = {}
    for part in range(len(own.parts)):
        counts = np.bincount(labels[own.image.labels == FIRST_PART_LABEL + part], minlength=FIRST_PART_LABEL + 1)
        if counts[FIRST_PART_LABEL:].any():
            homes[part] = int(counts[FIRST_PART_LABEL:].argmax())
    return homes


def _imported_query(query: Query, known: Sequence[Query], homes: Mapping[int, int]) -> Query | None:
    """The query of an import about the part of a recorded one, with its guess; None if the import has no such part."""
    found = (each for each in known if each.track == query.track and homes.get(each.part) == query.part)
    return next((replace(each, guess=query.guess) for each in found), None)


if __name__ == "__main__":
    run(main, OwnImages, __doc__)
