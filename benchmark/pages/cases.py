"""Single cases as pictures: what the sensor saw of the slot, the part where a method puts it, and where it belongs."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion

from benchmark.measure import answers_to, centred
from benchmark.pages.entries import Entry
from benchmark.truths import Questions
from kit1000.camera import Camera
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.metrics import nearest_goal_motions, pose_errors
from kit1000.pictures.depth_images import depth_picture, mask_picture
from kit1000.pictures.shading import INK
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.submission import read_submission
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, Truth, View

SIZE = (400, 300)  # [px]
FINE = 2  # drawn this many times larger, and then made smaller: smooth edges
BORDER = 1.2  # of the window around the slot and both poses, against their extents
SLOT_SIDE = 0.06  # [m] around the middle of a slot that a picture shows at least
IN_FRONT, BEHIND = 0.85, 0.4  # how opaque the part is before what the sensor saw, and behind it
OUTLINE, HALO = 3, 3  # [px] of the white line along the goal, and of the dark ones on both its sides
WHITE = (255, 255, 255)
LARGEST = 25_000  # bytes of a picture
QUALITIES = (85, 75, 65, 50, 35)  # of JPEG, the first that is small enough


class Drawn(NamedTuple):
    """A query with what a picture of it shows."""

    recorded: RecordedScene
    query: Query
    truth: Truth
    predicted: Pose
    """goal_from_now"""
    goal: Pose
    """goal_from_now of the goal that judges the prediction."""


def case_ids(track: Mapping[str, Any]) -> list[str]:
    """The queries that a track of scores.json lists, each once."""
    return list(dict.fromkeys(case["query_id"] for kind in ("worst", "middle") for case in track[kind]))


def pictures(dataset: Dataset, entry: Entry, query_ids: Sequence[str]) -> dict[str, bytes]:
    """By query id, a JPEG of what a method answers. Raises InputError when its predictions are not at hand."""
    if dataset.id != entry.scores["dataset_id"]:
        raise InputError(
            f"{dataset.root}: is dataset {dataset.id}; the scores of {entry.name} are on {entry.scores['dataset_id']}"
        )
    return {drawn.query.id: jpeg(case_picture(drawn)) for drawn in _answered(dataset, entry, query_ids)}


def case_picture(drawn: Drawn) -> Image.Image:
    """The sensor's depth around the slot; orange the part as predicted, outlined in white the goal."""
    look, (mesh, world_from_part) = drawn.recorded.labelled_depth(drawn.query.sensor), _part(drawn)
    poses = [motion @ world_from_part for motion in (drawn.predicted, drawn.goal)]
    window = _window(look.view, drawn.truth, mesh, poses)
    view = _cut(look.view, window)
    camera, picture, depth = _enlarged(view)
    predicted, goal = (render(camera, view.world_from_camera, [(mesh, pose)]).depth for pose in poses)
    labels = np.where(predicted > 0, FIRST_PART_LABEL, 0).astype(np.uint8)
    part = mask_picture(LabelledDepth(View(camera, view.world_from_camera, predicted), labels))
    opaque = np.where((depth > 0) & (predicted > depth), BEHIND, IN_FRONT) * (predicted > 0)
    picture = picture * (1 - opaque[..., None]) + part * opaque[..., None]
    picture[_edge(goal > 0, HALO, OUTLINE + HALO)] = INK
    picture[_edge(goal > 0, 0, OUTLINE)] = WHITE
    return Image.fromarray(picture.astype(np.uint8)).resize(SIZE, Image.Resampling.BOX)


def jpeg(picture: Image.Image) -> bytes:
    """A picture as JPEG, as good as LARGEST allows."""
    data = b""
    for quality in QUALITIES:
        buffer = io.BytesIO()
        picture.save(buffer, "JPEG", quality=quality, optimize=True)
        data = buffer.getvalue()
        if len(data) <= LARGEST:
            break
    return data


def _edge(mask: np.ndarray, outside: int, inside: int) -> np.ndarray:
    """(H, W) bool: a line along the edge of a mask, so many pixels out and in."""
    grown = np.asarray(binary_dilation(mask, iterations=outside)) if outside else mask
    return grown & ~np.asarray(binary_erosion(mask, iterations=inside), bool)


