"""Writes a depth image as a ROS 2 bag in MCAP, by code that is not ours.

    python bench/outside/ros_bag.py depth.npz BAG --kind raw

Runs in an environment of its own with `pip install rosbags`. depth.npz holds `depth` (H, W) uint16 [mm], `intrinsics`
fx, fy, cx, cy [px], and `png`, the bytes of the image as a PNG. The bag holds a colour image too, as bags do.
"""

from __future__ import annotations

import argparse
import struct
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Writer  # pyright: ignore[reportMissingImports]
from rosbags.rosbag2.enums import StoragePlugin  # pyright: ignore[reportMissingImports]
from rosbags.typesys import Stores, get_typestore  # pyright: ignore[reportMissingImports]

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES: Any = STORE.types
FOLDER = "/camera/camera/depth"
TOPIC = f"{FOLDER}/image_rect_raw"
FRAME = "camera_depth_optical_frame"
SECOND = 1_000_000_000  # [ns]


def main() -> None:
    """Write the bag."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("image", type=Path)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--kind", choices=("raw", "compressed"), default="raw")
    options = parser.parse_args()
    with np.load(options.image, allow_pickle=False) as file:
        depth, intrinsics, png = file["depth"], file["intrinsics"], file["png"]
    messages = {f"{FOLDER}/camera_info": camera_info(depth.shape, intrinsics)}
    if options.kind == "raw":
        messages[TOPIC] = image(depth, "16UC1", FRAME)
    else:
        header = struct.pack("<iff", 0, 0.0, 0.0)
        packed = np.frombuffer(header + png.tobytes(), np.uint8)
        kind = TYPES["sensor_msgs/msg/CompressedImage"]
        messages[f"{TOPIC}/compressedDepth"] = kind(stamped(FRAME), "16UC1; compressedDepth png", packed)
    colour = np.zeros((48, 64 * 3), np.uint8)
    messages["/camera/camera/color/image_raw"] = image(colour, "rgb8", "camera_color_optical_frame", 64)
    with Writer(options.bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, message in messages.items():
            connection = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            writer.write(connection, SECOND, STORE.serialize_cdr(message, message.__msgtype__))


def stamped(frame: str) -> Any:
    """A header of a frame."""
    return TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](1, 0), frame)


def image(rows: np.ndarray, encoding: str, frame: str, width: int | None = None) -> Any:
    """A raw image of rows."""
    data = np.ascontiguousarray(rows).view(np.uint8)
    kind = TYPES["sensor_msgs/msg/Image"]
    return kind(stamped(frame), len(rows), width or rows.shape[1], encoding, 0, data.shape[1], data.ravel())


def camera_info(shape: tuple[int, ...], intrinsics: np.ndarray) -> Any:
    """The calibration of the depth camera, without distortion."""
    fx, fy, cx, cy = intrinsics
    matrix = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    projection = np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0])
    region = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    kind = TYPES["sensor_msgs/msg/CameraInfo"]
    numbers = (np.zeros(5), matrix, np.eye(3).ravel(), projection)
    return kind(stamped(FRAME), shape[0], shape[1], "plumb_bob", *numbers, 0, 0, region)


if __name__ == "__main__":
    main()
