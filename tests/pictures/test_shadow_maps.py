"""Shadow maps against the renderer of depth images, seen from far away."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from manifold3d import Manifold

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pictures.shadow_maps import shadow_maps
from kit1000.pose import Pose
from kit1000.sim.render import render

SIZE, DISTANCE, TEXEL = 128, 500.0, 0.01
SHAPES = {
    "cube": mesh_from_solid(Manifold.cube((0.4, 0.3, 0.2), center=True)),
    "ball": mesh_from_solid(Manifold.sphere(0.4, 40)),
    "ring": mesh_from_solid(Manifold.cylinder(0.1, 0.5, 0.5, 60) - Manifold.cylinder(1, 0.3, 0.3, 60)),
}


def maps_from_far(mesh: Mesh, world_from_lamp: Pose) -> tuple[np.ndarray, np.ndarray]:
    map_from_world = world_from_lamp.inverse().matrix()[:3].copy()
    map_from_world[:2] /= TEXEL
    map_from_world[:2, 3] += (SIZE - 1) / 2
    camera = Camera(SIZE, SIZE, DISTANCE / TEXEL, DISTANCE / TEXEL, (SIZE - 1) / 2, (SIZE - 1) / 2)
    far = render(camera, world_from_lamp, [(mesh, Pose.identity())], threads=1).depth
    return shadow_maps(mesh.triangles, map_from_world[None], SIZE)[0], far


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (1.0, -0.4, 0.3), (-0.2, 0.5, 0.7)])
def test_a_map_is_a_depth_image_from_far_away(shape: str, direction: tuple[float, float, float]) -> None:
    away = np.array(direction) / np.linalg.norm(direction)
    up = (0, 0, 1) if abs(away[2]) < 0.9 else (0, 1, 0)
    own, far = maps_from_far(SHAPES[shape], look_at(np.zeros(3) + DISTANCE * away, np.zeros(3), up=up))
    both = (own > 0) & (far > 0)
    assert both.sum() > 400
    assert ((own > 0) != (far > 0)).mean() < 0.01  # along the outline
    assert np.quantile(np.abs(own - far)[both], 0.98) < TEXEL / 2


def test_the_nearest_surface_counts_and_triangles_outside_do_not() -> None:
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0]])
    corners = np.array([square, square + [0, 0, 0.5], square + [50, 0, 2.0]])
    down = np.array([[[10.0, 0, 0, 20], [0, 10.0, 0, 20], [0, 0, -1, 4]]])
    found = shadow_maps(corners, down, 40)[0]
    assert found[15, 25] == np.float32(3.5)
    assert set(np.unique(found)) == {0, np.float32(3.5)}


def test_triangles_that_share_an_edge_leave_no_gap() -> None:
    rng = np.random.default_rng(3)
    centre = rng.uniform(10, 30, 2)
    rim = np.array([[0, 0], [40, 0], [40, 40], [0, 40], [0, 0]]) - 0.5
    corners = np.array([[[*a, 0], [*b, 0], [*centre, 0]] for a, b in pairwise(rim)])
    assert (shadow_maps(corners, np.eye(3, 4)[None] + np.array([0, 0, 0, 1.0]) * [[0], [0], [1]], 40) == 1).all()
