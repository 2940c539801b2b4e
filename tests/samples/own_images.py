"""Depth images as a user's camera would take them: a kit and parts of known size on a table, rendered, with noise."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.layout import table
from kit1000.sim.render import render

CAMERA = Camera(640, 480, 900.0, 905.0, 322.3, 238.1)
EYE = look_at((0.05, -0.45, 0.7), (0.0, 0.0, 0.0))
KIT = ((0.12, 0.10, 0.04), (0.02, 0.09))
"""Sides of a box [m], and where its middle is on the table [m]."""
PARTS = (((0.05, 0.03, 0.03), (-0.05, -0.06)), ((0.03, 0.025, 0.045), (0.07, -0.05)))
BASELINE = 0.055
CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])


def box(sides: Sequence[float], at: Sequence[float]) -> Mesh:
    """A box that stands on the table."""
    return Mesh(CORNERS * np.array(sides) + (*at, 0.0), table().faces)


@cache
def exact_depth(bodies: tuple = (KIT, *PARTS), eye: Pose = EYE) -> np.ndarray:
    """(H, W) float32 [m] of boxes on the table."""
    shapes = [(table(), Pose.identity()), *((box(*body), Pose.identity()) for body in bodies)]
    depth = render(CAMERA, eye, shapes).depth.copy()
    depth.setflags(write=False)
    return depth


def noisy_depth(depth: np.ndarray, noise_px: float = 0.05, seed: int = 0) -> np.ndarray:
    """The depths with white noise of the disparity [px], 0 where there is nothing."""
    noise = np.random.default_rng(seed).standard_normal(depth.shape) * noise_px / (CAMERA.fx * BASELINE)
    seen = depth > 0
    inverse = 1 / np.where(seen, depth, 1) + noise
    return np.where(seen, 1 / inverse, 0).astype(np.float32)


def millimetres(depth: np.ndarray) -> np.ndarray:
    """(H, W) uint16"""
    return np.rint(depth * 1e3).astype(np.uint16)
