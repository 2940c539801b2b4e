"""The checks for implementers: our own sensors, renderer and reader pass, and each broken one is told what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from mini import corner
from mini import written as stl_written

from kit1000.camera import Camera
from kit1000.errors import MeshRefused
from kit1000.mesh import Mesh
from kit1000.parts.files.sources import Reading, read_mesh
from kit1000.pose import Pose
from kit1000.sim.render import RenderedImage, render
from kit1000.sim.sensors import DEPTH_GRID, SENSORS, sense
from kit1000.testing import check_renderer, check_sensor, check_source
from kit1000.values import View

Rng = np.random.Generator


@pytest.mark.parametrize("name", SENSORS)
def test_our_sensors_conform(name: str) -> None:
    check_sensor(partial(sense, name), name)


def on_grid(depth: np.ndarray) -> np.ndarray:
    return np.rint(np.maximum(depth, 0) / DEPTH_GRID) * DEPTH_GRID


def with_depth(change: Callable[[np.ndarray, Rng], Any]) -> Callable[[View, Rng], View]:
    """The perfect sensor with another depth image."""

    def changed(view: View, rng: Rng) -> View:
        return View(view.camera, view.world_from_camera, on_grid(change(view.depth.astype(np.float64), rng)))

    return changed


def with_pose(change: Callable[[Pose], Pose]) -> Callable[[View, Rng], View]:
    return lambda view, rng: View(view.camera, change(view.world_from_camera), on_grid(view.depth))


def noise_in_holes(depth: np.ndarray, rng: Rng) -> np.ndarray:
    return depth + rng.normal(0, 2e-3, depth.shape)


def half_a_pixel(depth: np.ndarray, _: Rng) -> np.ndarray:
    """Read between two columns; holes stay holes."""
    right = np.roll(depth, -1, axis=1)
    return np.where((depth > 0) & (right > 0), (depth + right) / 2, 0)


def noise_by_pixel(depth: np.ndarray, rng: Rng) -> np.ndarray:
    depth[depth > 0] += rng.normal(0, 1e-3, int((depth > 0).sum()))
    return depth


def forgetful(depth: np.ndarray, _: Rng) -> np.ndarray:
    return np.where(depth > 0, depth + np.random.default_rng().normal(0, 1e-3, depth.shape), 0)


def along_the_ray(view: View, _: Rng) -> View:
    rays = view.camera.unproject(np.ones(view.depth.shape))
    return replace(view, depth=on_grid(view.depth * np.linalg.norm(rays, axis=-1)))


def writing(view: View, rng: Rng) -> View:
    view.depth[3, 3] = 0.5
    return sense("ideal", view, rng)


def forcing(view: View, rng: Rng) -> View:
    seen = sense("ideal", view, rng)
    view.depth.setflags(write=True)
    view.depth[300, 400:407] += 0.25
    view.depth.setflags(write=False)
    return seen


def halved(view: View, _: Rng) -> View:
    return View(view.camera.scaled(0.5), view.world_from_camera, on_grid(view.depth[::2, ::2]))


def writable(view: View, rng: Rng) -> View:
    seen = sense("ideal", view, rng)
    object.__setattr__(seen, "depth", np.array(seen.depth))
    return seen


BROKEN_SENSORS: dict[str, tuple[Callable[[View, Rng], Any], str]] = {
    "noise in holes": (with_depth(noise_in_holes), r"measures \d+ pixels where nothing is to be seen"),
    "half a pixel": (with_depth(half_a_pixel), r"pixels show what lies \+0\.50 px across of them"),
    "upside down": (
        lambda view, _: replace(view, depth=np.where(view.depth > 0, on_grid(view.depth[::-1]), 0)),
        r"off by \d+\.\d mm in the median, as if upside down",
    ),
    "along the ray": (along_the_ray, r"in the median, as if measured along the rays and not along the optical axis"),
    "5 % too far": (with_depth(lambda depth, _: depth * 1.05), r"depths are off by 3\d\.\d mm in the median$"),
    "beside the grid": (lambda view, _: replace(view, depth=view.depth * 0.999), r"beside the grid of 2\^-13 m"),
    "below 0": (
        lambda view, _: replace(view, depth=np.where(view.depth > 0, view.depth, -DEPTH_GRID)),
        "smallest depth is -",
    ),
    "blind": (with_depth(lambda depth, _: depth * 0), r"0% of a surface at 0.4 to 1 m gives a return, expected 50%"),
    "writes": (writing, r"writes into the view that it is given \(assignment destination is read-only\)"),
    "forces": (forcing, r"writes into the view that it is given: 7 pixels changed"),
    "draws by pixel": (with_depth(noise_by_pixel), "how many numbers are drawn depends on what is seen"),
    "own chance": (with_depth(forgetful), r"two images from one seed differ in \d\d\.\d\d% of their pixels"),
    "astray": (with_pose(lambda pose: Pose(pose.wxyz, pose.xyz + 0.1)), r"pose is off by 173\.2 mm and 0\.00 degrees$"),
    "inverted": (with_pose(Pose.inverse), "looks like camera_from_world, expected world_from_camera"),
    "another camera": (halved, r"gives an image of Camera\(width=640"),
    "no view": (lambda view, _: on_grid(view.depth), "gives a ndarray, expected a kit1000.values.View"),
    "writable": (writable, "depths can be written to"),
}


@pytest.mark.parametrize("fault", BROKEN_SENSORS)
def test_a_broken_sensor_is_told_what_is_wrong(fault: str) -> None:
    broken, said = BROKEN_SENSORS[fault]
    with pytest.raises(AssertionError, match=f"^broken: .*{said}"):
        check_sensor(broken, "broken")


def test_what_a_sensor_may_err_by_can_be_said() -> None:
    coarse = with_depth(lambda depth, _: depth * 1.05)
    check_sensor(coarse, depth_error=0.05)
    with pytest.raises(AssertionError, match="believed pose is off"):
        check_sensor(partial(sense, "d415"), position_error=1e-4)


def test_our_renderer_conforms() -> None:
    check_renderer(render)
    check_renderer(lambda camera, world_from_camera, bodies: render(camera, world_from_camera, bodies, threads=1))


def framed(depth: np.ndarray, ids: np.ndarray, faces: np.ndarray) -> RenderedImage:
    images = np.array(depth, np.float32), np.array(ids, np.int16), np.array(faces, np.int32)
    for image in images:
        image.setflags(write=False)
    return RenderedImage(*images)


def by_image(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., RenderedImage]:
    def drawn(camera: Camera, world_from_camera: Pose, bodies: list) -> RenderedImage:
        frame = render(camera, world_from_camera, bodies, threads=1)
        return framed(change(frame.depth), change(frame.body_ids), change(frame.face_ids))

    return drawn


def by_frame(change: Callable[[RenderedImage, Camera], tuple]) -> Callable[..., RenderedImage]:
    def drawn(camera: Camera, world_from_camera: Pose, bodies: list) -> RenderedImage:
        return framed(*change(render(camera, world_from_camera, bodies, threads=1), camera))

    return drawn


def by_camera(change: Callable[[Camera], Camera]) -> Callable[..., RenderedImage]:
    return lambda camera, pose, bodies: render(change(camera), pose, bodies, threads=1)


def ray_lengths(camera: Camera) -> np.ndarray:
    return np.linalg.norm(camera.unproject(np.ones((camera.height, camera.width))), axis=-1)


def last_first(camera: Camera, pose: Pose, bodies: list) -> RenderedImage:
    frame = render(camera, pose, bodies[::-1], threads=1)
    return framed(frame.depth, np.where(frame.body_ids > 0, len(bodies) + 1 - frame.body_ids, 0), frame.face_ids)


def one_sided(camera: Camera, pose: Pose, bodies: list) -> RenderedImage:
    eye = pose.xyz
    kept = []
    for mesh, world_from_body in bodies:
        corners = world_from_body.apply(mesh.triangles)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        kept.append((Mesh(mesh.vertices, mesh.faces[((eye - corners[:, 0]) * normals).sum(1) > 0]), world_from_body))
    return render(camera, pose, kept, threads=1)


def dropping(camera: Camera, pose: Pose, bodies: list) -> RenderedImage:
    """Without the faces that pass the plane of the camera."""
    kept = []
    for mesh, world_from_body in bodies:
        z = (pose.inverse() @ world_from_body).apply(mesh.triangles)[..., 2]
        kept.append((Mesh(mesh.vertices, mesh.faces[z.min(axis=1) > 0]), world_from_body))
    return render(camera, pose, kept, threads=1)


def with_threads(camera: Camera, pose: Pose, bodies: list, threads: int = 1) -> RenderedImage:
    frame = render(camera, pose, bodies, threads=1)
    return framed(frame.depth * np.float32(1 + 1e-7 * threads), frame.body_ids, frame.face_ids)


def loose(camera: Camera, pose: Pose, bodies: list) -> RenderedImage:
    frame = render(camera, pose, bodies, threads=1)
    return RenderedImage(np.array(frame.depth), frame.body_ids, frame.face_ids)


BROKEN_RENDERERS: dict[str, tuple[Callable[..., RenderedImage], str]] = {
    "half a pixel": (
        by_camera(lambda camera: replace(camera, cx=camera.cx - 0.5, cy=camera.cy - 0.5)),
        r"tilted plane are off by up to \d\.\d\d%, as if half a pixel off: pixel \(u, v\) has its centre at \(u, v\)",
    ),
    "upside down": (by_image(lambda image: image[::-1]), "as if upside down"),
    "mirrored": (by_image(lambda image: image[:, ::-1]), "as if mirrored, left for right"),
    "along the ray": (
        by_frame(lambda frame, camera: (frame.depth * ray_lengths(camera), frame.body_ids, frame.face_ids)),
        "as if measured along the rays and not along the optical axis",
    ),
    "millimetres": (by_frame(lambda frame, _: (frame.depth * 1e3, frame.body_ids, frame.face_ids)), "as if in millimetres"),
    "far is 10": (
        by_frame(lambda frame, _: (np.where(frame.body_ids > 0, frame.depth, 10), frame.body_ids, frame.face_ids)),
        "depth is 10 m where nothing is seen, expected 0",
    ),
    "ids from 0": (
        by_frame(lambda frame, _: (frame.depth, frame.body_ids - 1, frame.face_ids)),
        "depth is 0 or less where a body is seen|pixels of no bodies",
    ),
    "no face": (
        by_frame(lambda frame, _: (frame.depth, frame.body_ids, np.where(frame.body_ids > 0, 0, -1))),
        r"at \d+ pixels of body 0 the depth is not that of the face named there",
    ),
    "last wins": (last_first, r"where bodies coincide ids are \[3\], expected the first, 1"),
    "one side": (one_sided, "of a plane that fills the image is missing|see through a ball"),
    "drops": (dropping, "a floor that passes below the camera is dropped, expected it cut"),
    "threads": (with_threads, r"depth differs in \d+ pixels when drawn by 3 threads"),
    "writable": (loose, "depth can be written to"),
}


@pytest.mark.parametrize("fault", BROKEN_RENDERERS)
def test_a_broken_renderer_is_told_what_is_wrong(fault: str) -> None:
    broken, said = BROKEN_RENDERERS[fault]
    with pytest.raises(AssertionError, match=f"^broken: .*({said})"):
        check_renderer(broken, "broken")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One part in three formats."""
    folder = tmp_path_factory.mktemp("files")
    stl = stl_written(folder / "corner.stl", corner())
    mesh = trimesh.load_mesh(stl)
    for suffix in ("ply", "obj"):
        mesh.export(folder / f"corner.{suffix}")
    return sorted(folder.iterdir())


