"""Previews of recorded scenes: a small colour picture of what a method may see, and one with the goals of the target.

The picture has a pixel for each 2 x 2 pixels of the depth image, and the same bytes on every processor; the compression
is that of zlib.
"""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
from PIL import Image

from kit1000.camera import Camera
from kit1000.dataset.schema import Observation, SceneTruth
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.pictures.depth_shading import CELL, line_cover, relief_light
from kit1000.pictures.png_files import png_bytes
from kit1000.pictures.shading import KIT, Colour, part_colour
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, View

TABLE: Colour = (80, 86, 98)
NOTHING: Colour = (36, 38, 44)  # where the camera sees no surface
MARK: Colour = (255, 255, 255)  # around the parts of drawn queries
LINE = 0.6  # darkening of the lines where surfaces end
BRIGHTEST = 1.5  # light beyond it makes nothing brighter
MARK_INNER, MARK_OUTER = 2, 5  # [px of the depth image] from a part to both borders of its outline
GOAL_LINE = 3  # [px of the depth image] width of the outline of a goal
GHOST = 40  # percent: opacity of the target at its goals
MARGIN = 8  # [px of the depth image] around what is drawn over a picture


def with_previews(observation: Observation, truth: SceneTruth, mesh: Mesh) -> tuple[Observation, SceneTruth]:
    """An observation and its truth with their previews; `mesh` is that of the target, whose id the assembly has."""
    picture = scene_picture(observation)
    seen = replace(observation, preview=png_bytes(picture))
    if truth.goals is None:
        return seen, truth
    target = [row["part_id"] for row in truth.parts].index(truth.assembly_id)
    goals = with_goals(picture, _primary_view(observation), mesh, truth.goals, target)
    return seen, replace(truth, preview=png_bytes(goals))


def same_picture(one: bytes | None, other: bytes | None) -> bool:
    """Whether two PNGs show the same pixels, however they are compressed."""
    if one is None or other is None:
        return one is other
    return one == other or np.array_equal(_pixels(one), _pixels(other))


def _pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)))


def scene_picture(observation: Observation) -> np.ndarray:
    """The ideal depth image, shaded, kits and parts in colour by the masks, parts of drawn queries in a white outline.

    Nothing else of the observation is used. (H // 2, W // 2, 3) uint8 sRGB. Raises InputError without masks.
    """
    view, labels = _primary_view(observation), observation.labels
    if labels is None:
        raise InputError(f"{observation.scene_id}: a preview needs masks")
    light, cover = relief_light(view.camera, view.depth, labels), line_cover(view.depth, labels)
    picture = _coloured(view.depth, labels, light, cover, _SQUARES, _SQUARES_OF_NOTHING)
    for part in sorted({row["part"] for row in observation.queries if row["drawn"]}):
        _mark(picture, labels == FIRST_PART_LABEL + part)
    return picture


