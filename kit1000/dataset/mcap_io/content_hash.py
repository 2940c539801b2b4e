"""The content of a recording, independent of its file format: canonical JSON, and the content hash of a scene.

The content hash is the SHA-256 of the scene's JSON and its arrays (little-endian, C order, each after its name, type
and shape), so it does not change with the version of the libraries that serialise and compress.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from kit1000.camera import Camera
from kit1000.dataset.json_rows import Row, pose_row
from kit1000.dataset.scene_data import Observation, SceneTruth
from kit1000.errors import InputError
from kit1000.sim.sensors import DEPTH_GRID


def compact_bytes(value: Any, what: str) -> bytes:
    """The canonical bytes of a JSON value, floats in full precision; `what` starts the error message."""
    try:
        return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: expected plain JSON values and finite numbers ({error})") from error


def observation_hash(observation: Observation) -> str:
    """The content hash of an observation, in hex, without the preview, which follows from the rest."""
    views = {key: {"camera": _camera_row(view.camera), "world_from_camera": pose_row(view.world_from_camera)}
             for key, view in observation.views.items()}  # fmt: skip
    record = {"scene_id": observation.scene_id, "views": views, "queries": list(observation.queries)}
    images = {key: view.depth for key, view in observation.views.items()}
    if observation.labels is not None:
        images["labels"] = observation.labels
    return _hash(record, images, observation.scene_id)


def truth_hash(truth: SceneTruth) -> str:
    """The content hash of a truth, in hex, without models and preview, which are for viewers."""
    goals = None if truth.goals is None else [pose_row(goal) for goal in truth.goals]
    return _hash(truth_row(truth) | {"goals": goals}, {"seg": truth.seg}, truth.scene_id)


def truth_row(truth: SceneTruth) -> Row:
    """The truth as one JSON value, without images, models and goals."""
    return {
        "scene_id": truth.scene_id,
        "assembly_id": truth.assembly_id,
        "world_from_assembly": pose_row(truth.world_from_assembly),
        "crowded": truth.crowded,
        "noise_px": dict(truth.noise_px),
        "parts": list(truth.parts),
        "queries": dict(truth.queries),
    }


def check_on_grid(depth: np.ndarray, what: str) -> None:
    """Raise InputError when a depth (H, W) [m] is negative, not finite, or no multiple of GRID."""
    steps = depth * np.float32(1 / DEPTH_GRID)
    good = (steps >= 0) & (steps < np.inf) & (steps == np.rint(steps))
    if not good.all():
        v, u = (int(i) for i in np.argwhere(~good)[0])
        raise InputError(
            f"{what}: depth {depth[v, u]} m at pixel ({u}, {v}), expected a multiple of 2^-13 m from 0 up "
            "(kit1000.sim.sensors rounds to it)"
        )


def _camera_row(camera: Camera) -> list[float]:
    return [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]


def _hash(record: Row, images: Mapping[str, np.ndarray], what: str) -> str:
    digest = hashlib.sha256(compact_bytes(record, what))
    for name in sorted(images):
        image = np.ascontiguousarray(images[name], dtype=images[name].dtype.newbyteorder("<"))
        digest.update(compact_bytes([name, image.dtype.str, list(image.shape)], what))
        digest.update(image.data)
    return digest.hexdigest()
