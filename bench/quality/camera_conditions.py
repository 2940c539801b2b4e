"""Share of parts that a method seats under other conditions of the camera: sensor, frames, distance, places.

    python bench/quality/camera_conditions.py data/kit1000 --limit 40 --out results/camera-conditions.json

Each condition differs from the base, which is one frame of the d415 at the camera pose of the scene. Noise is sampled
again with a fixed seed. For another distance the scene is rendered again: the camera keeps its direction and looks at
the middle between the part and its true goal. For several places the camera moves about the vertical axis through that
middle; each image has its own noise and its own error of the camera pose. Methods get masks and an image as usual,
shapes if they read them, and no truth. An image in which the part or its goal is outside the view is left out, and so
is a query without any image; therefore n differs between distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import tyro

from bench.measured import run, spread
from benchmark.measurements import Column, Measurement, Table, rate
from kit1000.camera import look_at
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.metrics import Targets, pose_errors, seatings
from kit1000.parallel import local_engine
from kit1000.perception.segmentation.predicted_masks import with_predicted_masks
from kit1000.perception.sensor_facts import simulated_sensor
from kit1000.pose import Pose
from kit1000.prediction.making import make_predictor, method_of
from kit1000.predictor import PredictedMotion
from kit1000.queries.pivots import part_pivots
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, in_view
from kit1000.sim.render import render
from kit1000.sim.sensors import sense
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, Truth, View

CONFIDENT = 0.8  # least confidence of a prediction that the table counts as confident
LEAST_PIXELS = 200  # of a part in an image that is rendered again
AZIMUTHS = tuple(np.radians((0.0, 40.0, 90.0, 180.0)).tolist())  # [rad] of the places, about the first


class Condition(NamedTuple):
    """A condition under which images are taken."""

    sensor: str = "d415"
    frames: int = 1
    distance: float | None = None
    """[m] from the middle between part and goal; None: as recorded."""
    places: int = 1
    """Number of places from which the camera looks, the first of AZIMUTHS."""

    @property
    def name(self) -> str:
        """Words for a table."""
        frames = "" if self.sensor == "ideal" else f", {self.frames} frame{'s' if self.frames > 1 else ''}"
        near = f", {self.distance} m" if self.distance else ""
        return f"{self.sensor}{frames}{near}" + (f", {self.places} places" if self.places > 1 else "")


BASE = Condition()
CONDITIONS = (
    BASE,
    *(BASE._replace(frames=frames) for frames in (10, 30)),
    *(BASE._replace(distance=distance) for distance in (0.45, 0.6, 0.8)),
    Condition("d415", 30, 0.45),
    *(BASE._replace(places=places) for places in (2, 3, 4)),
    BASE._replace(frames=30, places=2),
    *(Condition("d415", 30, 0.45, places) for places in (2, 4)),
    Condition("photoneo"),
    Condition("ideal"),
)


class Answer(NamedTuple):
    """The prediction of a method for a query, and its ground truth."""

    motion: Pose
    confidence: float
    truth: Truth


@dataclass(frozen=True)
class CameraConditions:
    """Predict for queries under several conditions of the camera, and print the shares of parts seated."""

    data: tyro.conf.Positional[Path]
    """Dataset folder, with ground truth and ideal images."""
    conditions: tuple[str, ...] = ()
    """Names of conditions, such as "d415, 10 frames"; all when empty."""
    method: str = "registration-completed"
    """Name in the library's catalog, or module:Object."""
    track: str = "snap-d415"
    """The track whose queries are taken: their parts and guesses."""
    split: Literal["test", "val", "train"] = "test"
    limit: int = 40
    """Most queries of a condition, spread evenly over the split."""
    masks: Literal["given", "found"] = "given"
    """Masks of the renderer, or those that are found in each image."""
    workers: int = 1
    out: Path | None = None
    """JSON file for the table, such as results/camera-conditions.json."""


COLUMNS = (
    Column("condition", "condition"),
    Column("n", "n"),
    Column("seated", "seated, %", 1, True),
    Column("position", "position, median mm", 2),
    Column("rotation", "rotation, median °", 2),
    Column("sure", f"confidence {CONFIDENT} or more"),
    Column("sure_seated", "seated of these"),
)


def main(options: CameraConditions) -> None:
    """Predict, measure, print."""
    chosen = conditions_named(options.conditions)
    measurement = Measurement.begin(Dataset(options.data))
    title = f"{options.method} under conditions of the camera, queries of {options.track} of {options.split}"
    title += f", masks {options.masks}"
    table = measurement.table("seated", title, *COLUMNS)
    with local_engine(options.workers) as engine:
        for condition in chosen:
            _add(table, Dataset(options.data), condition, _answers(options, condition, engine))
    measurement.report(options.out)


def conditions_named(names: Sequence[str]) -> tuple[Condition, ...]:
    """The conditions with some names; all when there are none."""
    known = {condition.name: condition for condition in CONDITIONS}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"condition {unknown[0]!r}: expected one of {'; '.join(known)}")
    return tuple(known[name] for name in names) or CONDITIONS


def _answers(options: CameraConditions, condition: Condition, engine: Any) -> list[Answer]:
    """The method's answers under a condition."""
    split = Dataset(options.data).split(options.split, truth=True)
    queries = [query for query in split.queries() if query.track == options.track]
    if not queries:
        raise InputError(f"{options.data}: split {options.split} has no query of {options.track}")
    jobs = [(query.scene_id, query.id) for query in spread(queries, options.limit)]
    answers = [each for each in engine(partial(_answer, options, condition), jobs) if each is not None]
    if not answers:
        raise InputError(f"{condition.name}: no part and goal of {len(jobs)} queries are in view")
    return answers


