"""Our renderer compared with two ray casters and pybullet's TinyRenderer: milliseconds per image, timed in one run.

    python bench/speed/render.py

Depth and body ids at 1280 x 720 of a table, an assembly of four kits and four parts, subdivided to some 170,000 faces.
The acceleration structures of the ray casters are built before the timing starts; our renderer has none. Beside it the
time to simulate what each sensor measures of these images.
"""

from __future__ import annotations

import ctypes
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import libusb_package
import numpy as np
import pybullet
import tyro
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from trimesh.remesh import subdivide

from bench.speed.timing import timed
from benchmark.measurements import Column, Measurement, estimate
from kit1000.errors import Kit1000Error, Redraw
from kit1000.kits.assembly import AssemblyPlan, SidePlate, build_assembly
from kit1000.kits.kit import make_kit
from kit1000.mesh import Mesh
from kit1000.parts.family import make_part
from kit1000.parts.family_catalog import FAMILIES
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.cameras import CAMERA, draw_primary_pose
from kit1000.sim.render import render
from kit1000.sim.sensors import SENSORS, sense
from kit1000.values import Kit, Part, View

Bodies = list[tuple[Mesh, Pose]]
Draw = Callable[[Pose], np.ndarray]
Times = dict[str, list[float]]  # [ms] of each image by name

MAX_FACES = 177_000  # as a multi-kit of the release with its objects
LONGEST = 45e-3  # [m] longest side of a part
CLIP = (0.1, 10.0)  # [m] near and far plane of TinyRenderer
OURS = "ours, 2 threads"
SECONDS = (Column("n", "images"), Column("ms", "mean, ms", 1), Column("median", "median", 1))
ENDS = (Column("fastest", "fastest", 1), Column("slowest", "slowest", 1), Column("ratio", "times ours", 2))


@dataclass(frozen=True)
class Renderers:
    """Time four renderers in turn on the same images."""

    images: int = 20
    """Number of images, each from a random camera pose."""
    seed: int = 1
    """Seed of the parts and the cameras."""
    out: Path | None = None
    """JSON file of the tables, such as results/speed-render.json."""


def main(options: Renderers) -> None:
    """Print the tables."""
    bodies, rng = finely_split(scene(options.seed)), stream(options.seed, "cameras")
    views = [draw_primary_pose(rng) for _ in range(options.images)]
    casters = {"embreex": embree(bodies), "open3d": open3d(bodies)}
    with tempfile.TemporaryDirectory() as folder, Tiny(bodies, Path(folder)) as tiny:
        renderers = {
            OURS: lambda view: render(CAMERA, view, bodies, threads=2).depth,
            "ours, 1 thread": lambda view: render(CAMERA, view, bodies, threads=1).depth,
            **casters,
            "pybullet TinyRenderer": tiny.depth,
        }
        times, differences = time_renderers(renderers, views)
    sensors = time_sensors(bodies, views)
    measurement = Measurement.begin()
    faces = sum(len(mesh.faces) for mesh, _ in bodies)
    title = f"Milliseconds to render {faces:,} faces at {CAMERA.width} x {CAMERA.height}"
    error = Column("error", "depth from ours, median, um", 2)
    table = measurement.table("renderers", title, Column("renderer", "renderer"), *SECONDS, *ENDS, error)
    ours = float(np.median(times[OURS]))
    for name, row in times.items():
        table.add(renderer=name, error=1e6 * differences[name], **summary(row, ours))
    table = measurement.table(
        "sensors", "Milliseconds to simulate a sensor, one thread", Column("sensor", "sensor"), *SECONDS, *ENDS
    )
    for name, row in sensors.items():
        table.add(sensor=name, **summary(row, ours))
    measurement.report(options.out)


def summary(row: list[float], ours: float) -> dict[str, object]:
    """The values of a line. row: [ms] of each image; ours: [ms], median of our renderer."""
    ms = estimate(row)
    ends = {"fastest": min(row), "slowest": max(row)}
    return {"n": len(row), "ms": ms, "median": ms["median"], "ratio": ms["median"] / ours, **ends}


