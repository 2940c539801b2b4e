"""Volumes compared with other implementations, timed in one run: milliseconds, ratio, agreement.

    .venv/bin/python bench/speed/voxels.py

The TSDF of one depth image is compared with two implementations in numpy: `plain`, slab by slab in float32, and
`release`, the algorithm of the paper's release (the world coordinates of all voxels in one array, then operations on
whole arrays in float64). The signed distance of a part is compared with open3d's exact distance, which is computed for
every second voxel along each axis; its time counts eight times.
"""

from __future__ import annotations

import ctypes
import resource
import time
from collections.abc import Callable
from typing import Any, TypeVar

import libusb_package
import numpy as np
import trimesh
import tyro

from kit1000.camera import Camera, look_at
from kit1000.errors import Kit1000Error
from kit1000.mesh import Mesh
from kit1000.parts.catalog import FAMILIES
from kit1000.parts.family import make_part
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.render import render
from kit1000.values import View
from kit1000.voxels import Grid, Volume, fuse, signed_distance, tsdf

T = TypeVar("T")

VOXEL = 0.89e-3  # [m] as in the paper
SHAPES = ((128, 128, 128), (400, 400, 256))  # of a part and of a kit
CAMERA = Camera(1280, 720, 925, 925, 639.5, 359.5)
DENSE_SPHERE = 6  # subdivisions: 81,920 faces
EIGHTH = (slice(None, None, 2),) * 3


def main(repeats: int = 9, threads: int | None = None, release: bool = True) -> None:
    """Time volumes.

    Args:
        repeats: number of timings of each; the fastest counts.
        threads: number of threads of ours; all cores by default. numpy uses one, open3d all.
        release: also time the release's algorithm (needs 8 GB of memory for the larger grid).
    """
    bodies = sample_bodies()
    eye = look_at((0.45, 0.2, 0.5), (0, 0, 0))
    view = View(CAMERA, eye, render(CAMERA, eye, bodies).depth)
    print(f"{'one 1280x720 image':34}{'ms':>10}{'ratio':>12}{'differing':>12}{'max error':>12}")
    for shape in SHAPES:
        grid = Grid.centred(Pose.from_translation((0, 0, 0.02)), shape, VOXEL)
        ours = print_tsdf(grid, view, repeats, threads, release)
        print(f"{'':6}known {ours.known.mean():.1%}, peak memory of this process {peak_gb():.1f} GB")
    print(f"{'signed distance, 128^3':34}{'ms':>10}{'ratio':>12}{'wrong signs':>12}{'max, voxels':>12}")
    for name, mesh in solids():
        print_signed_distance(name, mesh, repeats, threads)


def print_tsdf(grid: Grid, view: View, repeats: int, threads: int | None, release: bool) -> Volume:
    """Print one line each for ours, plain numpy and the release's algorithm."""
    ours = tsdf(grid, view, threads=threads)  # numba compiles in the first call
    seconds = timed(lambda: tsdf(grid, view, threads=threads), repeats)[0]
    title = "x".join(map(str, grid.shape))
    print(f"{title + ', ours':34}{seconds * 1e3:10.1f}{1:12.1f}")
    for name, other in (("plain numpy", plain_tsdf), ("release's algorithm", release_tsdf))[: 1 + release]:
        other_seconds, values = timed(lambda make=other: make(grid, view), min(repeats, 3))
        known = ours.known & ~np.isnan(values)
        gap = np.abs(ours.values - values)[known]
        differ = np.mean(ours.known != ~np.isnan(values)) + np.mean(gap > 1e-3)
        largest = gap[gap <= 1e-3].max()
        ratio = other_seconds / seconds
        print(f"{title + ', ' + name:34}{other_seconds * 1e3:10.1f}{ratio:12.1f}{differ:12.5%}{largest:12.1e}")
    return ours


def print_signed_distance(name: str, mesh: Mesh, repeats: int, threads: int | None) -> None:
    """Print the times of ours and of open3d's exact distance, and the error of a fusion of several views."""
    grid = Grid.centred(Pose.from_rotvec((0.3, -0.5, 0.2)), SHAPES[0], VOXEL)
    body = [(mesh, Pose.identity())]
    signed_distance(grid, body, threads=threads)
    seconds, ours = timed(lambda: signed_distance(grid, body, threads=threads), repeats)
    print(f"{f'{name}, {len(mesh.faces)} faces, ours':34}{seconds * 1e3:10.1f}{1:12.1f}")
    other_seconds, distance = exact_distance(grid, mesh)
    gap = np.abs(ours.values[EIGHTH] * 5 - np.clip(distance / VOXEL, -5, 5))
    signs = np.sum((distance < 0) != ours.occupied[EIGHTH])
    ratio = other_seconds / seconds
    print(f"{f'{name}, open3d':34}{other_seconds * 1e3:10.1f}{ratio:12.1f}{signs:12d}{gap.max():12.1e}")
    fused = fuse([tsdf(grid, object_view(body, eye)) for eye in camera_positions()])
    wrong = np.sum(ours.occupied != ~(fused.values >= 0)) / ours.occupied.sum()
    print(f"{'':6}nine views fused, unknown taken as solid: {wrong:.1%} of the volume wrong")


