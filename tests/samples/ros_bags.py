"""Recordings as ROS 2 writes them, of the depth images of a bench."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer
from PIL import Image

from kit1000.capture.depth_files import read_groups
from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.options import ImportOptions
from tests.samples.own_images import CAMERA, exact_depth, millimetres

HEADER = """std_msgs/Header header
{}
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE = HEADER.format("uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data")
COMPRESSED = HEADER.format("string format\nuint8[] data")
INFO = HEADER.format(
    "uint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[12] p\n"
    "uint32 binning_x\nuint32 binning_y"
)
SCHEMAS = {"Image": IMAGE, "CompressedImage": COMPRESSED, "CameraInfo": INFO}
DEPTH = millimetres(exact_depth())
FOLDER = "/camera/depth"
RECT = f"{FOLDER}/image_rect_raw"
FRAME = "depth_optical"


def stamped(frame: str = FRAME) -> dict[str, Any]:
    return {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": frame}


def image(values: np.ndarray = DEPTH, encoding: str = "16UC1", frame: str = FRAME, **changes: Any) -> dict[str, Any]:
    height, width = values.shape[:2]
    rows = np.ascontiguousarray(values)
    row = {"height": height, "width": width, "encoding": encoding, "is_bigendian": 0, "step": rows.strides[0]}
    return {"kind": "Image", "header": stamped(frame), **row, "data": rows.tobytes(), **changes}


def compressed(
    values: np.ndarray = DEPTH, form: str = "16UC1; compressedDepth png", head: tuple = (0, 0.0, 0.0)
) -> dict:
    file = io.BytesIO()
    Image.fromarray(values).save(file, "PNG")
    data = struct.pack("<iff", *head) + file.getvalue()
    return {"kind": "CompressedImage", "header": stamped(), "format": form, "data": data}


def info(**changes: Any) -> dict[str, Any]:
    size = {"height": CAMERA.height, "width": CAMERA.width}
    k = [CAMERA.fx, 0.0, CAMERA.cx, 0.0, CAMERA.fy, CAMERA.cy, 0.0, 0.0, 1.0]
    p = [CAMERA.fx, 0.0, CAMERA.cx, 0.0, 0.0, CAMERA.fy, CAMERA.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    row = {"distortion_model": "plumb_bob", "d": [0.0] * 5, "k": k, "p": p, "binning_x": 0, "binning_y": 0}
    return {"kind": "CameraInfo", "header": stamped(), **size, **row, **changes}


def bag(path: Path, *messages: tuple[str, dict[str, Any]]) -> Path:
    """A ROS 2 bag of messages by topic."""
    with path.open("wb") as file:
        writer = Writer(file)
        schemas = {name: writer.register_msgdef(f"sensor_msgs/msg/{name}", text) for name, text in SCHEMAS.items()}
        for time, (topic, row) in enumerate(messages, start=1):
            values = {key: value for key, value in row.items() if key != "kind"}
            writer.write_message(topic, schemas[row["kind"]], values, time, time)
        writer.finish()
    return path


def read(path: Path, **selection: Any) -> list[DepthFrame]:
    (group,) = read_groups([path], ImportOptions(sources=(), out=path, **selection))
    return group


CALIBRATED = (f"{FOLDER}/camera_info", info())
