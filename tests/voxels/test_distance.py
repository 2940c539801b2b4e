"""Signed distance compared with closed forms, with Open3D, and with plain numpy for degenerate triangles."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kit1000.errors import InputError
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose
from kit1000.voxels import Grid, signed_distance
from tests.samples.shapes import MM, box, random_solid
from tests.samples.strategies import poses

ROTATED = Pose.from_rotvec((0.3, -0.7, 1.1), (0.2, -0.1, 0.05))
IDENTITY = Pose.identity()


def centred(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices - mesh.bounds.mean(0), mesh.faces)


def solid(seed: int) -> Mesh:
    return centred(mesh_from_solid(random_solid(seed)).scaled(MM))


def cuboid(x: float, y: float, z: float) -> Mesh:
    """In metres, about the origin."""
    return centred(mesh_from_solid(box(x, y, z)))


def box_distance(points: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Closed form for a box about the origin."""
    beyond = np.abs(points) - size / 2
    return np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(-1), 0)


def plain_distance(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """(n,) unsigned, by the closest point on every triangle in float64."""
    nearest = np.full(len(points), np.inf)
    for corners in mesh.triangles:
        nearest = np.minimum(nearest, triangle_distance(points, corners))
    return nearest


def triangle_distance(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    least, inside = np.full(len(points), np.inf), np.full(len(points), bool(normal.any()))
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = b - a
        share = np.clip((points - a) @ edge / max(edge @ edge, 1e-300), 0, 1)
        least = np.minimum(least, np.linalg.norm(points - a - share[:, None] * edge, axis=1))
        inside &= (points - a) @ np.cross(edge, normal) <= 0
    height = np.abs((points - corners[0]) @ normal) / max(np.linalg.norm(normal), 1e-300)
    return np.where(inside, height, least)


@given(size=st.tuples(*[st.floats(2e-3, 25e-3)] * 3), world_from_box=poses(), rotation=poses())
def test_a_box_in_any_pose_has_its_closed_form(size: tuple[float, ...], world_from_box: Pose, rotation: Pose) -> None:
    grid = Grid.centred(Pose(rotation.wxyz, world_from_box.xyz + 1e-3), (32, 30, 28), 1e-3)
    values = signed_distance(grid, [(cuboid(*size), world_from_box)], truncation=4e-3).values
    distance = box_distance(world_from_box.inverse().apply(grid.centres()), np.array(size))
    np.testing.assert_allclose(values, np.clip(distance / 4e-3, -1, 1), atol=1e-5)
    clear = np.abs(distance) > 1e-6 * grid.voxel_size
    np.testing.assert_array_equal((values < 0)[clear], (distance < 0)[clear])


@pytest.mark.parametrize("shift", [0.0, 0.5, 0.25])
def test_faces_exactly_on_voxel_centres_have_the_closed_form(shift: float) -> None:
    """Faces, edges and corners exactly on columns and centres of voxels: all ties."""
    mesh = Mesh(np.round(cuboid(8, 8, 8).vertices) + shift, cuboid(8, 8, 8).faces)
    grid = Grid.centred(IDENTITY, (21, 21, 21), 1.0)
    distance = box_distance(grid.centres() - shift, np.array([8, 8, 8]))
    values = signed_distance(grid, [(mesh, IDENTITY)], truncation=3.0).values
    np.testing.assert_allclose(values, np.clip(distance / 3, -1, 1), atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_open3d(seed: int) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    mesh, rng = solid(seed), np.random.default_rng(seed)
    pose = Pose.from_rotvec(rng.normal(size=3), rng.normal(size=3))
    grid = Grid.centred(Pose.from_rotvec(rng.normal(size=3), pose.xyz), (44, 44, 44), 1.1e-3)
    volume = signed_distance(grid, [(mesh, pose)])
    flat = volume.values.ravel()
    sample = rng.choice(np.flatnonzero(np.abs(flat) < 1), 4000)
    sample = np.concatenate([sample, rng.integers(0, flat.size, 2000)])
    points = (grid.world_from_grid.inverse() @ pose).inverse().apply(np.indices(grid.shape).reshape(3, -1).T * 1.1e-3)
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(mesh.vertices.astype(np.float32) * 1e3, mesh.faces.astype(np.uint32))
    query = open3d.core.Tensor((points[sample] * 1e3).astype(np.float32))
    distance = scene.compute_signed_distance(query, nthreads=1, nsamples=5).numpy() * 1e-3
    error = np.abs(flat[sample] - np.clip(distance / 5.5e-3, -1, 1)) * 5
    assert error.max() < 0.05  # [voxels]; it computes in float32 about each triangle's corners
    assert np.median(error) < 1e-4
    clear = np.abs(distance) > 1e-6
    np.testing.assert_array_equal((flat[sample] < 0)[clear], (distance < 0)[clear])


@pytest.fixture(autouse=True, scope="module")
def usb_for_open3d() -> None:
    """Load the libusb of a wheel, which open3d links to."""
    libusb = pytest.importorskip("libusb_package")
    ctypes.CDLL(str(libusb.get_library_path()), ctypes.RTLD_GLOBAL)


def needle_star() -> Mesh:
    """A closed fan of needles: faces 40 voxels long and down to 1e-12 wide, some without area."""
    angles = np.cumsum([0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.4, 0.9, 1.4, 1.4, 2.0])
    ring = np.stack([20 * np.cos(angles), 20 * np.sin(angles), 0.01 * angles], -1)
    vertices = np.concatenate([ring, [[0.3, 0.2, 6], [0.1, -0.2, -7]]])
    n = len(ring)
    around = [(i, (i + 1) % n) for i in range(n)]
    faces = [(a, b, n) for a, b in around] + [(b, a, n + 1) for a, b in around]
    return Mesh(vertices, np.array(faces, dtype=np.int32))


@pytest.mark.parametrize("world_from_centre", [IDENTITY, Pose.from_rotvec((0.5, 0.2, -0.9))])
def test_needles_and_faces_without_area_have_exact_distances(world_from_centre: Pose) -> None:
    mesh = needle_star()
    grid = Grid.centred(world_from_centre, (48, 46, 24), 1.0)
    values = signed_distance(grid, [(mesh, IDENTITY)], truncation=4.0).values.ravel()
    near = np.abs(values) < 1
    plain = plain_distance(grid.centres().reshape(-1, 3), mesh)
    assert near.sum() > 3000
    np.testing.assert_allclose(np.abs(values), np.minimum(plain / 4, 1), atol=2e-5)


def test_several_bodies_give_the_minimum_over_each() -> None:
    grid = Grid.centred(ROTATED, (40, 40, 40), 1e-3)
    bodies = [(cuboid(0.02, 0.01, 0.015), ROTATED), (solid(2), ROTATED @ Pose.from_translation((0.01, 0, 0)))]
    each = [signed_distance(grid, [body]).values for body in bodies]
    assert signed_distance(grid, bodies).values.tobytes() == np.minimum(*each).tobytes()


def test_without_bodies_all_voxels_are_free() -> None:
    assert (signed_distance(Grid((3, 3, 3), 1.0, IDENTITY), []).values == 1).all()


def test_a_body_may_extend_far_beyond_the_grid() -> None:
    mesh = cuboid(2.0, 3.0, 0.04)
    grid = Grid.centred(Pose.from_translation((0.5, 0.5, 0.02)), (20, 20, 20), 1e-3)
    distance = grid.centres()[..., 2] - 0.02
    np.testing.assert_allclose(
        signed_distance(grid, [(mesh, IDENTITY)]).values, np.clip(distance / 5e-3, -1, 1), atol=1e-5
    )
    deep = grid.moved(Pose.from_translation((0, 0, -0.02)))
    assert (signed_distance(deep, [(mesh, IDENTITY)], truncation=1e-3).values == -1).all()


def test_threads_change_no_byte() -> None:
    grid = Grid.centred(ROTATED, (90, 80, 70), 0.8e-3)
    volumes = [signed_distance(grid, [(solid(1), ROTATED)], threads=n).values for n in (1, 2, 7, None)]
    assert len({values.tobytes() for values in volumes}) == 1


GRID = Grid.centred(IDENTITY, (8, 8, 8), 1e-3)
CUBE = cuboid(4e-3, 4e-3, 4e-3)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        ([(CUBE, IDENTITY), (Mesh(CUBE.vertices, CUBE.faces[:-1]), IDENTITY)], r"bodies\[1\]: no inside.*3 open edges"),
        ([(Mesh(CUBE.vertices, CUBE.faces[:, ::-1].copy()), IDENTITY)], r"bodies\[0\]: no inside.*inside out"),
        ([(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), IDENTITY)], r"bodies\[0\]: no inside.*empty mesh"),
        ([(CUBE, Pose.identity((2,)))], r"bodies\[0\]: expected one pose, got \(2,\)"),
    ],
)
def test_invalid_bodies_are_rejected(bodies: list[Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        signed_distance(GRID, bodies)


def test_an_invalid_truncation_is_rejected() -> None:
    with pytest.raises(InputError, match=r"truncation: expected a distance above 0 m, got -1.0"):
        signed_distance(GRID, [(CUBE, IDENTITY)], truncation=-1)
