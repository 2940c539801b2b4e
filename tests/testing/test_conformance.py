"""Conformance checks: our own sensors, renderer and mesh reader pass, and each broken one fails with its cause."""

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

from kit1000.camera import Camera
from kit1000.errors import MeshRefused
from kit1000.mesh import Mesh
from kit1000.parts.files.read import MeshReading, read_mesh
from kit1000.pose import Pose
from kit1000.sim.cameras import CAMERA
from kit1000.sim.render import RenderedImage, render
from kit1000.sim.sensors import DEPTH_GRID, SENSORS, sense
from kit1000.testing import check_renderer, check_sensor, check_source
from kit1000.values import View
from tests.samples.mini import l_shape
from tests.samples.mini import write_stl as stl_written

Rng = np.random.Generator
SMALL_CAMERA = CAMERA.scaled(0.25)  # 320 x 180 pixels: broken sensors fail on small images too


@pytest.mark.parametrize("name", SENSORS)
def test_our_sensors_conform(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without bending, which shifts planes as a shift of the image would."""
    monkeypatch.setitem(SENSORS, name, replace(SENSORS[name], bending_px=(0.0, 0.0)))
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


def unseeded(depth: np.ndarray, _: Rng) -> np.ndarray:
    return np.where(depth > 0, depth + np.random.default_rng().normal(0, 1e-3, depth.shape), 0)


def along_the_ray(view: View, _: Rng) -> View:
    rays = view.camera.unproject(np.ones(view.depth.shape))
    return replace(view, depth=on_grid(view.depth * np.linalg.norm(rays, axis=-1)))


def writing(view: View, rng: Rng) -> View:
    view.depth[3, 3] = 0.5
    return sense("ideal", view, rng)


def writing_by_force(view: View, rng: Rng) -> View:
    measured = sense("ideal", view, rng)
    view.depth.setflags(write=True)
    view.depth[90, 100:107] += 0.25
    view.depth.setflags(write=False)
    return measured


def halved(view: View, _: Rng) -> View:
    return View(view.camera.scaled(0.5), view.world_from_camera, on_grid(view.depth[::2, ::2]))


def writable(view: View, rng: Rng) -> View:
    measured = sense("ideal", view, rng)
    object.__setattr__(measured, "depth", np.array(measured.depth))
    return measured


BROKEN_SENSORS: dict[str, tuple[Callable[[View, Rng], Any], str]] = {
    "noise in holes": (with_depth(noise_in_holes), r"has a depth in \d+ pixels without a surface"),
    "half a pixel": (with_depth(half_a_pixel), r"pixels show surfaces \+0\.(49|50) px right of them"),
    "upside down": (
        lambda view, _: replace(view, depth=np.where(view.depth > 0, on_grid(view.depth[::-1]), 0)),
        r"\d+\.\d mm.*upside down",
    ),
    "along the ray": (along_the_ray, r"along the rays.*optical axis"),
    "5 % too far": (with_depth(lambda depth, _: depth * 1.05), r"depths have a median error of 3\d\.\d mm$"),
    "beside the grid": (lambda view, _: replace(view, depth=view.depth * 0.999), r"not multiples of 2\^-13 m"),
    "below 0": (
        lambda view, _: replace(view, depth=np.where(view.depth > 0, view.depth, -DEPTH_GRID)),
        "smallest depth is -",
    ),
    "blind": (
        with_depth(lambda depth, _: depth * 0),
        r"0% of the pixels .*0.4 to 1 m.*expected 50%",
    ),
    "writes": (writing, r"modifies its input \(assignment destination is read-only\)"),
    "forces": (writing_by_force, r"modifies its input: 7 pixels changed"),
    "draws by pixel": (with_depth(noise_by_pixel), "the number of random draws depends on the image"),
    "own chance": (with_depth(unseeded), r"one seed differ in \d\d\.\d\d%"),
    "astray": (
        with_pose(lambda pose: Pose(pose.wxyz, pose.xyz + 0.1)),
        r"camera pose has an error of 173\.2 mm and 0\.00 degrees$",
    ),
    "inverted": (with_pose(Pose.inverse), "probably camera_from_world in place of world_from_camera"),
    "another camera": (halved, r"returns an image of Camera\(width=160"),
    "no view": (lambda view, _: on_grid(view.depth), "returns a ndarray, expected a kit1000.values.View"),
    "writable": (writable, "depths are not read-only"),
}


@pytest.mark.parametrize("fault", BROKEN_SENSORS)
def test_a_broken_sensor_fails_with_its_cause(fault: str) -> None:
    broken, message = BROKEN_SENSORS[fault]
    with pytest.raises(AssertionError, match=f"^broken: .*{message}"):
        check_sensor(broken, "broken", camera=SMALL_CAMERA)


def test_the_allowed_errors_of_a_sensor_are_parameters() -> None:
    coarse = with_depth(lambda depth, _: depth * 1.05)
    check_sensor(coarse, depth_error=0.05, camera=SMALL_CAMERA)
    with pytest.raises(AssertionError, match="camera pose has an error"):
        check_sensor(partial(sense, "photoneo"), position_error=1e-5, camera=SMALL_CAMERA)


def test_our_renderer_conforms() -> None:
    check_renderer(render)
    check_renderer(lambda camera, world_from_camera, bodies: render(camera, world_from_camera, bodies, threads=1))


def rendered(depth: np.ndarray, ids: np.ndarray, faces: np.ndarray) -> RenderedImage:
    images = np.array(depth, np.float32), np.array(ids, np.int16), np.array(faces, np.int32)
    for image in images:
        image.setflags(write=False)
    return RenderedImage(*images)


def by_image(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., RenderedImage]:
    def drawn(camera: Camera, world_from_camera: Pose, bodies: list) -> RenderedImage:
        frame = render(camera, world_from_camera, bodies, threads=1)
        return rendered(change(frame.depth), change(frame.body_ids), change(frame.face_ids))

    return drawn


def by_frame(change: Callable[[RenderedImage, Camera], tuple]) -> Callable[..., RenderedImage]:
    def drawn(camera: Camera, world_from_camera: Pose, bodies: list) -> RenderedImage:
        return rendered(*change(render(camera, world_from_camera, bodies, threads=1), camera))

    return drawn


def by_camera(change: Callable[[Camera], Camera]) -> Callable[..., RenderedImage]:
    return lambda camera, pose, bodies: render(change(camera), pose, bodies, threads=1)


def ray_lengths(camera: Camera) -> np.ndarray:
    return np.linalg.norm(camera.unproject(np.ones((camera.height, camera.width))), axis=-1)


def last_first(camera: Camera, pose: Pose, bodies: list) -> RenderedImage:
    frame = render(camera, pose, bodies[::-1], threads=1)
    return rendered(frame.depth, np.where(frame.body_ids > 0, len(bodies) + 1 - frame.body_ids, 0), frame.face_ids)


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
    return rendered(frame.depth * np.float32(1 + 1e-7 * threads), frame.body_ids, frame.face_ids)


def writable_depth(camera: Camera, pose: Pose, bodies: list) -> RenderedImage:
    frame = render(camera, pose, bodies, threads=1)
    return RenderedImage(np.array(frame.depth), frame.body_ids, frame.face_ids)


BROKEN_RENDERERS: dict[str, tuple[Callable[..., RenderedImage], str]] = {
    "half a pixel": (
        by_camera(lambda camera: replace(camera, cx=camera.cx - 0.5, cy=camera.cy - 0.5)),
        r"tilted plane .*\d\.\d\d%.*half a pixel off",
    ),
    "upside down": (by_image(lambda image: image[::-1]), "probably the image is upside down"),
    "mirrored": (by_image(lambda image: image[:, ::-1]), "probably the image is mirrored left to right"),
    "along the ray": (
        by_frame(lambda frame, camera: (frame.depth * ray_lengths(camera), frame.body_ids, frame.face_ids)),
        "probably depth is measured along the rays",
    ),
    "millimetres": (
        by_frame(lambda frame, _: (frame.depth * 1e3, frame.body_ids, frame.face_ids)),
        "probably depth is in millimetres",
    ),
    "far is 10": (
        by_frame(lambda frame, _: (np.where(frame.body_ids > 0, frame.depth, 10), frame.body_ids, frame.face_ids)),
        "depth is 10 m where no body is visible, expected 0",
    ),
    "ids from 0": (
        by_frame(lambda frame, _: (frame.depth, frame.body_ids - 1, frame.face_ids)),
        "0 or less where a body|pixels without bodies",
    ),
    "no face": (
        by_frame(lambda frame, _: (frame.depth, frame.body_ids, np.where(frame.body_ids > 0, 0, -1))),
        r"at \d+ pixels of body 0 .*face id",
    ),
    "last wins": (last_first, r"ids of coincident bodies are \[3\], expected the first, 1"),
    "one side": (one_sided, "fills the image is missing|inside a ball"),
    "drops": (dropping, "crosses the plane of the camera.*expected clipped"),
    "threads": (with_threads, r"depth differs in \d+ pixels when rendered by 3 threads"),
    "writable": (writable_depth, "depth is not read-only"),
}


@pytest.mark.parametrize("fault", BROKEN_RENDERERS)
def test_a_broken_renderer_fails_with_its_cause(fault: str) -> None:
    broken, message = BROKEN_RENDERERS[fault]
    with pytest.raises(AssertionError, match=f"^broken: .*({message})"):
        check_renderer(broken, "broken")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One part in three formats."""
    folder = tmp_path_factory.mktemp("files")
    stl = stl_written(folder / "corner.stl", l_shape())
    mesh = trimesh.load_mesh(stl)
    for suffix in ("ply", "obj"):
        mesh.export(folder / f"corner.{suffix}")
    return sorted(folder.iterdir())


def test_our_reader_conforms(files: list[Path]) -> None:
    check_source(read_mesh, files)


def in_millimetres(path: Path) -> MeshReading:
    reading = read_mesh(path)
    return replace(reading, mesh=reading.mesh.scaled(1e3).rounded_float32())


def inside_out(path: Path) -> MeshReading:
    reading = read_mesh(path)
    return replace(reading, mesh=Mesh(reading.mesh.vertices, reading.mesh.faces[:, ::-1]))


def holed(path: Path) -> MeshReading:
    reading = read_mesh(path)
    return replace(reading, mesh=Mesh(reading.mesh.vertices, reading.mesh.faces[1:]))


def other_exception(path: Path) -> MeshReading:
    try:
        return read_mesh(path)
    except MeshRefused:
        raise ValueError("unpack requires\n84 bytes") from None


def many_lines(path: Path) -> MeshReading:
    try:
        return read_mesh(path)
    except MeshRefused as refused:
        raise MeshRefused(f"{refused.reason}\nsorry") from None


def nondeterministic(path: Path) -> MeshReading:
    reading = read_mesh(path)
    shift = np.random.default_rng().integers(1, 1000, 3) * 2.0**-16
    return replace(reading, mesh=Mesh(reading.mesh.vertices + shift, reading.mesh.faces).rounded_float32())


def modifying(path: Path) -> MeshReading:
    reading = read_mesh(path)
    path.write_bytes(path.read_bytes() + b"\n")
    return reading


BROKEN_READERS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "millimetres": (in_millimetres, r"longest side 40 m, expected 0.0001 to 10 \(metres\?\)"),
    "inside out": (inside_out, "inside out"),
    "holed": (holed, "open edges"),
    "off the grid": (
        lambda path: replace(r := read_mesh(path), mesh=r.mesh.scaled(1 / 3)),
        "vertices are not exact in float32",
    ),
    "other_exception": (other_exception, r"ValueError .*84 bytes.*expected MeshRefused"),
    "many_lines": (many_lines, r"expected a reason of one line"),
    "nondeterministic": (nondeterministic, "gives two different meshes when read twice"),
    "modifying": (modifying, "is modified by reading it"),
    "silent": (lambda path: replace(read_mesh(path), unit_reason=""), "has no unit, or no reason for it"),
    "elsewhere": (lambda path: replace(read_mesh(path), path=Path("x.stl")), "the result has path x.stl"),
    "picky": (lambda path: read_mesh(path.with_name("none.stl")), "is refused: cannot be read"),
    "no reading": (lambda path: SimpleNamespace(mesh=read_mesh(path).mesh), "gives a SimpleNamespace, expected a"),
}


@pytest.mark.parametrize("fault", BROKEN_READERS)
def test_a_broken_reader_fails_with_its_cause(fault: str, tmp_path: Path) -> None:
    broken, message = BROKEN_READERS[fault]
    with pytest.raises(AssertionError, match=f"^broken: .*{message}"):
        check_source(broken, [stl_written(tmp_path / "corner.stl", l_shape())], "broken")
