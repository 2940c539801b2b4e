"""Messages of ROS 2 and Foxglove as depth frames and intrinsics.

Fields have the names of both: `encoding`, `step` and `data` of raw images, `format` and `data` of compressed ones; K
and D of calibrations are capitals in Foxglove's schemas and small letters in those of ROS 2.
"""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
from PIL import Image

from kit1000.capture.depth_frames import DepthFrame
from kit1000.capture.intrinsics import Intrinsics
from kit1000.capture.known_sensors import known_baseline
from kit1000.errors import InputError
from kit1000.sim.sensors import Stream

RAW = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
"""Encodings of raw depth images, with their types."""
UNITS = {"u2": 1e-3, "f4": 1.0}  # [m], by REP 118 of ROS
RAW_SCHEMAS = ("sensor_msgs/msg/Image", "sensor_msgs/Image", "foxglove.RawImage", "foxglove_msgs/msg/RawImage")
PACKED_SCHEMAS = (
    "sensor_msgs/msg/CompressedImage",
    "sensor_msgs/CompressedImage",
    "foxglove.CompressedImage",
    "foxglove_msgs/msg/CompressedImage",
)
CAMERA_SCHEMAS = (
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/CameraInfo",
    "foxglove.CameraCalibration",
    "foxglove_msgs/msg/CameraCalibration",
)
PACKED_HEADER = struct.Struct("<iff")  # of compressedDepth: kind, and two numbers that quantise floats
LEAST_SHIFT = 0.5  # [px] between K and P, of which they are two matrices
PNG = b"\x89PNG\r\n\x1a\n"


def is_depth(message: Any, schema: str) -> bool:
    """Whether a message of RAW_SCHEMAS or PACKED_SCHEMAS is a depth image, by its encoding or its first bytes."""
    if schema in RAW_SCHEMAS:
        return message.encoding in RAW
    if "compressedDepth" in message.format:
        return True
    data = bytes(message.data[:32])
    return data.startswith(PNG) and data[24:26] == b"\x10\x00"  # 16 bits of grey


def frame_of(message: Any, schema: str, source: str) -> DepthFrame:
    """The frame of a message. Raises InputError if its bytes do not fit its size."""
    values = _raw_values(message, source) if schema in RAW_SCHEMAS else _packed_values(message, source)
    unit = UNITS["f4" if values.dtype.kind == "f" else "u2"]
    return DepthFrame(values, source, unit)


def intrinsics_of(message: Any, source: str, topic: str) -> Intrinsics:
    """The intrinsics of a calibration, of a depth topic, whose name may say which stream it is.

    Images that were rectified have the matrix P and no distortion, others K and D.

    Raises:
        InputError: it is not calibrated, its image is binned, or nothing says whether the image was rectified.
    """
    k, coefficients = np.array(_field(message, "k"), float), tuple(float(value) for value in _field(message, "d"))
    if k.size != 9 or k[0] <= 0:
        raise InputError(f"{source}: is not calibrated (K is {k.tolist()}); give --intrinsics")
    binning = max(int(getattr(message, "binning_x", 0)), int(getattr(message, "binning_y", 0)))
    if binning > 1:
        raise InputError(
            f"{source}: its image is binned {binning} times; record it without binning, or give --intrinsics"
        )
    p = np.array(_field(message, "p"), float).reshape(-1)
    rectified = np.array([p[0], p[5], p[2], p[6]]) if p.size == 12 and p[0] > 0 else None
    raw = k[[0, 4, 2, 5]]
    matrix = raw
    if rectified is not None and (any(coefficients) or not np.allclose(rectified, raw, atol=LEAST_SHIFT)):
        if _is_rectified(topic) is None:
            raise InputError(
                f"{source}: K with distortion is of the raw image (fx {raw[0]:.1f}), P of the rectified one (fx "
                f"{rectified[0]:.1f}), and the name of {topic} says neither; give --intrinsics of the image"
            )
        if _is_rectified(topic):
            matrix, coefficients = rectified, ()
    fx, fy, cx, cy = matrix.tolist()
    return Intrinsics(
        fx,
        fy,
        cx,
        cy,
        size=(int(message.width), int(message.height)),
        model=str(message.distortion_model) or "plumb_bob",
        coefficients=coefficients,
        device=topic if known_baseline(topic) else "",
        stream=_stream_of(topic),
        source=source,
    )


def _field(message: Any, name: str) -> list[float]:
    """The numbers of a calibration's field, whose name is a capital in Foxglove's schemas."""
    value = getattr(message, name, None)
    return list(getattr(message, name.upper(), ()) if value is None else value)


def _is_rectified(topic: str) -> bool | None:
    """Whether an image was rectified, by the name of its topic; None if the name does not say."""
    names = topic.lower().split("/")
    if any("rect" in name and "unrect" not in name for name in names):
        return True
    return False if any(name.startswith(("image_raw", "depth_raw", "unrect")) for name in names) else None


def frame_id_of(message: Any) -> str:
    """The coordinate frame of a message."""
    header = getattr(message, "header", None)
    return str(message.frame_id if header is None else header.frame_id)


def _stream_of(topic: str) -> Stream | None:
    """The stream, by the names that realsense2_camera gives, and by those of our own recordings."""
    if "aligned" in topic:
        return "aligned"
    return "raw" if topic.endswith(("/image_rect_raw", "/d415/depth")) or "/image_rect_raw/" in topic else None


def _raw_values(message: Any, source: str) -> np.ndarray:
    height, width, step, data = int(message.height), int(message.width), int(message.step), bytes(message.data)
    if message.encoding not in RAW:
        raise InputError(f"{source}: encoding {message.encoding}, expected {', '.join(RAW)}: not depths")
    order = ">" if getattr(message, "is_bigendian", 0) else "<"
    dtype = np.dtype(order + RAW[message.encoding])
    if step < width * dtype.itemsize or len(data) < step * height or width == 0 or height == 0:
        raise InputError(
            f"{source}: {len(data)} bytes for {width} x {height} px in steps of {step}: damaged; record again"
        )
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, : width * dtype.itemsize]
    return np.ascontiguousarray(rows).view(dtype).astype(dtype.newbyteorder("="))


def _packed_values(message: Any, source: str) -> np.ndarray:
    """The pixels of a PNG, for compressedDepth behind its header."""
    data = bytes(message.data)
    if "compressedDepth" not in message.format:
        return _png(data, source)
    if "rvl" in message.format:
        raise InputError(f"{source}: compressed by RVL; record with compressedDepth format png, or raw")
    if len(data) < PACKED_HEADER.size:
        raise InputError(f"{source}: an image of {len(data)} bytes: damaged; record again")
    _, scale, offset = PACKED_HEADER.unpack_from(data)
    values = _png(data[PACKED_HEADER.size :], source)
    if not message.format.startswith("32FC1"):
        return values
    steps = values.astype(np.float32)
    return np.where(steps > 0, np.float32(scale) / np.where(steps > 0, steps - np.float32(offset), 1), 0).astype(
        np.float32
    )


def _png(data: bytes, source: str) -> np.ndarray:
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
            if not picture.mode.startswith("I"):
                raise InputError(f"{source}: a picture in {picture.mode}, expected 16 bits of grey: not depths")
            return np.asarray(picture).astype(np.uint16)
    except (OSError, ValueError, SyntaxError, struct.error, Image.DecompressionBombError) as error:
        raise InputError(f"{source}: its PNG cannot be read ({' '.join(str(error).split())}): damaged") from None
