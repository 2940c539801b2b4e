"""The pictures of docs/reference/sensors.md: noise against distance, and one scene as each sensor measures it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from draw import HERO_FAMILIES, assemblies, pairs_of
from PIL import Image, ImageDraw, ImageFont

from kit1000.camera import Camera, look_at
from kit1000.mesh import Mesh, mesh_from_solid
from kit1000.parts.cad import polygon, prism
from kit1000.pictures.shading import BLUE, INK, PAPER, PART, SLATE, TABLE, contact_sheet
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.sim.render import render
from kit1000.sim.sensors import SENSORS, sense
from kit1000.values import View

FOLDER = Path(__file__).parent
CAMERA = Camera(1280, 720, 925.0, 925.0, 639.5, 359.5)
DISTANCES = (0.5, 0.65, 0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 2.9)  # [m]
BEST_PX, USUAL_PX = 0.032, 0.08  # Intel's figures for the RMS error of a D400: at its best, and in general
WIDE, HIGH = 1500, 980  # [px] of the plot, halved when saved
LEFT, TOP, RIGHT, BOTTOM = 170, 60, WIDE - 60, HIGH - 130
NEAR, FAR, FINE, COARSE = 0.3, 3.0, 0.01, 20.0  # [m], [mm] ends of the axes
CROPS = (((230, 250), (650, 510)), ((650, 210), (1070, 470)))  # [px] of the parts and of the kits
NO_RETURN = (38, 34, 66)


def main() -> None:
    """Write both pictures to the folder of this file."""
    noise_plot().save(FOLDER / "sensor-noise.png", optimize=True)
    scene_crops().save(FOLDER / "sensor-views.png", optimize=True)


def noise_plot() -> Image.Image:
    """RMS depth noise on a wall, measured and by formula, against distance. Both axes are logarithmic."""
    image = Image.new("RGB", (WIDE, HIGH), PAPER)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(size=30)
    draw_axes(draw, font)
    d415, photoneo = SENSORS["d415"], SENSORS["photoneo"]
    for name, px, colour in (("d415", USUAL_PX, BLUE), ("d415", BEST_PX, SLATE), ("photoneo", photoneo.noise_px, PART)):
        sensor = SENSORS[name]
        ends = [(z, formula_mm(px, z, sensor.baseline)) for z in (max(sensor.min_depth, NEAR), sensor.max_depth)]
        draw.line([at(*end) for end in ends], fill=colour, width=4 if px != BEST_PX else 2)
    for name, colour in (("d415", BLUE), ("photoneo", PART)):
        for z in DISTANCES:
            if z < SENSORS[name].max_depth:
                x, y = at(z, measured_mm(name, z))
                draw.ellipse((x - 9, y - 9, x + 9, y + 9), outline=colour, width=4, fill=PAPER)
    notes = (
        (0.75, 0.014, "lines: Intel's formula; circles: measured", INK),
        (0.95, formula_mm(USUAL_PX, 0.95, d415.baseline) * 1.9, "d415, 0.08 px", BLUE),
        (2.45, formula_mm(BEST_PX, 2.45, d415.baseline) * 0.6, "0.032 px", SLATE),
        (1.1, formula_mm(photoneo.noise_px, 1.1, photoneo.baseline) * 0.45, "photoneo, 0.04 px", PART),
    )
    for z, mm, text, colour in notes:
        draw.text(at(z, mm), text, fill=colour, font=font, anchor="rm" if colour == BLUE else "lm")
    return image.resize((WIDE // 2, HIGH // 2), Image.Resampling.LANCZOS)


def formula_mm(subpixel: float, distance: float, baseline: float) -> float:
    """RMS depth error [mm] by the formula of Intel's tuning paper."""
    return 1e3 * distance**2 * subpixel / (CAMERA.fx * baseline)


def measured_mm(name: str, distance: float) -> float:
    """Standard deviation [mm] of the depth of a wall perpendicular to the view."""
    wall = View(CAMERA, Pose.identity(), np.full((CAMERA.height, CAMERA.width), distance, np.float32))
    depth = sense(name, wall, stream(1, name)).depth[20:-20, 420:-420]
    return 1e3 * float(depth.astype(float).std())


def at(distance: float, mm: float) -> tuple[float, float]:
    """Position in the plot [px] of a distance [m] and a noise [mm]."""
    across = np.log(distance / NEAR) / np.log(FAR / NEAR)
    up = np.log(mm / FINE) / np.log(COARSE / FINE)
    return LEFT + across * (RIGHT - LEFT), BOTTOM - up * (BOTTOM - TOP)


def draw_axes(draw: ImageDraw.ImageDraw, font: ImageFont.FreeTypeFont | ImageFont.ImageFont) -> None:
    """Draw the grid, its numbers and the axis titles."""
    for z in (0.3, 0.5, 0.8, 1.0, 1.5, 2.0, 3.0):
        x = at(z, FINE)[0]
        draw.line([(x, TOP), (x, BOTTOM)], fill=TABLE, width=2)
        draw.text((x, BOTTOM + 28), f"{z:g}", fill=INK, font=font, anchor="mm")
    for mm in (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0):
        y = at(NEAR, mm)[1]
        draw.line([(LEFT, y), (RIGHT, y)], fill=TABLE, width=2)
        draw.text((LEFT - 20, y), f"{mm:g}", fill=INK, font=font, anchor="rm")
    draw.text(((LEFT + RIGHT) / 2, HIGH - 50), "distance of a wall, m", fill=INK, font=font, anchor="mm")
    draw.text((30, TOP - 28), "RMS noise of its depth, mm", fill=INK, font=font, anchor="lm")


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
