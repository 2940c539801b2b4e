"""The picture of docs/reference/sensors.md: one scene as each sensor measures it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from draw import HERO_FAMILIES, assemblies, pairs_of
from PIL import Image

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.cad import polygon, prism
from kit1000.pictures.shading import contact_sheet
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.render import render
from kit1000.sim.sensors import SENSORS, sense
from kit1000.values import View

FOLDER = Path(__file__).parent
CAMERA = Camera(1280, 720, 925.0, 925.0, 639.5, 359.5)
CROPS = (((230, 250), (650, 510)), ((650, 210), (1070, 470)))  # [px] of the parts and of the kits
NO_RETURN = (38, 34, 66)


def main() -> None:
    """Write the picture to the folder of this file."""
    scene_crops().save(FOLDER / "sensor-views.png", optimize=True)


def scene_crops() -> Image.Image:
    """The parts and the kits of one scene as each sensor measures them, shaded by the normals of the depth image."""
    view = scene()
    shaded = {name: shaded_depth(sense(name, view, stream(7, name))) for name in SENSORS}
    tiles = [image[top:bottom, left:right] for (left, top), (right, bottom) in CROPS for image in shaded.values()]
    return contact_sheet(tiles, [*shaded] * len(CROPS), columns=len(shaded))


def scene() -> View:
    """An assembly on a table, its parts in front of it."""
    pairs = [next(pairs_of(name)) for name in HERO_FAMILIES]
    assembly = next(assemblies(pairs))
    bodies = [(table(), Pose.identity()), (assembly.mesh, Pose.from_translation(np.array([0, 0.2, 0])))]
    for number, (part, kit) in enumerate(pairs):
        standing = part.mesh.moved(Pose(kit.slot.kit_from_part.wxyz, np.zeros(3)))
        place = np.array([0.09 * (number % 2) - 0.045, -0.21 + 0.09 * (number // 2), -standing.vertices[:, 2].min()])
        bodies.append((standing, Pose.from_translation(place)))
    eye = 0.8 * np.array([np.sin(0.8), 0, np.cos(0.8)])
    world_from_camera = look_at(eye, (0, 0, 0))
    return View(CAMERA, world_from_camera, render(CAMERA, world_from_camera, bodies).depth)


def table() -> Mesh:
    corners = np.array([(-0.6, -0.8), (0.6, -0.8), (0.6, 0.8), (-0.6, 0.8)])
    return mesh_from_solid(prism(polygon(corners), 0.04).translate((0, 0, -0.04)))


def shaded_depth(view: View) -> np.ndarray:
    """(H, W, 3) uint8: a depth image shaded with light from the upper left, dark blue for no return."""
    points = view.camera.unproject(view.depth)
    across = points[:, 1:] - points[:, :-1]
    down = points[1:] - points[:-1]
    normal = np.cross(across[:-1], down[:, :-1])
    light = np.array([0.35, 0.55, 0.75])
    shade = np.abs(normal @ light) / np.maximum(np.linalg.norm(normal, axis=-1) * np.linalg.norm(light), 1e-12)
    image = np.repeat((50 + 200 * shade).astype(np.uint8)[..., None], 3, axis=-1)
    image[view.depth[:-1, :-1] == 0] = NO_RETURN
    return image


if __name__ == "__main__":
    main()