def time_renderers(renderers: dict[str, Draw], views: list[Pose]) -> tuple[Times, dict[str, float]]:
    """Milliseconds per image of each renderer, and its largest median depth difference [m]; a first image warms up."""
    times, differences = {name: [] for name in renderers}, {}
    for number, view in enumerate([views[0], *views]):
        reference = np.zeros(0)
        for name, draw in renderers.items():
            seconds, depth = timed(lambda draw=draw, view=view: draw(view))
            reference = depth if name == OURS else reference
            both = (reference > 0) & (depth > 0)
            difference = float(np.median(np.abs(depth - reference)[both]))
            differences[name] = max(differences.get(name, 0.0), difference)
            if number > 0:
                times[name].append(1e3 * seconds)
    return times, differences


def time_sensors(bodies: Bodies, views: list[Pose]) -> Times:
    """Milliseconds per image of each sensor; a first image warms up."""
    times: Times = {name: [] for name in SENSORS}
    for number, pose in enumerate([views[0], *views]):
        view = View(CAMERA, pose, render(CAMERA, pose, bodies).depth)
        for name in SENSORS:
            seconds, _ = timed(lambda name=name, view=view, number=number: sense(name, view, stream(number, name)))
            if number > 0:
                times[name].append(1e3 * seconds)
    return times