def test_our_reader_conforms(files: list[Path]) -> None:
    check_source(read_mesh, files)


def in_millimetres(path: Path) -> Reading:
    reading = read_mesh(path)
    return replace(reading, mesh=reading.mesh.scaled(1e3).rounded_float32())


def inside_out(path: Path) -> Reading:
    reading = read_mesh(path)
    return replace(reading, mesh=Mesh(reading.mesh.vertices, reading.mesh.faces[:, ::-1]))


def holed(path: Path) -> Reading:
    reading = read_mesh(path)
    return replace(reading, mesh=Mesh(reading.mesh.vertices, reading.mesh.faces[1:]))


def trusting(path: Path) -> Reading:
    try:
        return read_mesh(path)
    except MeshRefused:
        raise ValueError("unpack requires\n84 bytes") from None


def talkative(path: Path) -> Reading:
    try:
        return read_mesh(path)
    except MeshRefused as refused:
        raise MeshRefused(f"{refused.reason}\nsorry") from None


def shaky(path: Path) -> Reading:
    reading = read_mesh(path)
    shift = np.random.default_rng().integers(1, 1000, 3) * 2.0**-16
    return replace(reading, mesh=Mesh(reading.mesh.vertices + shift, reading.mesh.faces).rounded_float32())


def touching(path: Path) -> Reading:
    reading = read_mesh(path)
    path.write_bytes(path.read_bytes() + b"\n")
    return reading


