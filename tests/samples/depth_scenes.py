"""Depth images to sense: planes, and a table with boxes."""

from __future__ import annotations

import numpy as np
import trimesh

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import View

CAMERA = Camera(1280, 720, 925.0, 925.0, 639.5, 359.5)


def rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) points at depth 1 m behind each pixel centre."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


def plane(camera: Camera, normal: tuple[float, float, float], distance: float) -> View:
    """An infinite plane that intersects the optical axis at `distance`; depth 0 where it is invisible."""
    facing = rays(camera) @ np.asarray(normal)
    visible = facing * normal[2] > 1e-3
    depth = np.where(visible, distance * normal[2] / np.where(visible, facing, 1), 0)
    return View(camera, Pose.identity(), depth.astype(np.float32))


def boxes(camera: Camera, world_from_camera: Pose) -> View:
    """A table with two boxes and a thin post, its edges in view."""
    bodies = (
        ((0.8, 1.0, 0.04), (0, 0, -0.02)),
        ((0.1, 0.1, 0.06), (0, 0.15, 0.03)),
        ((0.05, 0.03, 0.12), (0.1, -0.1, 0.06)),
        ((0.006, 0.006, 0.2), (0.05, 0.02, 0.1)),
    )
    meshes = [trimesh.creation.box(extents=size) for size, _ in bodies]
    solids = [Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int32)) for mesh in meshes]
    places = [Pose.from_translation(np.array(place, float)) for _, place in bodies]
    image = render(camera, world_from_camera, list(zip(solids, places, strict=True)), threads=1)
    return View(camera, world_from_camera, image.depth)


def scene(radius: float = 0.8, polar: float = 0.8) -> View:
    """The boxes from a distance [m], at an angle [rad] from straight above."""
    return boxes(CAMERA, look_at((radius * np.sin(polar), 0, radius * np.cos(polar)), (0, 0, 0)))