def _add(table: Table, dataset: Dataset, condition: Condition, answers: Sequence[Answer]) -> None:
    """Add the row of a condition."""
    motions, truths = Pose.stack([each.motion for each in answers]), [each.truth for each in answers]
    errors = pose_errors(motions, Targets.of(truths, lambda part: dataset.geometry.part(part).mesh.vertices))
    seated = seatings(motions, truths, dataset.geometry).seated
    sure = np.array([each.confidence for each in answers]) >= CONFIDENT
    table.add(
        condition=condition.name,
        n=len(answers),
        seated=rate(seated),
        position=1e3 * float(np.median(errors.position)),
        rotation=float(np.degrees(np.median(errors.rotation))),
        sure=int(sure.sum()),
        sure_seated=int((sure & seated).sum()),
    )


def _answer(options: CameraConditions, condition: Condition, job: tuple[str, str]) -> Answer | None:
    """The method's answer to a query under a condition; None if no image shows both part and goal."""
    scene_id, query_id = job
    dataset, predictor = _made(options.data, options.method)
    scene = dataset.split(options.split, truth=True).scene(scene_id)
    query, truth = next(query for query in scene.queries if query.id == query_id), scene.truth_of(query_id)
    seen = [ideal_from(scene, query, truth, condition.distance, azimuth) for azimuth in AZIMUTHS[: condition.places]]
    queries = [measured_query(query, ideal, condition, place) for place, ideal in enumerate(seen) if ideal is not None]
    if not queries:
        return None
    if condition.places > 1 and not hasattr(predictor, "together"):
        raise InputError(f"{options.method}: has no `together`, which answers by images from several places")
    if options.masks == "found":
        queries = [with_predicted_masks(each, sensor=simulated_sensor(each.sensor)) for each in queries]
    if getattr(predictor, "reads", "") == "shapes":
        predicted = next(iter(predictor.together(queries, scene.shapes)), PredictedMotion(Pose.identity(), 0.0))
    else:
        predicted = predictor(queries[0], None) if condition.places == 1 else predictor.together(queries)
    return Answer(predicted.goal_from_now, float(predicted.confidence), truth)


def ideal_from(
    scene: RecordedScene, query: Query, truth: Truth, distance: float | None, azimuth: float = 0.0
) -> LabelledDepth | None:
    """The ideal image of a scene from another place; None if the query's part or goal is out of view.

    Args:
        scene: with its truth.
        query: about a part.
        truth: of it.
        distance: [m] from the middle between part and goal; None: the recorded distance and direction.
        azimuth: [rad] about the vertical through that middle.
    """
    image = scene.labelled_depth("ideal")
    if distance is None and azimuth == 0:
        return image
    pose, middle = image.view.world_from_camera, (truth.anchor + truth.goal_drawn.apply(truth.anchor)) / 2
    if distance is not None:
        pose = look_at(middle + distance * pose.rotate((0.0, 0.0, -1.0)), middle)
    return rendered_from(scene, query, truth, pose if azimuth == 0 else orbited(pose, middle, azimuth))


def orbited(pose: Pose, middle: np.ndarray, azimuth: float) -> Pose:
    """A camera's pose after a rotation by an azimuth [rad] about the vertical through a middle (3,) [m]."""
    there = Pose.from_translation(middle)
    return there @ Pose.from_rotvec((0.0, 0.0, azimuth)) @ there.inverse() @ pose


def rendered_from(scene: RecordedScene, query: Query, truth: Truth, pose: Pose) -> LabelledDepth | None:
    """The ideal image of a scene by a camera at a pose; None if the query's part or goal is out of view."""
    bodies = scene.bodies()
    mesh, world_from_part = bodies[FIRST_PART_LABEL + query.part]
    points = world_from_part.apply(mesh.vertices)
    if not in_view(CAMERA, pose, np.concatenate([points, truth.goal_drawn.apply(points)])):
        return None
    image = render(CAMERA, pose, bodies, threads=1)
    labels = np.maximum(image.body_ids - 1, 0).astype(np.uint8)  # nothing and table both become 0
    if np.count_nonzero(labels == FIRST_PART_LABEL + query.part) < LEAST_PIXELS:
        return None
    return LabelledDepth(View(CAMERA, pose, image.depth), labels)


def measured_query(query: Query, ideal: LabelledDepth, condition: Condition, place: int = 0) -> Query:
    """The query with a measured image of an ideal one; its noise depends on scene and place alone."""
    view = ideal.view
    if condition.sensor != "ideal":
        rng = stream(0, "camera-conditions", condition.sensor, query.scene_id, *([place] if place else []))
        view = sense(condition.sensor, view, rng, condition.frames)
    image = LabelledDepth(view, ideal.labels)
    pivot = part_pivots(view, ideal.labels).get(query.part, query.pivot)
    return replace(query, sensor=condition.sensor, pivot=pivot, read_image=lambda: image)


@cache
def _made(data: Path, name: str) -> tuple[Dataset, Any]:
    """A dataset and the predictor of a method."""
    dataset = Dataset(data)
    return dataset, make_predictor(method_of(name), dataset, 0)


if __name__ == "__main__":
    run(main, CameraConditions, __doc__)