BROKEN_SOURCES: dict[str, tuple[Callable[[Path], Any], str]] = {
    "millimetres": (in_millimetres, r"longest side 40 m, expected 0.0001 to 10 \(metres\?\)"),
    "inside out": (inside_out, "inside out"),
    "holed": (holed, "open edges"),
    "off the grid": (
        lambda path: replace(r := read_mesh(path), mesh=r.mesh.scaled(1 / 3)),
        "vertices are not on the float32 grid",
    ),
    "trusting": (trusting, r"ends in ValueError \(unpack requires 84 bytes\), expected MeshRefused"),
    "talkative": (talkative, r"expected one line"),
    "shaky": (shaky, "read twice gives two meshes"),
    "touching": (touching, "was changed by reading it"),
    "silent": (lambda path: replace(read_mesh(path), unit_reason=""), "does not say in which unit it was read"),
    "elsewhere": (lambda path: replace(read_mesh(path), path=Path("x.stl")), "the reading names x.stl"),
    "picky": (lambda path: read_mesh(path.with_name("none.stl")), "is refused: cannot be read"),
    "no reading": (lambda path: SimpleNamespace(mesh=read_mesh(path).mesh), "gives a SimpleNamespace, expected a"),
}


@pytest.mark.parametrize("fault", BROKEN_SOURCES)
def test_a_broken_source_is_told_what_is_wrong(fault: str, tmp_path: Path) -> None:
    broken, said = BROKEN_SOURCES[fault]
    with pytest.raises(AssertionError, match=f"^broken: .*{said}"):
        check_source(broken, [stl_written(tmp_path / "corner.stl", corner())], "broken")
