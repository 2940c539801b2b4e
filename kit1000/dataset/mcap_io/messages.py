"""Conversion of values to messages of the Foxglove schemas, and back: cameras, poses, images, models, JSON rows.

Only this module converts to the conventions of the messages: quaternions xyzw, matrices row by row, times in seconds
and nanoseconds. Positions and rotations are float64 in the messages, so a pose read back is equal to the bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_protobuf.schema import build_file_descriptor_set

from kit1000.camera import Camera
from kit1000.dataset.mcap_io.content_hash import compact_bytes
from kit1000.dataset.png_files import png_bytes, read_png
from kit1000.errors import checked
from kit1000.pose import Pose

WORLD = "world"
SECOND = 1_000_000_000  # [ns]
PREVIEW_FRAME = "preview"
GLB = "model/gltf-binary"
COORDINATES = ("x", "y", "z")  # fields of a point
CHANNELS = ("red", "green", "blue", "alpha")
CAPTION_SIZE = 14.0  # [px] on the screen
ENCODINGS = {
    "32FC1": np.dtype("<f4"),
    "mono8": np.dtype("u1"),
    "mono16": np.dtype("<u2"),
    "rgb8": np.dtype("u1"),  # (H, W, 3)
}
LARGE = {f"foxglove.{name}" for name in ("RawImage", "CompressedImage", "PointCloud", "SceneUpdate")}
"""Schemas of the messages that have a chunk of their own."""


@dataclass(frozen=True)
class Schema:
    """The schema and encoding of the messages of a topic."""

    name: str
    encoding: str
    message_encoding: str
    data: bytes


@dataclass(frozen=True, eq=False)
class Message:
    """A message ready to be written."""

    topic: str
    schema: Schema
    data: bytes


@cache
def _protobuf(kind: type) -> Schema:
    """The schema of a protobuf class, with all schemas that it depends on."""
    files = build_file_descriptor_set(kind).SerializeToString(deterministic=True)
    return Schema(kind.DESCRIPTOR.full_name, SchemaEncoding.Protobuf, MessageEncoding.Protobuf, files)  # type: ignore[attr-defined]


def json_schema(name: str, schema: Mapping[str, Any]) -> Schema:
    """The schema of rows written as JSON."""
    return Schema(name, SchemaEncoding.JSONSchema, MessageEncoding.JSON, compact_bytes(schema))


def _message(topic: str, value: Any) -> Message:
    return Message(topic, _protobuf(type(value)), value.SerializeToString(deterministic=True))


def row_message(topic: str, schema: Schema, row: Any) -> Message:
    """A row as JSON."""
    return Message(topic, schema, compact_bytes(row))


def row_of(data: bytes) -> Any:
    """The row of a JSON message."""
    return json.loads(data)


def camera_message(topic: str, camera: Camera, frame: str, stamp: int) -> Message:
    """The calibration of a camera without distortion; `stamp` [ns] here and below."""
    value = CameraCalibration(
        frame_id=frame,
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob",  # with no parameters: none
        K=camera.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.hstack([camera.K, np.zeros((3, 1))]).ravel().tolist(),
    )
    _set_time(value.timestamp, stamp)
    return _message(topic, value)


def camera_of(data: bytes) -> Camera:
    """The camera of a calibration."""
    value = CameraCalibration.FromString(data)
    return Camera(value.width, value.height, value.K[0], value.K[4], value.K[2], value.K[5])


def frames_message(topic: str, world_from_frames: Mapping[str, Pose], stamp: int) -> Message:
    """Poses `world_from_frame` by the name of the frame."""
    value = FrameTransforms()
    for frame, pose in world_from_frames.items():
        transform = value.transforms.add(parent_frame_id=WORLD, child_frame_id=frame)
        _set_time(transform.timestamp, stamp)
        _set_vector(transform.translation, pose.xyz)
        _set_rotation(transform.rotation, pose.wxyz)
    return _message(topic, value)


def frames_of(data: bytes) -> dict[str, Pose]:
    """The poses `world_from_frame` by the name of the frame."""
    transforms = FrameTransforms.FromString(data).transforms
    return {item.child_frame_id: _pose_of(item.translation, item.rotation) for item in transforms}


def poses_message(topic: str, world_from_poses: Pose, stamp: int) -> Message:
    """A batch (n,) of poses in the world."""
    value = PosesInFrame(frame_id=WORLD)
    _set_time(value.timestamp, stamp)
    for pose in world_from_poses:
        item = value.poses.add()
        _set_vector(item.position, pose.xyz)
        _set_rotation(item.orientation, pose.wxyz)
    return _message(topic, value)


def poses_of(data: bytes) -> Pose:
    """The batch (n,) of poses."""
    poses = PosesInFrame.FromString(data).poses
    return Pose.stack([_pose_of(item.position, item.orientation) for item in poses])


def models_message(
    topic: str, models: Mapping[str, bytes], world_from_bodies: Mapping[str, Pose], stamp: int
) -> Message:
    """GLB models at poses in the world; they replace all earlier ones.

    A GLB is y up, and the viewer rotates it to z up, so the pose of a model is that of its body.
    """
    value = SceneUpdate()
    _set_time(value.deletions.add(type=SceneEntityDeletion.ALL).timestamp, stamp)
    for name, data in models.items():
        entity = value.entities.add(frame_id=WORLD, id=name)
        _set_time(entity.timestamp, stamp)
        model = entity.models.add(media_type=GLB, data=data)
        model.scale.x = model.scale.y = model.scale.z = 1.0
        _set_vector(model.pose.position, world_from_bodies[name].xyz)
        _set_rotation(model.pose.orientation, world_from_bodies[name].wxyz)
    return _message(topic, value)


def models_of(data: bytes) -> dict[str, bytes]:
    """The GLB models by the name of their body."""
    return {entity.id: entity.models[0].data for entity in SceneUpdate.FromString(data).entities}


def points_message(
    topic: str, points: np.ndarray, colours: np.ndarray, frame: str, stamp: int, values: Mapping[str, np.ndarray] = {}
) -> Message:
    """A cloud of points (n, 3) [m] in float32, with colours (n, 3) uint8 sRGB, and further named values (n,).

    Raises ShapeError for arrays of other shapes.
    """
    n = len(checked("points", points, ("n", 3), np.float64))
    kinds = [(name, "<f4") for name in COORDINATES] + [(name, "u1") for name in CHANNELS]
    rows = np.zeros(n, kinds + [(name, "<f4") for name in values])
    for name, column in zip(COORDINATES, points.T, strict=True):
        rows[name] = column
    for name, column in zip(CHANNELS, checked("colours", colours, (n, 3), np.uint8).T, strict=False):
        rows[name] = column
    rows["alpha"] = 255
    for name, column in values.items():
        rows[name] = checked(name, column, (n,))
    value = PointCloud(frame_id=frame, point_stride=rows.itemsize, data=rows.tobytes())
    _set_time(value.timestamp, stamp)
    value.pose.orientation.w = 1.0
    for name, (dtype, offset, *_) in (rows.dtype.fields or {}).items():
        kind = PackedElementField.UINT8 if dtype == np.uint8 else PackedElementField.FLOAT32
        value.fields.add(name=name, offset=offset, type=kind)
    return _message(topic, value)


def captions_message(topic: str, captions: Mapping[str, tuple[str, np.ndarray]], stamp: int) -> Message:
    """Texts that face the viewer, each at a position (3,) [m] in the world, by name."""
    value = SceneUpdate()
    for name, (text, position) in captions.items():
        entity = value.entities.add(frame_id=WORLD, id=name)
        _set_time(entity.timestamp, stamp)
        caption = entity.texts.add(text=text, billboard=True, scale_invariant=True, font_size=CAPTION_SIZE)
        _set_vector(caption.pose.position, position)
        caption.pose.orientation.w = 1.0
        caption.color.r = caption.color.g = caption.color.b = caption.color.a = 1.0
    return _message(topic, value)


def image_message(topic: str, image: np.ndarray, encoding: str, frame: str, stamp: int) -> Message:
    """An image (H, W), in rgb8 (H, W, 3), of the encoding's type."""
    height, width = image.shape[:2]
    rows = np.ascontiguousarray(image, dtype=ENCODINGS[encoding])
    value = RawImage(
        frame_id=frame, width=width, height=height, encoding=encoding, step=rows.strides[0], data=rows.tobytes()
    )
    _set_time(value.timestamp, stamp)
    return _message(topic, value)