def plain_tsdf(grid: Grid, view: View) -> np.ndarray:
    """Slab by slab in float32: a careful implementation in numpy."""
    camera, camera_from_grid = view.camera, view.world_from_camera.inverse() @ grid.world_from_grid
    steps, shift = (camera_from_grid.rotation_matrix() * grid.voxel_size).astype(np.float32), camera_from_grid.xyz
    j, k = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in grid.shape[1:]), indexing="ij")
    values = np.empty(grid.shape, np.float32)
    for i in range(grid.shape[0]):
        x, y, z = (steps[a, 1] * j + steps[a, 2] * k + np.float32(steps[a, 0] * i + shift[a]) for a in range(3))
        values[i] = tsdf_values(camera, view.depth, x, y, z, 5 * grid.voxel_size)
    return values


def release_tsdf(grid: Grid, view: View) -> np.ndarray:
    """All voxels at once: an (n, 3) array of world coordinates, transformed to the camera, projected, compared."""
    indices = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    points = view.world_from_camera.inverse().apply(grid.world(indices))
    x, y, z = points.T
    return tsdf_values(view.camera, view.depth, x, y, z, 5 * grid.voxel_size).reshape(grid.shape)


def tsdf_values(camera: Camera, depth: np.ndarray, x: Any, y: Any, z: Any, truncation: float) -> np.ndarray:
    """Values of voxels at (x, y, z) [m] in the camera frame."""
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.floor(camera.fx * x / z + (camera.cx + 0.5)).astype(np.int32)
        v = np.floor(camera.fy * y / z + (camera.cy + 0.5)).astype(np.int32)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    pixel_depth = np.zeros(x.shape, np.float32)
    pixel_depth[inside] = depth[v[inside], u[inside]]
    values = np.minimum((pixel_depth - z) / truncation, 1).astype(np.float32)
    values[(pixel_depth == 0) | (values < -1)] = np.nan
    return values


def exact_distance(grid: Grid, mesh: Mesh) -> tuple[float, np.ndarray]:
    """Seconds for all voxels, and the signed distance [m] of every eighth by open3d, which computes in float32."""
    ctypes.CDLL(str(libusb_package.get_library_path()), ctypes.RTLD_GLOBAL)  # open3d links to it
    import open3d

    scene: Any = open3d.t.geometry.RaycastingScene()
    tensor: Any = open3d.core.Tensor
    scene.add_triangles((mesh.vertices * 1e3).astype(np.float32), mesh.faces.astype(np.uint32))
    points = (grid.centres()[EIGHTH] * 1e3).astype(np.float32)
    start = time.perf_counter()
    distance = scene.compute_signed_distance(tensor(points)).numpy()
    return 8 * (time.perf_counter() - start), distance * 1e-3


def sample_bodies() -> list[tuple[Mesh, Pose]]:
    """A table with twelve parts on it."""
    table = trimesh.creation.box((1.2, 1.6, 0.04))
    bodies = [(Mesh(table.vertices, table.faces.astype(np.int32)), Pose.from_translation((0, 0, -0.02)))]
    for number, name in enumerate(sorted(FAMILIES)[:12]):
        mesh = sample_part(name)
        at = ((number % 4 - 1.5) * 0.08, (number // 4 - 1) * 0.08, -mesh.bounds[0, 2])
        bodies.append((mesh, Pose.from_translation(at)))
    return bodies


def sample_part(name: str) -> Mesh:
    return make_part(name, name, FAMILIES[name].draw(stream(1, "bench", name)), 0.05).mesh


def solids() -> list[tuple[str, Mesh]]:
    """A part with few faces, one with many, and a sphere with very many."""
    parts = sorted(((name, sample_part(name)) for name in sorted(FAMILIES)[:12]), key=lambda item: len(item[1].faces))
    ball = trimesh.creation.icosphere(subdivisions=DENSE_SPHERE, radius=0.025)
    return [parts[0], parts[-1], ("sphere", Mesh(ball.vertices, ball.faces.astype(np.int32)))]


def camera_positions() -> list[tuple[float, float, float]]:
    """Nine camera positions: above, and two rings of four, the second at the height of the part's centre."""
    ring = [(np.cos(angle), np.sin(angle)) for angle in np.pi / 4 + np.pi / 2 * np.arange(4)]
    return [(0.01, 0, 0.5), *((0.3 * x, 0.3 * y, 0.3) for x, y in ring), *((0.4 * x, 0.4 * y, 0.0) for x, y in ring)]


def object_view(bodies: list[tuple[Mesh, Pose]], eye: tuple[float, float, float]) -> View:
    """The bodies, with depth 10 m for all other pixels, as free space behind them."""
    pose = look_at(eye, (0, 0, 0))
    depth = render(CAMERA, pose, bodies).depth
    return View(CAMERA, pose, np.where(depth > 0, depth, 10))


def timed(make: Callable[[], T], repeats: int) -> tuple[float, T]:
    """Smallest time [s] of several calls (other processes may interfere), and the last result."""
    fastest = np.inf
    for _ in range(repeats - 1):
        start = time.perf_counter()
        make()
        fastest = min(fastest, time.perf_counter() - start)
    start = time.perf_counter()
    result = make()
    return min(fastest, time.perf_counter() - start), result


def peak_gb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except Kit1000Error as error:
        raise SystemExit(f"voxels: {error}") from error
