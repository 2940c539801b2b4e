"""Depth images that are known by a formula, and what an image that misses them looks as if it had done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kit1000.camera import Camera

Known = Callable[[Camera], np.ndarray]
"""The depths (H, W) [m] that a camera sees of something; 0 where it sees nothing."""


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3): what each pixel centre looks along, at depth 1."""
    return camera.unproject(np.ones((camera.height, camera.width)))


def plane(normal: np.ndarray, distance: float) -> Known:
    """A plane without end: all points p of the camera frame with normal . p = distance [m]."""

    def depths(camera: Camera) -> np.ndarray:
        facing = rays(camera) @ normal
        return np.where(facing * distance > 1e-9, distance / np.where(facing == 0, 1, facing), 0)

    return depths


def misses(found: np.ndarray, wanted: np.ndarray) -> float:
    """Median distance [m] of depths that are there in both images; infinite where none is."""
    both = (found > 0) & (wanted > 0)
    return float(np.median(np.abs(found[both] - wanted[both]))) if both.any() else np.inf


def as_if(found: np.ndarray, camera: Camera, known: Known) -> str:
    """What an image that should show something known looks like it shows instead; empty where that is not known."""
    true = known(camera)
    halves = [replace(camera, cx=camera.cx + u, cy=camera.cy + v) for u in (-0.5, 0, 0.5) for v in (-0.5, 0, 0.5)]
    errors = {
        "upside down": misses(found, true[::-1]),
        "mirrored, left for right": misses(found, true[:, ::-1]),
        "turned by half a turn": misses(found, true[::-1, ::-1]),
        "measured along the rays and not along the optical axis": misses(
            found, true * np.linalg.norm(rays(camera), axis=-1)
        ),
        "in millimetres": misses(found, true * 1e3),
        "half a pixel off: pixel (u, v) has its centre at (u, v)": min(misses(found, known(half)) for half in halves),
    }
    best = min(errors, key=lambda said: errors[said])
    return f", as if {best}" if errors[best] < 0.1 * misses(found, true) else ""
