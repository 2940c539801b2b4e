"""Small sample recordings with numbers that need full precision, and their comparison."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from kit1000.camera import Camera
from kit1000.dataset.json_rows import Row, pose_row
from kit1000.dataset.mcap_io import ObservationWriter, TruthWriter
from kit1000.dataset.scene_data import Observation, SceneTruth
from kit1000.pose import Pose
from kit1000.values import View

CAMERA = Camera(32, 24, 23.1, 23.2, 15.5, 11.75)
BIG = Camera(640, 480, 462.5, 462.5, 319.5, 239.5)
POSE = Pose.from_rotvec((0.1, -2.0, 0.3), (0.4, -0.0, 1 / 3))


def noise(camera: Camera, seed: int) -> np.ndarray:
    """An incompressible depth image on the depth grid."""
    steps = np.random.default_rng(seed).integers(0, 1 << 13, (camera.height, camera.width))
    return (steps / 8192).astype(np.float32)


def query(scene_id: str, part: int, guess: Pose | None = POSE) -> Row:
    told = {"id": f"{scene_id}-p{part}-snap", "track": "snap", "sensor": "ideal", "part": part, "drawn": part == 0}
    return told | {"pivot": [0.1, 1 / 3, -0.0], "guess": None if guess is None else pose_row(guess)}


def preview(k: int, camera: Camera) -> np.ndarray:
    """A picture with half the columns and rows of the camera, red growing to the right and green downward."""
    v, u = np.indices((camera.height // 2, camera.width // 2)) % 256
    return np.stack([u, v, np.full_like(u, k)], axis=-1).astype(np.uint8)


def observation(k: int = 0, camera: Camera = CAMERA, pose: Pose = POSE) -> Observation:
    scene_id = f"test-s{k:04d}"
    views = {"d415": View(camera, POSE, noise(camera, k)), "ideal": View(camera, pose, noise(camera, k + 100))}
    labels = (noise(camera, k) * 5).astype(np.uint8)
    return Observation(scene_id, views, labels, tuple(query(scene_id, part) for part in range(3)), preview(k, camera))


def extra_views(k: int = 0) -> Observation:
    keys = [f"three/{i}/{sensor}" for i in range(3) for sensor in ("ideal", "d415")]
    views = {key: View(CAMERA, Pose(POSE.wxyz, POSE.xyz + i), noise(CAMERA, i)) for i, key in enumerate(keys)}
    return Observation(f"test-s{k:04d}", views)


def truth(k: int = 0, pose: Pose = POSE) -> SceneTruth:
    scene_id = f"test-s{k:04d}"
    part = {"part_id": "test-0007", "family": "gear", "mount": 1, "world_from_part": pose_row(pose), "visible": 1 / 3}
    drawn = {"goal": 2, "turn": 0.1 + 0.2, "offset": [1e-3, -0.0, 5e-324], "rotvec": [0.0, 0.1, 0.2]}
    queries = {f"{scene_id}-p0-snap": {"part": 0, "goal_drawn": pose_row(pose), "draw": drawn}}
    seg = (noise(CAMERA, k) * 60000).astype(np.uint16)
    models = {"assemblies/test-0007": b"glTF" * 50, "parts/test-0007": bytes(range(256))}
    return SceneTruth(
        scene_id,
        "test-0007",
        pose,
        (part,),
        queries,
        seg,
        models,
        Pose.stack([pose, POSE]),
        k % 2 == 1,
        preview(k, CAMERA),
    )


def write(path: Path, scenes: list[Observation]) -> Path:
    with ObservationWriter(path) as writer:
        for scene in scenes:
            writer.add(scene)
    return path


def write_truth(path: Path, scenes: list[SceneTruth]) -> Path:
    with TruthWriter(path) as writer:
        for scene in scenes:
            writer.add(scene)
    return path


def same_pose(a: Pose, b: Pose) -> bool:
    return a.wxyz.tobytes() + a.xyz.tobytes() == b.wxyz.tobytes() + b.xyz.tobytes()


def same(a: Observation, b: Observation) -> bool:
    """To the bit."""
    assert (a.labels is None) == (b.labels is None)
    masks = a.labels is None or b.labels is None or np.array_equal(a.labels, b.labels)
    rows = json.dumps(a.queries, sort_keys=True) == json.dumps(b.queries, sort_keys=True)
    views = all(
        view.camera == b.views[key].camera
        and same_pose(view.world_from_camera, b.views[key].world_from_camera)
        and view.depth.tobytes() == b.views[key].depth.tobytes()
        for key, view in a.views.items()
    )
    ids = a.scene_id == b.scene_id and np.array_equal(a.preview, b.preview)  # type: ignore[arg-type]
    return masks and rows and views and ids and set(a.views) == set(b.views)
