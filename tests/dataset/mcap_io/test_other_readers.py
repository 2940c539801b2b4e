"""Tests that docs/reference/recordings.md is enough to read a scene with the MCAP libraries and without kit1000."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from kit1000.camera import Camera, look_at
from kit1000.dataset.json_rows import pose_row
from kit1000.dataset.mcap_io import ObservationWriter, TruthWriter
from kit1000.dataset.mesh_files import glb_bytes, read_glb
from kit1000.dataset.scene_data import Observation, SceneTruth
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import View
from tests.samples.checkout import ROOT
from tests.samples.shapes import box, ell, lying_cylinder, standing

CAMERA = Camera(320, 180, 231.25, 231.25, 159.5, 89.5)
PAGE = ROOT / "docs/reference/recordings.md"


def bodies() -> list[tuple[Mesh, Pose]]:
    """A table, an L in place of the assembly, and a round bar as part 0."""
    return [
        (mesh_from_solid(standing(box(600, 800, 40, (0, 0, -40)))), Pose.identity()),
        (mesh_from_solid(standing(ell(120, 80, 40, 50))), Pose.from_rotvec((0, 0, 0.4), (0, 0.1, 0))),
        (mesh_from_solid(standing(lying_cylinder(30, 60))), Pose.from_rotvec((0, 0, 1.2), (0.02, -0.1, 0))),
    ]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with seen.mcap and truth.mcap of one scene."""
    folder, scene = tmp_path_factory.mktemp("stranger"), bodies()
    world_from_camera = look_at((0.45, 0.05, 0.5), (0, 0, 0))
    frame = render(CAMERA, world_from_camera, scene, threads=1)
    depth = np.round(frame.depth * 8192) / np.float32(8192)
    labels = np.maximum(frame.body_ids - 1, 0).astype(np.uint8)
    with ObservationWriter(folder / "seen.mcap") as seen:
        seen.add(Observation("test-s0000", {"ideal": View(CAMERA, world_from_camera, depth)}, labels))
    (assembly, world_from_assembly), (part, world_from_part) = scene[1:]
    row = {"part_id": "test-0000", "world_from_part": pose_row(world_from_part)}
    models = {"assemblies/test-0000": glb_bytes({"a": assembly}), "parts/test-0000": glb_bytes({"p": part})}
    with TruthWriter(folder / "truth.mcap") as truth:
        seg = frame.body_ids.astype(np.uint16)
        truth.add(SceneTruth("test-s0000", "test-0000", world_from_assembly, (row,), {}, seg, models))
    return folder


def distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(n,) [m] from points (n, 3) to the nearest of triangles (m, 3, 3), by brute force."""
    nearest = np.full(len(points), np.inf)
    for a, b, c in triangles:
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal)
        inside = np.ones(len(points), bool)
        for start, end in ((a, b), (b, c), (c, a)):
            inside &= (points - start) @ np.cross(normal, end - start) >= 0
            share = np.clip((points - start) @ (end - start) / np.sum((end - start) ** 2), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(points - start - share[:, None] * (end - start), axis=1))
        nearest = np.where(inside, np.minimum(nearest, np.abs((points - a) @ normal)), nearest)
    return nearest


def test_the_code_of_the_page_gives_a_point_cloud_on_the_scene(recorded: Path, tmp_path: Path) -> None:
    *_, script = re.findall(r"^```py\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)
    assert "kit1000" not in script
    command = [sys.executable, "-c", script, str(recorded / "seen.mcap"), str(tmp_path / "cloud.npz")]
    subprocess.run(command, check=True, timeout=60)
    cloud = np.load(tmp_path / "cloud.npz")
    for body, (mesh, world_from_body) in enumerate(bodies()):  # of labels 0, 1, 2
        points = cloud["points"][cloud["labels"] == body]
        assert len(points) > 100
        apart = distances(points, mesh.moved(world_from_body).triangles)
        assert np.median(apart) <= 0.1e-3
        assert apart.max() <= 0.25e-3  # a step of the grid is 0.12 mm


def test_models_are_at_the_poses_of_their_bodies(recorded: Path, tmp_path: Path) -> None:
    with open(recorded / "truth.mcap", "rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/scene"])
        (update,) = [value for _, _, _, value in messages]
    assert [entity.id for entity in update.entities] == ["assemblies/test-0000", "parts/test-0000"]
    for entity, (mesh, world_from_body) in zip(update.entities, bodies()[1:], strict=True):
        (model,) = entity.models
        assert (entity.frame_id, model.media_type) == ("world", "model/gltf-binary")
        (tmp_path / "model.glb").write_bytes(model.data)
        drawn = next(iter(read_glb(tmp_path / "model.glb").values()))  # y up turned to z up, as viewers do
        q, t = model.pose.orientation, model.pose.position
        pose = Pose(np.array([q.w, q.x, q.y, q.z]), np.array([t.x, t.y, t.z]))
        np.testing.assert_allclose(pose.apply(drawn.vertices), world_from_body.apply(mesh.vertices), atol=1e-8)


def test_the_layout_shows_topics_that_recordings_have() -> None:
    layout = json.loads((ROOT / "docs/assets/foxglove-layout.json").read_text(encoding="utf-8"))
    documented = set(re.findall(r"`(/[a-z0-9/]+)`", PAGE.read_text(encoding="utf-8")))
    panels = layout["configById"]
    modes = [panel["imageMode"] for panel in panels.values() if "imageMode" in panel]
    shown = {*panels["3D!scene"]["topics"], *(mode[key] for mode in modes for key in mode if key.endswith("Topic"))}
    assert shown <= documented
    assert panels["3D!scene"]["followTf"] == "world"
    used = json.dumps([layout["layout"], panels["Tab!images"]])
    assert all(name in used for name in panels)
