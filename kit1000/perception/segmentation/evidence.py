"""What the network of centres reads of an image."""

from __future__ import annotations

import numpy as np

from kit1000.perception.restoration.disparity import Evidence
from kit1000.perception.segmentation.bodies import Bodies
from kit1000.values import View


def evidence_of(bodies: Bodies) -> Evidence:
    """What the network reads of the bodies of an image: see `CentresNet.forward`; (H, W) arrays and `up` (3,)."""
    return evidence_between(bodies.measured, bodies.view)


def evidence_between(measured: View, restored: View) -> Evidence:
    """The same of a measured image and the restored one; (H, W) arrays and `up` (3,)."""
    return {
        "measured": _heights(measured),
        "restored": _heights(restored),
        "returned": measured.depth > 0,
        "up": measured.world_from_camera.inverse().rotate((0.0, 0.0, 1.0)).astype(np.float32),
    }


def _heights(view: View) -> np.ndarray:
    """(H, W) float32 [px] heights above the table, as long as they would be in the image; 0 without surface."""
    camera, pose = view.camera, view.world_from_camera
    x, y, z = pose.rotation_matrix()[2]
    across = (np.arange(camera.width) - camera.cx) / camera.fx * x
    down = (np.arange(camera.height) - camera.cy) / camera.fy * y
    seen = view.depth > 0
    height = pose.xyz[2] / np.where(seen, view.depth, 1.0) + across + down[:, None] + z
    return np.where(seen, camera.fx * height, 0.0).astype(np.float32)
