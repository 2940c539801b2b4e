"""The renderer compared with an independent ray caster, Embree's, on a full-size scene."""

from __future__ import annotations

import numpy as np
import pytest
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.ndimage import maximum_filter, minimum_filter

from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose, quaternion_from_rotvec
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.render import render
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import box

Bodies = list[tuple[Mesh, Pose]]
DEPTH_TOLERANCE = 1e-6  # [m] of the median, and of 9999 pixels in 10,000
MAX_DIFFERENT = 1e-4  # fraction of pixels, away from edges, that may see another body


@pytest.fixture(scope="module")
def bodies() -> Bodies:
    """A table, a tilted assembly of four kits, and their parts beside it: as made, and upside down."""
    kits = [sample_kit(family) for family in QUICK[:4]]
    sides = (SidePlate(0, 0.3), SidePlate(1, 0.5), SidePlate(3, 0.7))
    assembly = build_assembly("a", kits, AssemblyPlan(0.2, 1.0, sides))
    table = mesh_from_solid(box(1200, 1600, 40, (0, 0, -40))).scaled(1e-3)
    placed = [(table, Pose.identity()), (assembly.mesh, Pose.from_rotvec((0, 0, 0.7), (0, 0.2, 0)))]
    for i, family in enumerate(QUICK[:4]):
        mesh, rotation = sample_part(family).mesh, quaternion_from_rotvec((0, np.pi * (i % 2), 0.9 * i))
        placed.append((mesh, standing(mesh, rotation, (0.08 * (i % 2) - 0.04, -0.24 + 0.08 * (i // 2)))))
    return placed


def standing(mesh: Mesh, wxyz: np.ndarray, place: tuple[float, float]) -> Pose:
    """The pose of the mesh in this rotation, on the table."""
    rotation = Pose(wxyz, np.zeros(3))
    return Pose(wxyz, np.array([*place, -rotation.apply(mesh.vertices)[:, 2].min()]))


@pytest.fixture(scope="module", params=range(3))
def view(request: pytest.FixtureRequest) -> Pose:
    return draw_primary_pose(np.random.default_rng(request.param))


def rays() -> np.ndarray:
    """(H, W, 3) float32: the point at depth 1 m behind each pixel, so that the length along a ray is the depth."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    ray = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    return ray.astype(np.float32)


def in_camera(bodies: Bodies, view: Pose) -> list[np.ndarray]:
    """(m, 3, 3) float32 corners of each body's faces, in the camera frame, where float32 is most accurate."""
    return [(view.inverse() @ pose).apply(mesh.triangles).astype(np.float32) for mesh, pose in bodies]


def by_embree(corners: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Depth [m] and body index + 1 of each pixel, 0 where no ray hits."""
    scene = EmbreeScene()
    TriangleMesh(scene, np.concatenate(corners))
    direction = rays().reshape(-1, 3)
    hit = scene.run(np.zeros_like(direction), direction, output=True)
    body_of = np.repeat(np.arange(len(corners)), [len(c) for c in corners])
    ids = np.where(hit["primID"] < 0, 0, body_of[hit["primID"]] + 1)
    return as_image(np.where(ids > 0, hit["tfar"], 0)), as_image(ids)


def as_image(values: np.ndarray) -> np.ndarray:
    return values.reshape(CAMERA.height, CAMERA.width)


def test_embree_sees_the_same(bodies: Bodies, view: Pose):
    """Depths equal within DEPTH_TOLERANCE where both hit; bodies equal a pixel away from every edge of either image."""
    image, (depth, ids) = render(CAMERA, view, bodies), by_embree(in_camera(bodies, view))
    both = (image.body_ids > 0) & (ids > 0)
    assert both.mean() > 0.5
    difference = np.abs(image.depth[both] - depth[both])
    assert np.median(difference) < DEPTH_TOLERANCE
    assert np.quantile(difference, 0.9999) < DEPTH_TOLERANCE
    inner = np.all([maximum_filter(seen, 3) == minimum_filter(seen, 3) for seen in (image.body_ids, ids)], axis=0)
    assert inner.mean() > 0.9
    assert (image.body_ids != ids)[inner].mean() < MAX_DIFFERENT
