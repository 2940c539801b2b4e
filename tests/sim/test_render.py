"""Rendering: closed forms, brute-force rays and another ray caster see the same."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter

import kit1000
from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.pose import Pose, quaternion_from_rotvec, random_quaternions
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.raster import NEAR_PLANE
from kit1000.sim.render import RenderedImage, inverse_depths, render
from tests.samples.kits import QUICK, sample_kit, sample_part
from tests.samples.shapes import box as drawn_box

IDENTITY = Pose.identity()
SMALL = Camera(width=60, height=44, fx=70.0, fy=66.0, cx=28.3, cy=23.1)
VGA = Camera(width=640, height=480, fx=600.0, fy=600.0, cx=320.0, cy=240.0)
EDGE = 2e-3  # [px] coverage is exact in pixels / 4096; nearer to an edge than this either result is right


def mesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(shape.vertices), np.array(shape.faces, dtype=np.int32))


def box(*extents: float) -> Mesh:
    return mesh(trimesh.creation.box(extents=extents))


def sphere(radius: float, subdivisions: int = 2) -> Mesh:
    return mesh(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius))


def rectangle(z: float, half: float = 10.0, cells: int = 1) -> Mesh:
    """A square sheet facing the camera, cells x cells x 2 triangles."""
    line = np.linspace(-half, half, cells + 1)
    x, y = np.meshgrid(line, line)
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)
    corner = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (corner[i : cells + i, j : cells + j].ravel() for i in (0, 1) for j in (0, 1))
    return Mesh(vertices, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]).astype(np.int32))


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) points at depth 1 m behind each pixel centre."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def cast(camera: Camera, view: Pose, bodies: list[tuple[Mesh, Pose]]) -> tuple[np.ndarray, ...]:
    """Brute force: depth, ids, faces, and whether any edge passes within EDGE of the pixel centre."""
    direction = rays(camera).reshape(-1, 3)
    depth, near_edge = np.full(len(direction), np.inf), np.zeros(len(direction), bool)
    ids, faces = np.zeros(len(direction), int), np.full(len(direction), -1)
    for number, (shape, pose) in enumerate(bodies):
        corners = (view.inverse() @ pose).apply(shape.triangles)
        for face, (a, b, c) in enumerate(corners):
            normals = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)])  # of the planes eye - edge
            edges = direction @ normals.T
            slopes = np.hypot(normals[:, 0] / camera.fx, normals[:, 1] / camera.fy)
            distance = edges / np.maximum(slopes, 1e-300)  # [px] from the edges, signed
            with np.errstate(divide="ignore", invalid="ignore"):
                z = np.dot(np.cross(b - a, c - a), a) / (direction @ np.cross(b - a, c - a))
            inside = (distance > 0).all(1) | (distance < 0).all(1)
            loosely = (distance > -EDGE).all(1) | (distance < EDGE).all(1)
            near_edge |= loosely & (np.abs(distance) < EDGE).any(1)
            hit = inside & (z >= NEAR_PLANE) & (z < depth)
            depth[hit], ids[hit], faces[hit] = z[hit], number + 1, face
    depth[np.isinf(depth)] = 0
    shape = (camera.height, camera.width)
    return depth.reshape(shape), ids.reshape(shape), faces.reshape(shape), near_edge.reshape(shape)


def assert_same(a: RenderedImage, b: RenderedImage) -> None:
    for name in ("depth", "body_ids", "face_ids"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def scene(rng: np.random.Generator, distance: float) -> list[tuple[Mesh, Pose]]:
    """A box, a ball, a cylinder and a ring near the point (0, 0, distance), at random poses; in metres."""
    shapes = [
        box(0.5, 0.3, 0.4),
        sphere(0.25, 1),
        mesh(trimesh.creation.cylinder(radius=0.2, height=0.5, sections=9)),
        mesh(trimesh.creation.annulus(r_min=0.1, r_max=0.3, height=0.2, sections=7)),
    ]
    places = rng.uniform(-0.4, 0.4, (len(shapes), 3)) + np.array((0, 0, distance))
    return list(zip(shapes, Pose(random_quaternions(rng, len(shapes)), places), strict=True))


def test_an_empty_scene_renders_no_surface():
    image = render(SMALL, IDENTITY, [])
    assert image.depth.dtype == np.float32
    assert image.body_ids.dtype == np.int16
    assert not image.depth.any()
    assert not image.body_ids.any()
    assert (image.face_ids == -1).all()


def test_pixel_centres_are_at_integers():
    # A sheet whose left edge projects to column 10 exactly, its top edge to row 5: both belong to it.
    camera = Camera(width=32, height=24, fx=16.0, fy=16.0, cx=10.0, cy=5.0)
    corners = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float)
    sheet = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    ids = render(camera, IDENTITY, [(sheet, IDENTITY)]).body_ids
    rows, columns = np.nonzero(ids)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (5, 20, 10, 25)
    assert ids.sum() == 16 * 16


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 1.0, 3.0]))
def test_agrees_with_brute_force_rays(seed: int, distance: float):
    """Also with the camera among the bodies, where faces cross the near plane or lie behind it."""
    bodies = scene(np.random.default_rng(seed), distance)
    image = render(SMALL, IDENTITY, bodies)
    depth, ids, faces, near_edge = cast(SMALL, IDENTITY, bodies)
    clear = ~near_edge
    assert clear.mean() > 0.9
    np.testing.assert_array_equal(image.body_ids[clear], ids[clear])
    np.testing.assert_allclose(image.depth[clear], depth[clear], rtol=1e-6)
    np.testing.assert_array_equal(image.face_ids[clear], faces[clear])


@given(st.integers(0, 2**32 - 1))
def test_a_closed_surface_has_no_cracks(seed: int):
    """From inside a ball every pixel sees it, for every subdivision and every camera pose."""
    rng = np.random.default_rng(seed)
    ball = sphere(1.0, int(rng.integers(0, 5)))
    view = Pose(random_quaternions(rng, 1)[0], rng.uniform(-0.45, 0.45, 3))  # within the icosahedron, the coarsest
    assert render(VGA, view, [(ball, IDENTITY)]).body_ids.all()


def test_each_pixel_on_a_shared_edge_is_covered_once():
    """Two sheets that meet along a diagonal of pixel centres fill the image, in either order."""
    camera = Camera(width=16, height=16, fx=8.0, fy=8.0, cx=7.0, cy=7.0)
    corners = np.array([[-2, -2, 1], [2, -2, 1], [2, 2, 1], [-2, 2, 1]], float)
    upper = Mesh(corners, np.array([[0, 1, 2]], np.int32))
    lower = Mesh(corners, np.array([[0, 2, 3]], np.int32))
    one = render(camera, IDENTITY, [(upper, IDENTITY), (lower, IDENTITY)]).body_ids
    other = render(camera, IDENTITY, [(lower, IDENTITY), (upper, IDENTITY)]).body_ids
    assert one.all()
    np.testing.assert_array_equal(one, 3 - other)


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_bodies_changes_no_pixel(seed: int):
    rng = np.random.default_rng(seed)
    bodies = scene(rng, 1.5)
    order = rng.permutation(len(bodies))
    image, shuffled = render(SMALL, IDENTITY, bodies), render(SMALL, IDENTITY, [bodies[i] for i in order])
    np.testing.assert_array_equal(image.depth, shuffled.depth)
    np.testing.assert_array_equal(image.face_ids, shuffled.face_ids)
    np.testing.assert_array_equal(image.body_ids, np.concatenate([[0], order + 1])[shuffled.body_ids])


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_the_number_of_threads_changes_no_bit(threads: int):
    ball = sphere(0.3, 6)  # 81920 faces: several chunks
    bodies = [*scene(np.random.default_rng(5), 0.5), (ball, Pose.from_translation((0, 0, 1)))]
    assert_same(render(VGA, IDENTITY, bodies, threads=1), render(VGA, IDENTITY, bodies, threads=threads))


@given(seed=st.integers(0, 2**32 - 1), distance=st.floats(0.05, 0.4))
def test_inverse_depths_are_those_of_the_render(seed: int, distance: float):
    pose = Pose(random_quaternions(np.random.default_rng(seed), 1)[0], np.array([0.0, 0.0, distance]))
    body = box(0.1, 0.2, 0.3)  # part of it may be behind the camera
    depth, inverse = render(SMALL, IDENTITY, [(body, pose)]).depth, inverse_depths(SMALL, body, pose)
    assert np.array_equal(inverse > 0, depth > 0)
    assert np.array_equal((1 / inverse[inverse > 0]).astype(np.float32), depth[depth > 0])


def test_faces_without_area_and_faces_edge_on_are_harmless():
    vertices = np.array([[0, 0, 1], [1, 0, 1], [0.5, 0, 1], [0, 0, 2], [0, 0, 3], [0, 1, 1]], float)
    thin = Mesh(vertices, np.array([[0, 1, 2], [0, 3, 4], [0, 0, 1], [0, 3, 5]], np.int32))
    image = render(SMALL, IDENTITY, [(thin, IDENTITY), (rectangle(5.0), IDENTITY)])
    assert np.isfinite(image.depth).all()
    assert (image.depth >= 1).all()


def test_more_bodies_than_ids_are_rejected():
    with pytest.raises(InputError, match="at most 32767"):
        render(SMALL, IDENTITY, [(rectangle(1.0), IDENTITY)] * 32768)


def test_compiling_works_where_no_folder_is_writable(tmp_path: Path):
    """With a read-only package folder and home, functions are compiled in memory, with the same result."""
    package = Path(kit1000.__path__[0])
    copy = tmp_path / "site" / "kit1000"
    shutil.copytree(package, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "sim" / "__pycache__").write_text("a file where numba expects a folder")
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where numba expects a home")
    environment = {**os.environ, "PYTHONPATH": str(copy.parent), "PYTHONDONTWRITEBYTECODE": "1"}
    environment.pop("NUMBA_CACHE_DIR", None)
    environment |= {"HOME": str(blocked), "XDG_CACHE_HOME": str(blocked / "cache")}
    program = "import kit1000.sim.raster as r; print(r.floor_divide(-7, 2), r.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["-4", str(copy / "sim" / "raster.py")]


Bodies = list[tuple[Mesh, Pose]]
DEPTH_TOLERANCE = 1e-6  # [m] of the median, and of 9999 pixels in 10,000
MAX_DIFFERENT = 1e-4  # fraction of pixels, away from edges, that may see another body


@pytest.fixture(scope="module")
def bodies() -> Bodies:
    """A table, a tilted assembly of four kits, and their parts beside it: as made, and upside down."""
    kits = [sample_kit(family) for family in QUICK[:4]]
    sides = (SidePlate(0, 0.3), SidePlate(1, 0.5), SidePlate(3, 0.7))
    assembly = build_assembly("a", kits, AssemblyPlan(0.2, 1.0, sides))
    table = mesh_from_solid(drawn_box(1200, 1600, 40, (0, 0, -40))).scaled(1e-3)
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


def in_camera(bodies: Bodies, view: Pose) -> list[np.ndarray]:
    """(m, 3, 3) float32 corners of each body's faces, in the camera frame, where float32 is most accurate."""
    return [(view.inverse() @ pose).apply(mesh.triangles).astype(np.float32) for mesh, pose in bodies]


def by_embree(corners: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Depth [m] and body index + 1 of each pixel, 0 where no ray hits."""
    scene = EmbreeScene()
    TriangleMesh(scene, np.concatenate(corners))
    direction = rays(CAMERA).astype(np.float32).reshape(-1, 3)
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
