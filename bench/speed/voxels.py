"""Volumes compared with other implementations, timed in one run: milliseconds, ratio, agreement.

    python bench/speed/voxels.py

The TSDF of one depth image is compared with two implementations in numpy: `plain`, slab by slab in float32, and
`release`, the algorithm of the paper's release (the world coordinates of all voxels in one array, then operations on
whole arrays in float64). The signed distance of a part is compared with open3d's exact distance, which is computed for
every second voxel along each axis; its time counts eight times.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import libusb_package
import numpy as np
import trimesh
import tyro

from bench.speed.timing import fastest, timed
from benchmark.measurements import Column, Measurement
from kit1000.camera import Camera, look_at
from kit1000.errors import Kit1000Error
from kit1000.mesh import Mesh
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.render import render
from kit1000.values import View
from kit1000.voxels import Grid, fuse, signed_distance, tsdf

Bodies = list[tuple[Mesh, Pose]]
Line = dict[str, Any]  # values of a line of a table

VOXEL = 0.89e-3  # [m] as in the paper
SHAPES = ((128, 128, 128), (400, 400, 256))  # of a part and of a kit
CAMERA = Camera(1280, 720, 925, 925, 639.5, 359.5)
DENSE_SPHERE = 6  # subdivisions: 81,920 faces
EIGHTH = (slice(None, None, 2),) * 3
SECONDS = (Column("n", "timings"), Column("ms", "fastest, ms", 1), Column("ratio", "times ours", 1))
IMAGE_COLUMNS = (
    Column("grid", "voxels"),
    Column("way", "algorithm"),
    *SECONDS,
    Column("known", "known, %", 1, True),
    Column("differ", "differing, %", 4, True),
    Column("largest", "largest difference of others, 1e-6", 1),
)
MESH_COLUMNS = (
    Column("body", "body"),
    Column("faces", "faces", 0),
    Column("way", "algorithm"),
    *SECONDS,
    Column("signs", "wrong signs", 0),
    Column("largest", "largest difference, voxels", 3),
)
FUSION_COLUMNS = (Column("body", "body"), Column("n", "views"), Column("wrong", "wrong, % of the volume", 2, True))


@dataclass(frozen=True)
class Voxels:
    """Time volumes."""

    repeats: int = 9
    """Number of timings of each; the fastest counts."""
    threads: int | None = None
    """Number of threads of ours; all cores by default. numpy uses one, open3d all."""
    release: bool = True
    """Whether the release's algorithm is timed too; it needs 8 GB of memory for the larger grid."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-voxels.json."""


def main(options: Voxels) -> None:
    """Print the tables."""
    bodies = sample_bodies()
    eye = look_at((0.45, 0.2, 0.5), (0, 0, 0))
    view = View(CAMERA, eye, render(CAMERA, eye, bodies).depth)
    measurement = Measurement.begin()
    title = f"TSDF of one image of {CAMERA.width} x {CAMERA.height}"
    table = measurement.table("images", title, *IMAGE_COLUMNS)
    for shape in SHAPES:
        for line in image_lines(Grid.centred(Pose.from_translation((0, 0, 0.02)), shape, VOXEL), view, options):
            table.add(**line)
    meshes = measurement.table("meshes", f"Signed distance of a mesh, {as_text(SHAPES[0])} voxels", *MESH_COLUMNS)
    fusion = measurement.table("fusion", "Fused images, unknown voxels taken as solid", *FUSION_COLUMNS)
    for name, mesh in solids():
        *lines, fused = mesh_lines(name, mesh, options)
        for line in lines:
            meshes.add(**line)
        fusion.add(**fused)
    measurement.report(options.out)


def image_lines(grid: Grid, view: View, options: Voxels) -> Iterator[Line]:
    """A line each for ours, plain numpy and the release's algorithm."""
    ours = tsdf(grid, view, threads=options.threads)  # numba compiles in the first call
    seconds, _ = fastest(lambda: tsdf(grid, view, threads=options.threads), options.repeats)
    line = {"grid": as_text(grid.shape), "known": ours.known.mean()}
    yield {**line, "way": "ours", "n": options.repeats, "ms": 1e3 * seconds, "ratio": 1.0}
    others = (("plain numpy", plain_tsdf), ("release's algorithm", release_tsdf))
    for name, other in others[: 1 + options.release]:
        repeats = min(options.repeats, 3)
        other_seconds, values = fastest(lambda make=other: make(grid, view), repeats)
        known = ours.known & ~np.isnan(values)
        gap = np.abs(ours.values - values)[known]
        differ = np.mean(ours.known != ~np.isnan(values)) + np.mean(gap > 1e-3)
        line |= {"known": 1 - np.isnan(values).mean(), "differ": differ, "largest": 1e6 * gap[gap <= 1e-3].max()}
        yield {**line, "way": name, "n": repeats, "ms": 1e3 * other_seconds, "ratio": other_seconds / seconds}


def mesh_lines(name: str, mesh: Mesh, options: Voxels) -> Iterator[Line]:
    """A line each for ours and open3d's exact distance, and one with the error of a fusion of several views."""
    grid = Grid.centred(Pose.from_rotvec((0.3, -0.5, 0.2)), SHAPES[0], VOXEL)
    body, threads = [(mesh, Pose.identity())], options.threads
    signed_distance(grid, body, threads=threads)
    seconds, ours = fastest(lambda: signed_distance(grid, body, threads=threads), options.repeats)
    line = {"body": name, "faces": len(mesh.faces)}
    yield {**line, "way": "ours", "n": options.repeats, "ms": 1e3 * seconds, "ratio": 1.0}
    other_seconds, distance = exact_distance(grid, mesh)
    gap = np.abs(ours.values[EIGHTH] * 5 - np.clip(distance / VOXEL, -5, 5))
    errors = {"signs": np.sum((distance < 0) != ours.occupied[EIGHTH]), "largest": gap.max()}
    yield {**line, "way": "open3d", "n": 1, "ms": 1e3 * other_seconds, "ratio": other_seconds / seconds, **errors}
    views = [tsdf(grid, object_view(body, eye)) for eye in camera_positions()]
    wrong = np.sum(ours.occupied != ~(fuse(views).values >= 0)) / ours.occupied.sum()
    yield {"body": name, "n": len(views), "wrong": wrong}


def as_text(shape: tuple[int, ...]) -> str:
    """The number of voxels along each axis."""
    return " x ".join(map(str, shape))


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
    seconds, distance = timed(lambda: scene.compute_signed_distance(tensor(points)).numpy())
    return 8 * seconds, distance * 1e-3


def sample_bodies() -> Bodies:
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


def object_view(bodies: Bodies, eye: tuple[float, float, float]) -> View:
    """The bodies, with depth 10 m for all other pixels, as free space behind them."""
    pose = look_at(eye, (0, 0, 0))
    depth = render(CAMERA, pose, bodies).depth
    return View(CAMERA, pose, np.where(depth > 0, depth, 10))


if __name__ == "__main__":
    try:
        main(tyro.cli(Voxels))
    except Kit1000Error as error:
        raise SystemExit(f"voxels: {error}") from error
