"""Depth images in closed form, and the likely cause of an image that differs from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kit1000.camera import Camera

DepthFormula = Callable[[Camera], np.ndarray]
"""Returns the depth image (H, W) [m] of a surface for a camera; 0 where there is none."""


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) the ray through each pixel centre, at depth 1."""
    return camera.unproject(np.ones((camera.height, camera.width)))


def plane_depths(normal: np.ndarray, distance: float) -> DepthFormula:
    """Depths of an infinite plane: all points p of the camera frame with normal . p = distance [m]."""

    def depths(camera: Camera) -> np.ndarray:
        facing = rays(camera) @ normal
        return np.where(facing * distance > 1e-9, distance / np.where(facing == 0, 1, facing), 0)

    return depths


def median_error(depth: np.ndarray, expected: np.ndarray) -> float:
    """Median absolute difference [m] where both images have a depth; infinite when there is no such pixel."""
    both = (depth > 0) & (expected > 0)
    return float(np.median(np.abs(depth[both] - expected[both]))) if both.any() else np.inf


def likely_cause(depth: np.ndarray, camera: Camera, formula: DepthFormula) -> str:
    """What a wrong depth image of a known surface looks like, for a message; empty when nothing fits."""
    true = formula(camera)
    along_rays = true * np.linalg.norm(rays(camera), axis=-1)
    shifted = [replace(camera, cx=camera.cx + u, cy=camera.cy + v) for u in (-0.5, 0, 0.5) for v in (-0.5, 0, 0.5)]
    errors = {
        "the image is upside down": median_error(depth, true[::-1]),
        "the image is mirrored left to right": median_error(depth, true[:, ::-1]),
        "the image is rotated by 180 degrees": median_error(depth, true[::-1, ::-1]),
        "depth is measured along the rays, not along the optical axis": median_error(depth, along_rays),
        "depth is in millimetres": median_error(depth, true * 1e3),
        "the image is half a pixel off, where pixel (u, v) must have its centre at (u, v)": min(
            median_error(depth, formula(camera)) for camera in shifted
        ),
    }
    best = min(errors, key=lambda cause: errors[cause])
    return f"; probably {best}" if errors[best] < 0.1 * median_error(depth, true) else ""
