"""First poses: the faces that a shape can stand on, and a start near the truth for every body."""

from __future__ import annotations

import numpy as np
import pytest
from manifold3d import Manifold

from kit1000.labelling.body_windows import body_windows
from kit1000.labelling.scene_registration import ShapeDistance
from kit1000.labelling.standing_plane import seen_support
from kit1000.labelling.starting_poses import KnownShape, stable_normals, starts
from kit1000.mesh import mesh_from_solid
from kit1000.pose import Pose, random_quaternions
from tests.samples.labelled_scenes import sample_scene


def test_a_box_stands_on_its_six_faces_the_largest_first() -> None:
    mesh = mesh_from_solid(Manifold.cube((0.05, 0.03, 0.01), center=True))
    normals = stable_normals(mesh)
    assert len(normals) == 6
    assert np.allclose(np.abs(normals[:2]), (0, 0, 1), atol=1e-9)
    assert np.allclose(np.abs(normals[-2:]), (1, 0, 0), atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_faces_turn_with_the_shape(seed: int) -> None:
    mesh = mesh_from_solid(Manifold.cube((0.05, 0.03, 0.01), center=True))
    pose = Pose(random_quaternions(np.random.default_rng(seed), 1)[0], np.array([0.1, 0.0, 0.2]))
    turned = pose.inverse().rotate(stable_normals(mesh.moved(pose)))
    for normal in stable_normals(mesh):
        assert (turned @ normal).max() > 1 - 1e-6


def test_a_pencil_does_not_stand_on_its_tip() -> None:
    mesh = mesh_from_solid(Manifold.cylinder(0.06, 0.0, 0.004, 12))
    normals = stable_normals(mesh)
    assert (normals[:, 2] > -0.5).all()
    assert (normals[:, 2] > 0.99).any()  # its base


def test_the_first_start_is_near_the_truth() -> None:
    scene = sample_scene()
    windows, support = body_windows(scene.image), seen_support(scene.image)
    for label, (part, pose) in enumerate(zip(scene.kits.parts, scene.world_from_parts, strict=True), start=2):
        found = starts(KnownShape.of(part.id, part.mesh), windows[label], support, 24)
        assert [start.cost for start in found] == sorted(start.cost for start in found)
        distance = ShapeDistance(part.mesh)
        nearest = [distance.between(scene.camera_from_world @ pose, s.placed.camera_from_body) for s in found[:8]]
        assert min(nearest) < 6e-3
