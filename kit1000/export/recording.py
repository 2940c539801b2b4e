"""Export of one scene as a recording made for looking at: what the sensors saw, and where parts are said to go.

Whatever has a place in space is a cloud of coloured points, which every viewer draws; models and captions come on top
for those that draw them. Without the truth, only observations are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kit1000.dataset.mcap_io.messages import (
    WORLD,
    Message,
    camera_message,
    captions_message,
    frames_message,
    image_message,
    models_message,
    points_message,
    poses_message,
)
from kit1000.dataset.mcap_io.writing import PictureWriter
from kit1000.dataset.mesh_files import glb_bytes
from kit1000.errors import InputError, did_you_mean
from kit1000.mesh import even_points
from kit1000.metrics import PoseErrors, Targets, nearest_goal_motions, pose_errors
from kit1000.pictures.depth_images import mask_picture
from kit1000.pictures.shading import KIT, Colour, part_colour
from kit1000.pose import Pose
from kit1000.queries.tracks import TRACKS
from kit1000.submission import Predictions, read_predictions
from kit1000.values import Query

if TYPE_CHECKING:
    from kit1000.dataset.reader import Dataset, RecordedScene

AXIS_COLOURS = ((230, 60, 60), (70, 190, 80), (70, 110, 240))  # of the crosses at pivots: x, y, z
AXIS_LENGTH, AXIS_STEP = 8e-3, 2e-4  # [m] of half a line of a cross, and between its points
PALE = 0.6  # share of white in the colour of a part where its guess takes it
GOAL_COLOUR: Colour = (96, 200, 255)  # light blue: no part and no error has it
ERROR_COLOURS = ((0.0, (60, 190, 90)), (3e-3, (250, 210, 60)), (10e-3, (220, 40, 40)))  # [m] of a point: its colour
CAPTION_UP = np.array((0, 0, 0.05))  # [m] from the anchor
SURFACE_POINTS = 20_000  # of a part: 0.5 mm apart on one of 50 mm


def write_scene_recording(
    dataset: Dataset,
    scene_id: str,
    path: Path,
    truth: bool = False,
    predictions: Path | None = None,
    track: str | None = None,
) -> Path:
    """Write the recording of a scene, replacing an existing file; returns the path.

    Args:
        dataset: the dataset of the scene.
        scene_id: of any split.
        path: an .mcap file.
        truth: with models, goals and seated parts.
        predictions: a predictions file whose answers to the scene are shown, coloured by their errors; needs the truth.
        track: its queries give the pivots, guesses, goals and answers; by default the first with queries here.

    Raises:
        InputError: no such scene or track, the truth is withheld, or no answer is about the scene.
    """
    if track is not None and track not in TRACKS:
        raise InputError(f"no track {track!r}; {did_you_mean(track, TRACKS)}there are {', '.join(TRACKS)}")
    if predictions is not None and not truth:
        raise InputError(f"{predictions}: its errors are measured against the truth; add --truth")
    scene = dataset.recorded_scene(scene_id, truth)
    if track is None:
        track = next((name for name in TRACKS if any(query.track == name for query in scene.queries)), "snap")
    queries = [query for query in scene.queries if query.track == track]
    answers = None if predictions is None else _answers(predictions, scene, track)
    stamp = dataset.observation_file(scene.shard).stamp(scene_id)
    messages = [*_seen(scene, stamp), *_asked(queries, stamp)]
    if truth:
        messages += [_models(scene, stamp), *_goals(scene, queries, answers, stamp)]
    with PictureWriter(path, stamp) as writer:
        writer.add(scene_id, messages)
    return path


def error_colours(error: np.ndarray) -> np.ndarray:
    """(n, 3) uint8 colours of errors (n,) [m]: green at 0, yellow at 3 mm, red from 10 mm on."""
    knots, colours = zip(*ERROR_COLOURS, strict=True)
    channels = [np.interp(error, knots, channel) for channel in np.transpose(colours)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def _answers(path: Path, scene: RecordedScene, track: str) -> Predictions:
    """The predictions of a file, of which at least one is for the scene's queries of the track."""
    predictions = read_predictions(path)
    tracks = {query.track for query in scene.queries if predictions.row(query.id) is not None}
    if track not in tracks:
        others = f"it has some on {', '.join(sorted(tracks))}: add --track" if tracks else "nor on any other track"
        raise InputError(f"{path}: no prediction for scene {scene.id} on track {track}; {others}")
    return predictions


def _seen(scene: RecordedScene, stamp: int) -> Iterator[Message]:
    """Frames, and of each sensor its calibration, the masks in colour, and points in these colours."""
    images = {sensor: scene.labelled_depth(sensor) for sensor in scene.sensors}
    frames = {sensor: "camera" if sensor == "ideal" else sensor for sensor in images}
    poses = {frames[sensor]: image.view.world_from_camera for sensor, image in images.items()}
    yield frames_message("/tf", poses | _body_poses(scene), stamp)
    for sensor, image in images.items():
        view, colours, returned = image.view, mask_picture(image), image.view.depth > 0
        yield camera_message(f"/{sensor}/camera", view.camera, frames[sensor], stamp)
        yield image_message(f"/{sensor}/colours", colours, "rgb8", frames[sensor], stamp)
        points = view.camera.unproject(view.depth)[returned]
        yield points_message(f"/{sensor}/points", points, colours[returned], frames[sensor], stamp)