def image_of(data: bytes) -> np.ndarray:
    """The image (H, W) of a message, read-only."""
    value = RawImage.FromString(data)
    return np.frombuffer(value.data, ENCODINGS[value.encoding]).reshape(value.height, value.width)


def preview_message(topic: str, picture: np.ndarray, stamp: int) -> Message:
    """A picture (H, W, 3) uint8 sRGB as a PNG, in a frame of its own: it has fewer pixels than the depth images."""
    value = CompressedImage(frame_id=PREVIEW_FRAME, format="png", data=png_bytes(picture))
    _set_time(value.timestamp, stamp)
    return _message(topic, value)


def preview_of(data: bytes) -> np.ndarray:
    """The picture (H, W, 3) uint8 sRGB."""
    return read_png(CompressedImage.FromString(data).data)


def _set_time(stamp: Any, time: int) -> None:
    stamp.seconds, stamp.nanos = divmod(time, SECOND)


def _set_vector(vector: Any, xyz: np.ndarray) -> None:
    vector.x, vector.y, vector.z = xyz.tolist()


def _set_rotation(quaternion: Any, wxyz: np.ndarray) -> None:
    quaternion.w, quaternion.x, quaternion.y, quaternion.z = wxyz.tolist()


def _pose_of(vector: Any, q: Any) -> Pose:
    return Pose(np.array([q.w, q.x, q.y, q.z]), np.array([vector.x, vector.y, vector.z]))
