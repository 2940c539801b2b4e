"""Pictures of single queries: the depth image around the slot, with the part at its predicted pose and at its goal."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import binary_dilation, binary_erosion

from benchmark.entries import Entry
from benchmark.evaluate import align, centred
from benchmark.queries import ScoredQueries
from kit1000.camera import Camera
from kit1000.dataset.reader import Dataset, RecordedScene
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.metrics import nearest_goal_motions, pose_errors
from kit1000.pictures.depth_images import depth_picture, mask_picture
from kit1000.pictures.shading import INK
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.submission import read_valid_submission
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, Truth, View

SIZE = (400, 300)  # [px]
SUPERSAMPLING = 2  # drawn this many times larger, then scaled down: smooth edges
MARGIN = 1.2  # size of the window, as a multiple of the extents of the slot and both poses
SLOT_SIDE = 0.06  # [m] side of the square around a slot that a picture shows at least
OPAQUE, HIDDEN = 0.85, 0.4  # opacity of the part in front of the observed surface, and behind it
OUTLINE, HALO = 3, 3  # [px] width of the white line along the goal, and of the dark lines on both its sides
WHITE = (255, 255, 255)
MAX_BYTES = 25_000  # of a picture
QUALITIES = (85, 75, 65, 50, 35)  # of JPEG: the first that is small enough


class Case(NamedTuple):
    """A query with its ground truth, its prediction and the nearest goal."""

    recorded: RecordedScene
    query: Query
    truth: Truth
    predicted: Pose
    """goal_from_now"""
    goal: Pose
    """goal_from_now of the goal nearest to the prediction."""


def case_ids(track: Mapping[str, Any]) -> list[str]:
    """The queries that a track of scores.json lists, each once."""
    return list(dict.fromkeys(case["query_id"] for key in ("worst", "middle") for case in track[key]))


def pictures(dataset: Dataset, entry: Entry, query_ids: Sequence[str]) -> dict[str, bytes]:
    """A JPEG of each prediction, by query id. Raises InputError if the predictions of the entry are not there."""
    if dataset.id != entry.scores["dataset_id"]:
        raise InputError(
            f"{dataset.root}: is dataset {dataset.id}; the scores of {entry.name} are on {entry.scores['dataset_id']}"
        )
    return {case.query.id: jpeg(case_picture(case)) for case in _cases(dataset, entry, query_ids)}


def case_picture(case: Case) -> Image.Image:
    """The depth image around the slot, with the part as predicted in orange and its goal as a white outline."""
    image, (mesh, world_from_part) = case.recorded.labelled_depth(case.query.sensor), _part(case)
    poses = [motion @ world_from_part for motion in (case.predicted, case.goal)]
    window = _window(image.view, case.truth, mesh, poses)
    view = _cut(image.view, window)
    camera, picture, depth = _enlarged(view)
    predicted, goal = (render(camera, view.world_from_camera, [(mesh, pose)]).depth for pose in poses)
    labels = np.where(predicted > 0, FIRST_PART_LABEL, 0).astype(np.uint8)
    part = mask_picture(LabelledDepth(View(camera, view.world_from_camera, predicted), labels))
    opacity = np.where((depth > 0) & (predicted > depth), HIDDEN, OPAQUE) * (predicted > 0)
    picture = picture * (1 - opacity[..., None]) + part * opacity[..., None]
    picture[_edge(goal > 0, HALO, OUTLINE + HALO)] = INK
    picture[_edge(goal > 0, 0, OUTLINE)] = WHITE
    return Image.fromarray(picture.astype(np.uint8)).resize(SIZE, Image.Resampling.BOX)


def jpeg(picture: Image.Image) -> bytes:
    """A picture as JPEG, in the best quality of at most MAX_BYTES."""
    data = b""
    for quality in QUALITIES:
        buffer = io.BytesIO()
        picture.save(buffer, "JPEG", quality=quality, optimize=True)
        data = buffer.getvalue()
        if len(data) <= MAX_BYTES:
            break
    return data


def _edge(mask: np.ndarray, outside: int, inside: int) -> np.ndarray:
    """(H, W) bool: a line along the edge of a mask; outside, inside: its width [px] on both sides."""
    grown = np.asarray(binary_dilation(mask, iterations=outside)) if outside else mask
    return grown & ~np.asarray(binary_erosion(mask, iterations=inside), bool)


def _cases(dataset: Dataset, entry: Entry, query_ids: Sequence[str]) -> list[Case]:
    """The queries with their ground truth, prediction and nearest goal."""
    rows: list[tuple[RecordedScene, Query, Truth]] = []
    for query_id in query_ids:
        recorded = dataset.recorded_scene(query_id.partition("-p")[0])
        query = next((query for query in recorded.queries if query.id == query_id), None)
        if query is None:
            raise InputError(f"{entry.folder}: scores.json lists {query_id}, which is no query of {dataset.root}")
        rows.append((recorded, query, recorded.truth_of(query_id)))
    if not rows:
        return []
    truths = tuple(truth for _, _, truth in rows)
    tracks = tuple(query.track for _, query, _ in rows)
    queries = ScoredQueries(dataset.geometry, tracks, tuple(recorded.id for recorded, _, _ in rows), truths)
    motions = align(read_valid_submission(entry.folder).predictions, queries).motions
    if entry.manifest.predicts == "rotation":
        motions = centred(motions, queries.targets)
    goals = nearest_goal_motions(queries.targets, pose_errors(motions, queries.targets))
    return [Case(*row, motions[i], goals[i]) for i, row in enumerate(rows)]


def _part(case: Case) -> tuple[Mesh, Pose]:
    """The part and its world_from_part."""
    geometry = case.recorded.split.dataset.geometry
    return geometry.part(case.truth.part_id).mesh, case.truth.world_from_part


def _window(view: View, truth: Truth, mesh: Mesh, poses: Sequence[Pose]) -> tuple[slice, slice]:
    """Rows and columns of the image around the slot and the part in some poses, in the aspect ratio of a picture."""
    side = SLOT_SIDE / 2 * np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)])
    points = np.concatenate([truth.world_from_kit.apply(side), *(pose.apply(mesh.vertices) for pose in poses)])
    places = view.camera.project(view.world_from_camera.inverse().apply(points))
    places = places[np.isfinite(places).all(1)]
    low, high = np.clip((places.min(0), places.max(0)), 0, (view.camera.width - 1, view.camera.height - 1))
    tall = MARGIN * max(high[1] - low[1], (high[0] - low[0]) * SIZE[1] / SIZE[0], 4.0)
    tall = round(min(tall, view.camera.height, view.camera.width * SIZE[1] / SIZE[0]))
    wide = min(round(tall * SIZE[0] / SIZE[1]), view.camera.width)
    left, top = (low + high - (wide, tall)) / 2
    left = int(np.clip(round(left), 0, view.camera.width - wide))
    top = int(np.clip(round(top), 0, view.camera.height - tall))
    return slice(top, top + tall), slice(left, left + wide)


def _cut(view: View, window: tuple[slice, slice]) -> View:
    """A window of a view, as a view."""
    rows, columns = window
    whole = view.camera
    wide, tall = columns.stop - columns.start, rows.stop - rows.start
    camera = Camera(wide, tall, whole.fx, whole.fy, whole.cx - columns.start, whole.cy - rows.start)
    return View(camera, view.world_from_camera, view.depth[window])


def _enlarged(view: View) -> tuple[Camera, np.ndarray, np.ndarray]:
    """The view SUPERSAMPLING times as large as a picture: its camera, colours (H, W, 3) and depth (H, W) [m]."""
    size = (SUPERSAMPLING * SIZE[0], SUPERSAMPLING * SIZE[1])
    coloured = Image.fromarray(depth_picture(view)).resize(size, Image.Resampling.BICUBIC)
    depth = Image.fromarray(view.depth).resize(size, Image.Resampling.NEAREST)
    small = view.camera
    across, down = size[0] / small.width, size[1] / small.height
    centre = (small.cx + 0.5) * across - 0.5, (small.cy + 0.5) * down - 0.5
    camera = Camera(*size, small.fx * across, small.fy * down, *centre)
    return camera, np.asarray(coloured, np.float64), np.asarray(depth)