def with_goals(picture: np.ndarray, view: View, mesh: Mesh, world_from_parts: Pose, part: int) -> np.ndarray:
    """A scene's picture with a part, by its index and mesh, at all its goals (n,): faint, with an outline.

    `view` is that of the picture. (H, W, 3) uint8 sRGB.
    """
    goals = picture.copy()
    top, left, camera = _window(view, mesh, world_from_parts)
    inside = np.zeros((camera.height, camera.width), bool)
    outlines = np.zeros_like(inside)
    for world_from_part in world_from_parts:
        shown = render(camera, view.world_from_camera, [(mesh, world_from_part)], threads=1).body_ids > 0
        inside |= shown
        outlines |= _grown(shown, GOAL_LINE) & ~shown
    area = goals[top // CELL :, left // CELL :]
    _blend(area, inside & ~outlines, part_colour(part), GHOST)
    _blend(area, outlines, part_colour(part), 100)
    return goals


def _primary_view(observation: Observation) -> View:
    """The ideal view, or the first of a preset without it."""
    views = observation.views
    return views["ideal"] if "ideal" in views else views[min(views)]


_SQUARES = np.square([TABLE, KIT, *(part_colour(part) for part in range(256 - FIRST_PART_LABEL))]).astype(float)
"""(256, 3) the squares of the colours by label of the masks."""
_SQUARES_OF_NOTHING = np.square(NOTHING).astype(float)


@compiled
def _coloured(depth, labels, light, cover, squares, nothing):
    """The picture of cells in this light (H, W), each the mean of its pixels: colours, squared, are linear light."""
    height, width = light.shape
    picture = np.empty((height, width, 3), np.uint8)
    for v in range(height):
        for u in range(width):
            bright, dark = min(light[v, u], BRIGHTEST), (1 - LINE * cover[v, u]) / CELL
            red, green, blue = 0.0, 0.0, 0.0
            for y in range(CELL * v, CELL * v + CELL):
                for x in range(CELL * u, CELL * u + CELL):
                    colour, share = (squares[labels[y, x]], bright) if depth[y, x] > 0 else (nothing, 1.0)
                    red, green, blue = red + share * colour[0], green + share * colour[1], blue + share * colour[2]
            for i, total in enumerate((red, green, blue)):
                picture[v, u, i] = int(min(np.sqrt(total) * dark + 0.5, 255.0))
    return picture


def _mark(picture: np.ndarray, mask: np.ndarray) -> None:
    """Draw a white outline around a mask (H, W) of the depth image, a little apart from it."""
    if not mask.any():
        return
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    top, left = (max(int(at[0]) - MARGIN, 0) // CELL * CELL for at in (rows, columns))
    near = mask[top : rows[-1] + MARGIN, left : columns[-1] + MARGIN]
    _blend(picture[top // CELL :, left // CELL :], _grown(near, MARK_OUTER) & ~_grown(near, MARK_INNER), MARK, 100)


def _grown(mask: np.ndarray, radius: int) -> np.ndarray:
    """A mask (H, W), grown by a disc [px]."""
    height, width = mask.shape
    padded, grown = np.pad(mask, radius), mask.copy()
    for y in range(-radius, radius + 1):
        for x in range(-radius, radius + 1):
            if x * x + y * y <= radius * (radius + 1):
                grown |= padded[radius + y : radius + y + height, radius + x : radius + x + width]
    return grown


def _blend(picture: np.ndarray, mask: np.ndarray, colour: Colour, percent: int) -> None:
    """Mix a colour into a picture (H, W, 3) where a mask of the depth image is; both begin at the same corner."""
    height, width = (min(size // CELL, limit) for size, limit in zip(mask.shape, picture.shape[:2], strict=False))
    quarters = mask[: CELL * height, : CELL * width].reshape(height, CELL, width, CELL).sum((1, 3))[..., None]
    old, whole = picture[:height, :width].astype(np.int64), 100 * CELL * CELL
    mixed = old * (whole - percent * quarters) + np.array(colour) * percent * quarters
    picture[:height, :width] = (mixed + whole // 2) // whole


def _window(view: View, mesh: Mesh, world_from_parts: Pose) -> tuple[int, int, Camera]:
    """Where in an image a mesh shows at some poses: first row and column [px], and a camera of this part alone."""
    camera, camera_from_world = view.camera, view.world_from_camera.inverse()
    seen = np.concatenate([(camera_from_world @ pose).apply(mesh.vertices) for pose in world_from_parts])
    size = np.array((camera.width, camera.height))
    first, last = np.zeros(2), size
    if (seen[:, 2] > 0).all():
        uv = camera.project(seen)
        first = np.clip(np.floor(uv.min(0)) - MARGIN, 0, size - CELL) // CELL * CELL
        last = np.clip(np.ceil(uv.max(0)) + MARGIN, first + CELL, size)
    (left, top), (width, height) = first.astype(int).tolist(), (last - first).astype(int).tolist()
    return top, left, Camera(width, height, camera.fx, camera.fy, camera.cx - left, camera.cy - top)
