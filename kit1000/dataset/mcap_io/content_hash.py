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


def compact_bytes(value: Any) -> bytes:
    """The canonical bytes of a JSON value, floats in full precision."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def observation_hash(observation: Observation) -> str:
    """The content hash of an observation, in hex, without the preview, which follows from the rest."""
    views = {key: {"camera": _camera_row(view.camera), "world_from_camera": pose_row(view.world_from_camera)}
             for key, view in observation.views.items()}  # fmt: skip
    record = {"scene_id": observation.scene_id, "views": views, "queries": list(observation.queries)}
    images = {key: view.depth for key, view in observation.views.items()}
    if observation.labels is not None:
        images["labels"] = observation.labels
    return _hash(record, images)


def truth_hash(truth: SceneTruth) -> str:
    """The content hash of a truth, in hex, without models and preview, which are for viewers."""
    goals = None if truth.goals is None else [pose_row(goal) for goal in truth.goals]
    return _hash(truth_row(truth) | {"goals": goals}, {"seg": truth.seg})


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


def _camera_row(camera: Camera) -> list[float]:
    return [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]


def _hash(record: Row, images: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256(compact_bytes(record))
    for name in sorted(images):
        image = np.ascontiguousarray(images[name], dtype=images[name].dtype.newbyteorder("<"))
        digest.update(compact_bytes([name, image.dtype.str, list(image.shape)]))
        digest.update(image.data)
    return digest.hexdigest()