def _answered(dataset: Dataset, entry: Entry, query_ids: Sequence[str]) -> list[Drawn]:
    """The queries with their truth, the answer and the goal that judges it."""
    asked: list[tuple[RecordedScene, Query, Truth]] = []
    for query_id in query_ids:
        recorded = dataset.recorded_scene(query_id.partition("-p")[0])
        query = next((query for query in recorded.queries if query.id == query_id), None)
        if query is None:
            raise InputError(f"{entry.folder}: scores.json lists {query_id}, which is no query of {dataset.root}")
        asked.append((recorded, query, recorded.truth_of(query_id)))
    if not asked:
        return []
    truths = tuple(truth for _, _, truth in asked)
    tracks = tuple(query.track for _, query, _ in asked)
    questions = Questions(dataset.geometry, tracks, tuple(recorded.id for recorded, _, _ in asked), truths)
    motions = answers_to(questions, read_submission(entry.folder).predictions).motions
    if entry.manifest.predicts == "rotation":
        motions = centred(motions, questions.targets)
    goals = nearest_goal_motions(questions.targets, pose_errors(motions, questions.targets))
    return [Drawn(*row, motions[i], goals[i]) for i, row in enumerate(asked)]


def _part(drawn: Drawn) -> tuple[Mesh, Pose]:
    """The part and its world_from_part."""
    geometry = drawn.recorded.split.dataset.geometry
    return geometry.part(drawn.truth.part_id).mesh, drawn.truth.world_from_part


def _window(view: View, truth: Truth, mesh: Mesh, poses: Sequence[Pose]) -> tuple[slice, slice]:
    """Rows and columns of the image around the slot and the part in some poses, in the shape of a picture."""
    side = SLOT_SIDE / 2 * np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)])
    points = np.concatenate([truth.world_from_kit.apply(side), *(pose.apply(mesh.vertices) for pose in poses)])
    places = view.camera.project(view.world_from_camera.inverse().apply(points))
    places = places[np.isfinite(places).all(1)]
    low, high = np.clip((places.min(0), places.max(0)), 0, (view.camera.width - 1, view.camera.height - 1))
    tall = BORDER * max(high[1] - low[1], (high[0] - low[0]) * SIZE[1] / SIZE[0], 4.0)
    tall = round(min(tall, view.camera.height, view.camera.width * SIZE[1] / SIZE[0]))
    wide = min(round(tall * SIZE[0] / SIZE[1]), view.camera.width)
    left, top = (low + high - (wide, tall)) / 2
    left = int(np.clip(round(left), 0, view.camera.width - wide))
    top = int(np.clip(round(top), 0, view.camera.height - tall))
    return slice(top, top + tall), slice(left, left + wide)


def _cut(view: View, window: tuple[slice, slice]) -> View:
    """A window of a view as a view of its own."""
    rows, columns = window
    whole = view.camera
    wide, tall = columns.stop - columns.start, rows.stop - rows.start
    camera = Camera(wide, tall, whole.fx, whole.fy, whole.cx - columns.start, whole.cy - rows.start)
    return View(camera, view.world_from_camera, view.depth[window])


def _enlarged(view: View) -> tuple[Camera, np.ndarray, np.ndarray]:
    """The same view FINE times as large as a picture: its camera, its colours (H, W, 3) and depths (H, W) [m]."""
    size = (FINE * SIZE[0], FINE * SIZE[1])
    coloured = Image.fromarray(depth_picture(view)).resize(size, Image.Resampling.BICUBIC)
    depth = Image.fromarray(view.depth).resize(size, Image.Resampling.NEAREST)
    small = view.camera
    across, down = size[0] / small.width, size[1] / small.height
    centre = (small.cx + 0.5) * across - 0.5, (small.cy + 0.5) * down - 0.5
    camera = Camera(*size, small.fx * across, small.fy * down, *centre)
    return camera, np.asarray(coloured, np.float64), np.asarray(depth)
