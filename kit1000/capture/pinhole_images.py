"""One depth image without distortion, at the focal length that perception knows. Depth is never interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.camera import Camera
from kit1000.capture.intrinsics import Intrinsics, distorted
from kit1000.errors import InputError

FOCAL = 925.0  # [px] of the images that the networks learned from
KEPT = 1.25  # an image stays as it is up to this ratio of focal lengths
MOST_SIDE = 1920  # [px] of a resampled image
LEAST_KEPT = 0.3  # of the share of pixels with a depth, when distortion is undone


@dataclass(frozen=True, eq=False)
class PinholeImage:
    """A depth image and its camera."""

    camera: Camera
    depth: np.ndarray  # (H, W) float32 [m], 0 without a return
    enlarged: float = 1.0  # number of its pixels for one of the recorded image, along a row


def pinhole_image(depth: np.ndarray, intrinsics: Intrinsics, source: str) -> PinholeImage:
    """The image of recorded depths (H, W) [m]: distortion undone, sides even, focal length near FOCAL.

    Each pixel takes the depth of the nearest recorded one. source: name of the image, for messages.
    """
    camera = intrinsics.camera(depth.shape, source)
    factor = _factor(camera)
    target = _even(camera if factor == 1 else camera.scaled(factor))
    if intrinsics.distorted:
        intrinsics.forward_model  # noqa: B018 (raises where distortion cannot be undone)
    if intrinsics.distorted or factor != 1:
        found = _looked_up(depth, intrinsics, target)
        if np.count_nonzero(found) * depth.size < LEAST_KEPT * np.count_nonzero(depth) * found.size:
            raise InputError(
                f"{intrinsics.source}: its distortion maps most of {source} outside: is it of this camera?"
            )
        return PinholeImage(target, found, factor)
    return PinholeImage(target, np.ascontiguousarray(depth[: target.height, : target.width]))


def _factor(camera: Camera) -> float:
    """The ratio by which an image is enlarged."""
    ratio = FOCAL / np.sqrt(camera.fx * camera.fy)
    if 1 / KEPT <= ratio <= KEPT:
        return 1.0
    return float(min(ratio, MOST_SIDE / max(camera.width, camera.height)))


def _even(camera: Camera) -> Camera:
    """The same camera without its last row or column where their number is odd."""
    return Camera(camera.width // 2 * 2, camera.height // 2 * 2, camera.fx, camera.fy, camera.cx, camera.cy)


def _looked_up(depth: np.ndarray, intrinsics: Intrinsics, target: Camera) -> np.ndarray:
    """(H, W) the recorded depth at which each pixel of a target looks; 0 where that is outside."""
    x = (np.arange(target.width) - target.cx) / target.fx
    y = ((np.arange(target.height) - target.cy) / target.fy)[:, None]
    x, y = np.broadcast_arrays(x, y)
    if intrinsics.distorted:
        x, y = distorted(x, y, intrinsics.coefficients)
    u = np.rint(x * intrinsics.fx + intrinsics.cx)
    v = np.rint(y * intrinsics.fy + intrinsics.cy)
    height, width = depth.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    rows, columns = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
    return np.where(inside, depth[rows, columns], 0).astype(np.float32)