def scene(seed: int) -> Bodies:
    """A table, a tilted assembly of four kits, and their parts upright on the table."""
    pairs: list[tuple[Part, Kit]] = []
    for number, name in enumerate(FAMILIES):
        try:
            part = make_part(name, name, FAMILIES[name].draw(stream(seed, "bench", number)), LONGEST)
            pairs.append((part, make_kit(part)))
        except Redraw:
            continue
        if len(pairs) == 4:
            break
    plan = AssemblyPlan(0.2, 1.0, (SidePlate(0, 0.3), SidePlate(1, 0.5), SidePlate(3, 0.7)))
    assembly = build_assembly("bench", [kit for _, kit in pairs], plan)
    corners = np.array([(x, y, 0) for x in (-0.6, 0.6) for y in (-0.8, 0.8)])
    table = Mesh(corners, np.array([[0, 2, 3], [0, 3, 1]], np.int32))
    placed = [(table, Pose.identity()), (assembly.mesh, Pose.from_rotvec((0, 0, 0.7), (0, 0.2, 0)))]
    for number, (part, kit) in enumerate(pairs):
        upright = Pose(kit.slot.kit_from_part.wxyz, np.zeros(3))
        lowest = upright.apply(part.mesh.vertices)[:, 2].min()
        x, y = (0.1 * (number % 2) - 0.05, 0.1 * (number // 2) - 0.24)
        placed.append((part.mesh, Pose(upright.wxyz, np.array([x, y, -lowest]))))
    return placed


def finely_split(bodies: Bodies) -> Bodies:
    """Subdivide the faces of bodies but the table into four, coarsest bodies first, up to MAX_FACES faces."""
    split = list(bodies)
    while True:
        room = MAX_FACES - sum(len(mesh.faces) for mesh, _ in split)
        candidates = [i for i in range(1, len(split)) if 3 * len(split[i][0].faces) <= room]
        if not candidates:
            return split
        widest = max(candidates, key=lambda i: split[i][0].area / len(split[i][0].faces))
        mesh, pose = split[widest]
        finer = subdivide(mesh.vertices, mesh.faces)
        split[widest] = (Mesh(np.asarray(finer[0]), np.asarray(finer[1])), pose)


def rays() -> np.ndarray:
    """(H, W, 3) float32: the point at depth 1 m behind each pixel."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 0 * u + 1], axis=-1).astype(np.float32)


def in_world(bodies: Bodies) -> np.ndarray:
    """(m, 3, 3) float32 corners of all faces, world."""
    return np.concatenate([pose.apply(mesh.triangles) for mesh, pose in bodies]).astype(np.float32)


def embree(bodies: Bodies) -> Callable[[Pose], np.ndarray]:
    tree = EmbreeScene()
    TriangleMesh(tree, in_world(bodies))
    ahead = rays().reshape(-1, 3)

    def depth(view: Pose) -> np.ndarray:
        direction = view.rotate(ahead).astype(np.float32)
        origin = np.broadcast_to(view.xyz.astype(np.float32), direction.shape).copy()
        hit = tree.run(origin, direction, output=True)
        return np.where(hit["primID"] < 0, 0, hit["tfar"]).reshape(CAMERA.height, CAMERA.width)

    return depth


def open3d(bodies: Bodies) -> Callable[[Pose], np.ndarray]:
    ctypes.CDLL(str(libusb_package.get_library_path()), ctypes.RTLD_GLOBAL)  # Open3D links to it
    import open3d as o3d

    tree = o3d.t.geometry.RaycastingScene()
    for body in bodies:
        corners = in_world([body]).reshape(-1, 3)
        numbers = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        tree.add_triangles(o3d.core.Tensor.from_numpy(corners), o3d.core.Tensor.from_numpy(numbers))
    ahead = rays()

    def depth(view: Pose) -> np.ndarray:
        direction = view.rotate(ahead).astype(np.float32)
        origin = np.broadcast_to(view.xyz.astype(np.float32), direction.shape)
        ray = o3d.core.Tensor.from_numpy(np.concatenate([origin, direction], axis=-1))
        hit = tree.cast_rays(ray)["t_hit"].numpy()
        return np.where(np.isfinite(hit), hit, 0)

    return depth


class Tiny:
    """pybullet's software renderer, with the bodies loaded from files; a context manager of its client."""

    def __init__(self, bodies: Bodies, folder: Path) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        for number, (mesh, pose) in enumerate(bodies):
            path = folder / f"{number}.obj"
            vertices = "".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.vertices)
            path.write_text(vertices + "".join(f"f {a} {b} {c}\n" for a, b, c in mesh.faces + 1), encoding="utf-8")
            shape = pybullet.createVisualShape(pybullet.GEOM_MESH, fileName=str(path), physicsClientId=self._client)
            xyzw = np.roll(pose.wxyz, -1).tolist()
            pybullet.createMultiBody(
                baseVisualShapeIndex=shape,
                basePosition=pose.xyz.tolist(),
                baseOrientation=xyzw,
                physicsClientId=self._client,
            )

    def depth(self, view: Pose) -> np.ndarray:
        """(H, W) [m]; the body ids are also rendered."""
        shot = pybullet.getCameraImage(
            CAMERA.width,
            CAMERA.height,
            (np.diag([1.0, -1, -1, 1]) @ view.inverse().matrix()).T.ravel().tolist(),
            projection().T.ravel().tolist(),
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        near, far = CLIP
        buffer = np.reshape(shot[3], (CAMERA.height, CAMERA.width))
        return np.where(buffer < 1, far * near / (far - (far - near) * buffer), 0)

    def __enter__(self) -> Tiny:
        return self

    def __exit__(self, *_: object) -> None:
        pybullet.disconnect(self._client)


def projection() -> np.ndarray:
    """(4, 4) projection matrix with which TinyRenderer has the view of CAMERA.

    Its default principal point is at column W/2 and row H/2 - 1, ours is between the central pixels: a shift in each
    direction corrects that.
    """
    width, height, (near, far) = CAMERA.width, CAMERA.height, CLIP
    right, down = CAMERA.cx - width / 2, CAMERA.cy - (height / 2 - 1)
    return np.array([
        [2 * CAMERA.fx / width, 0, -2 * right / width, 0],
        [0, 2 * CAMERA.fy / height, 2 * down / height, 0],
        [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
        [0, 0, -1, 0],
    ])  # fmt: skip


if __name__ == "__main__":
    try:
        main(tyro.cli(Renderers))
    except Kit1000Error as error:
        raise SystemExit(f"render: {error}") from error
