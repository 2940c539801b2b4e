"""Recordings of observations: cameras with their measured poses, queries, masks and depth images.

A view "ideal", "d415" or "photoneo" is of the primary camera, "three/0/ideal" of a camera of an extra set. These files
contain no poses of parts and no random draws.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from kit1000.camera import Camera
from kit1000.dataset.json_rows import Row
from kit1000.dataset.mcap_io.content_hash import observation_hash
from kit1000.dataset.mcap_io.messages import (
    PREVIEW_FRAME,
    Message,
    camera_message,
    camera_of,
    frames_message,
    frames_of,
    image_message,
    image_of,
    json_schema,
    points_message,
    preview_message,
    preview_of,
    row_message,
    row_of,
)
from kit1000.dataset.mcap_io.reading import ShardFile
from kit1000.dataset.mcap_io.writing import ShardWriter
from kit1000.dataset.scene_data import PREVIEW_STEP, Observation
from kit1000.errors import InputError, checked
from kit1000.pose import Pose
from kit1000.values import View

IDEAL = "ideal"  # the sensor whose frame is the true camera frame
LABELS = f"/{IDEAL}/labels"  # beside the calibration of their frame: viewers match an image with it by topic
PREVIEW = "/preview"
POINTS = "/points"  # not below the preview: Rerun would draw them over it
BODY_STEP, TABLE_STEP = 2, 4  # [px of the preview] between its points: 15,000 of them
POINT_GRID = 2.0**-10  # [m] of their coordinates, for compression
VIEW_KEY = re.compile(r"((?:[a-z0-9]+/)*)([a-z0-9]+)")  # camera, then sensor
QUERY_FIELDS = ("drawn", "guess", "id", "part", "pivot", "sensor", "track")

_NUMBERS = {"type": "array", "items": {"type": "number"}}
POSE_SCHEMA = {
    "type": "object",
    "required": ["wxyz", "xyz"],
    "properties": {
        "wxyz": _NUMBERS | {"minItems": 4, "maxItems": 4, "description": "unit quaternion, scalar first"},
        "xyz": _NUMBERS | {"minItems": 3, "maxItems": 3, "description": "m"},
    },
}
_QUERY = json_schema(
    "kit1000.Query",
    {
        "type": "object",
        "description": "Which part of a scene a method is asked about, and roughly how it should move.",
        "required": list(QUERY_FIELDS),
        "additionalProperties": False,
        "properties": {
            "id": {"type": "string"},
            "track": {"type": "string"},
            "sensor": {"type": "string", "description": "whose depth image to read"},
            "part": {"type": "integer", "description": "its pixels are 2 + part in the masks"},
            "drawn": {"type": "boolean", "description": "whether it is the target drawn for the scene"},
            "pivot": _NUMBERS | {"minItems": 3, "maxItems": 3, "description": "m, world: the guess turns about it"},
            "guess": {"oneOf": [POSE_SCHEMA, {"type": "null"}], "description": "goal_from_now, a motion in the world"},
        },
    },
)


class ObservationWriter(ShardWriter):
    """Writes a file of observations when its `with` block ends without an exception."""

    CONTENTS = "observations"

    def add(self, observation: Observation) -> None:
        """Append a scene. Raises InputError when a value does not fit the format."""
        self.record(observation.scene_id, observation_hash(observation), _messages(observation, self.stamp))


class ObservationFile(ShardFile):
    """A file of observations. Arrays come read-only."""

    CONTENTS = "observations"

    def queries(self, scene_id: str) -> list[Row]:
        """The query rows of a scene, see `kit1000.dataset.scene_data.Observation`."""
        return [row_of(data) for data in self._all(scene_id, "/query")]

    def view_keys(self, scene_id: str) -> tuple[str, ...]:
        """The view keys of a scene, the ideal sensor before the others."""
        topics = (topic for topic in self._topics(scene_id) if topic.endswith("/depth"))
        return tuple(sorted((topic.removeprefix("/").removesuffix("/depth") for topic in topics), key=_sort_key))

    def view(self, scene_id: str, key: str | None = None) -> View:
        """A depth image with its camera and the measured camera pose; None: the first of `view_keys`."""
        keys = self.view_keys(scene_id)
        key = key or next(iter(keys), IDEAL)
        if key not in keys:
            raise InputError(f"{self.path}: scene {scene_id} has no view {key!r}; it has {', '.join(keys) or 'none'}")
        camera, depth = _camera(self._one(scene_id, f"/{key}/camera")), self._one(scene_id, f"/{key}/depth")
        return View.adopt(camera, self.camera_pose(scene_id, key), image_of(depth))

    def camera_pose(self, scene_id: str, key: str) -> Pose:
        """The measured world_from_camera of a view, without reading its image."""
        return frames_of(self._one(scene_id, "/tf"))[_frame_id(key)]

    def labels(self, scene_id: str) -> np.ndarray | None:
        """(H, W) uint8 masks of the primary camera, see `kit1000.values.LabelledDepth`; None without masks."""
        masks = self._all(scene_id, LABELS)
        return image_of(masks[0]) if masks else None

    def preview(self, scene_id: str) -> np.ndarray | None:
        """(h, w, 3) uint8 sRGB, a small picture of the scene; None without one."""
        previews = self._all(scene_id, PREVIEW)
        return preview_of(previews[0]) if previews else None

    def observation(self, scene_id: str) -> Observation:
        """The whole observation of a scene."""
        views = {key: self.view(scene_id, key) for key in self.view_keys(scene_id)}
        queries = tuple(self.queries(scene_id))
        return Observation(scene_id, views, self.labels(scene_id), queries, self.preview(scene_id))

    def recomputed_hash(self, scene_id: str) -> str:
        """The content hash, computed from the data read."""
        return observation_hash(self.observation(scene_id))


def _messages(observation: Observation, stamp: int) -> Iterator[Message]:
    """The messages of a scene, small ones first."""
    views = {key: observation.views[key] for key in sorted(observation.views, key=_sort_key)}
    # A calibration for every frame, beside its images: viewers look for it there, and object to two of one frame.
    for key, view in views.items():
        yield camera_message(f"/{key}/camera", view.camera, _frame_id(key), stamp)
    frames = {_frame_id(key): view.world_from_camera for key, view in views.items()}
    if observation.preview is not None:
        view = next(iter(views.values()))
        yield camera_message(f"{PREVIEW}/camera", view.camera.scaled(1 / PREVIEW_STEP), PREVIEW_FRAME, stamp)
        frames[PREVIEW_FRAME] = view.world_from_camera
    yield frames_message("/tf", frames, stamp)
    for row in observation.queries:
        if sorted(row) != sorted(QUERY_FIELDS):
            raise InputError(f"query {row.get('id')}: fields {sorted(row)}, expected {sorted(QUERY_FIELDS)}")
        yield row_message("/query", _QUERY, row)
    if observation.preview is not None:
        yield preview_message(PREVIEW, observation.preview, stamp)
        yield _preview_points(observation, next(iter(views.values())), observation.preview, stamp)
    if observation.labels is not None:
        labels = checked(f"{observation.scene_id}: labels", observation.labels, ("h", "w"), np.uint8)
        yield image_message(LABELS, labels, "mono8", _frame_id(IDEAL), stamp)
    for key, view in views.items():
        yield image_message(f"/{key}/depth", view.depth, "32FC1", _frame_id(key), stamp)


def _preview_points(observation: Observation, view: View, preview: np.ndarray, stamp: int) -> Message:
    """Some pixels of the preview as points in its frame, denser on bodies: viewers show them in 3D at once."""
    height, width = preview.shape[:2]
    seen = view.depth[::PREVIEW_STEP, ::PREVIEW_STEP][:height, :width] > 0
    kept = np.zeros_like(seen)
    if observation.labels is not None:
        bodies = observation.labels[::PREVIEW_STEP, ::PREVIEW_STEP][:height, :width] > 0
        kept[::BODY_STEP, ::BODY_STEP] = bodies[::BODY_STEP, ::BODY_STEP]
    kept[::TABLE_STEP, ::TABLE_STEP] = True
    v, u = np.nonzero(kept & seen)
    pixels = np.stack([u, v], axis=-1) * PREVIEW_STEP
    points = view.camera.unproject_pixels(pixels, view.depth[pixels[:, 1], pixels[:, 0]])
    points = np.rint(points / POINT_GRID) * POINT_GRID
    return points_message(POINTS, points, preview[v, u], PREVIEW_FRAME, stamp)


@lru_cache(maxsize=16)
def _camera(data: bytes) -> Camera:
    return camera_of(data)


def _frame_id(key: str) -> str:
    """The frame of a view: "camera" for "ideal", "three/0/camera" for "three/0/ideal", else the view's key."""
    prefix, sensor = _split_key(key)
    return f"{prefix}camera" if sensor == IDEAL else key


def _sort_key(key: str) -> tuple[str, bool, str]:
    prefix, sensor = _split_key(key)
    return prefix, sensor != IDEAL, sensor


def _split_key(key: str) -> tuple[str, str]:
    match = VIEW_KEY.fullmatch(key)
    if match is None or match[2] == "camera":
        raise InputError(f"view {key!r}: expected a name such as ideal, d415 or three/0/ideal")
    return match[1], match[2]