def _body_poses(scene: RecordedScene) -> dict[str, Pose]:
    """The poses `world_from_body` of the assembly and the parts by name; none without the truth."""
    if not scene.split.truth:
        return {}
    kinds = ["assemblies", *["parts"] * (len(scene.scene.bodies) - 1)]
    return {f"{kind}/{body.id}": body.world_from_body for kind, body in zip(kinds, scene.scene.bodies, strict=True)}


def _asked(queries: Sequence[Query], stamp: int) -> Iterator[Message]:
    """The pivots as crosses, and the crosses and the visible points of the parts as the guesses move them."""
    crosses = [query.pivot + _CROSS for query in queries]
    if crosses:
        colours = np.tile(_CROSS_COLOURS, (len(crosses), 1))
        yield points_message("/pivots", np.concatenate(crosses), colours, WORLD, stamp)
    guessed, colours = [], []
    for query, cross in zip(queries, crosses, strict=True):
        if query.guess is None:
            continue
        view, seen = query.view, query.part_mask & (query.view.depth > 0)
        points = view.world_from_camera.apply(view.camera.unproject(view.depth)[seen])
        pale = np.multiply(part_colour(query.part), 1 - PALE) + 255 * PALE
        guessed += [query.guess.apply(points), query.guess.apply(cross)]
        colours += [np.tile(pale.astype(np.uint8), (len(points), 1)), _CROSS_COLOURS]
    if guessed:
        yield points_message("/guesses", np.concatenate(guessed), np.concatenate(colours), WORLD, stamp)


def _models(scene: RecordedScene, stamp: int) -> Message:
    """The assembly and the parts as models, where they are."""
    poses = _body_poses(scene)
    meshes = [mesh for mesh, _ in scene.bodies()[1:]]  # without the table
    colours = [KIT, *(part_colour(i) for i in range(len(meshes) - 1))]
    models = {
        name: glb_bytes({name: mesh}, {name: colour}) for name, mesh, colour in zip(poses, meshes, colours, strict=True)
    }
    return models_message("/models", models, poses, stamp)


def _goals(
    scene: RecordedScene, queries: Sequence[Query], answers: Predictions | None, stamp: int
) -> Iterator[Message]:
    """All goals, each part seated at one of them (the nearest to its answer), and each part as its answer moves it."""
    if not queries:
        return
    truths = [scene.truths[query.id] for query in queries]
    geometry = scene.split.dataset.geometry
    targets = Targets.of(truths, lambda part_id: geometry.part(part_id).mesh.vertices)
    rows = [None if answers is None else answers.row(query.id) for query in queries]
    moved = [
        truth.goal_drawn if answers is None or row is None else answers.motions[row]
        for truth, row in zip(truths, rows, strict=True)
    ]
    errors = pose_errors(Pose.stack(moved), targets)
    nearest = nearest_goal_motions(targets, errors)
    meshes = [geometry.part(truth.part_id).mesh.moved(truth.world_from_part) for truth in truths]
    surfaces = [even_points(mesh.triangles, SURFACE_POINTS)[0] for mesh in meshes]
    seated = [motion.apply(points) for motion, points in zip(nearest, surfaces, strict=True)]
    yield poses_message("/goals", targets.goals @ targets.world_from_part[targets.query_of_goal], stamp)
    points = np.concatenate(seated)
    yield points_message("/seated", points, np.tile(np.array(GOAL_COLOUR, np.uint8), (len(points), 1)), WORLD, stamp)
    answered = [i for i, row in enumerate(rows) if row is not None]
    if answered:
        placed = np.concatenate([moved[i].apply(surfaces[i]) for i in answered])
        error = np.linalg.norm(placed - np.concatenate([seated[i] for i in answered]), axis=1)
        yield points_message("/answers", placed, error_colours(error), WORLD, stamp, {"error_mm": 1e3 * error})
        captions = {
            queries[i].id: (_caption(errors, i), moved[i].apply(truths[i].anchor) + CAPTION_UP) for i in answered
        }
        yield captions_message("/errors", captions, stamp)


def _caption(errors: PoseErrors, i: int) -> str:
    return f"{1e3 * errors.position[i]:.1f} mm, {np.rad2deg(errors.rotation[i]):.1f}°"


def _cross() -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) [m] along three axes through the origin, and their colours (n, 3) uint8."""
    along = np.arange(-AXIS_LENGTH, AXIS_LENGTH + AXIS_STEP / 2, AXIS_STEP)
    points = np.concatenate([along[:, None] * axis for axis in np.eye(3)])
    return points, np.repeat(np.array(AXIS_COLOURS, np.uint8), len(along), axis=0)


_CROSS, _CROSS_COLOURS = _cross()
