"""The picture by which a person judges labels: outlines of shapes on the depth image, the residual in colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo
from scipy.ndimage import binary_dilation

from kit1000.mesh import Mesh
from kit1000.pictures.dataset_sheets import window_of_bodies
from kit1000.pictures.depth_images import depth_picture
from kit1000.pictures.shading import INK, KIT, PAPER, Colour, contact_sheet, part_colour
from kit1000.pose import Pose
from kit1000.sim.render import render
from kit1000.values import FIRST_PART_LABEL, LabelledDepth

NEARER: Colour = (202, 60, 44)  # measured nearer than the shape
AGREES: Colour = (244, 244, 240)
FARTHER: Colour = (40, 92, 176)
MISSING: Colour = (222, 176, 40)  # the shape is here, and the mask is not
STRAY: Colour = (120, 60, 140)  # the mask is here, and no shape
NO_RETURN: Colour = (150, 152, 156)
MOST = 5e-3  # [m] of the residual at full colour
TILE_WIDTH = 1200  # [px]
LEGEND = f"measured {MOST * 1e3:g} mm nearer: red, farther: blue; mask alone: purple, shape alone: yellow"


@dataclass(frozen=True, eq=False)
class DrawnBody:
    """A shape at its pose, as it is drawn."""

    name: str
    label: int
    mesh: Mesh
    camera_from_body: Pose


def residual_picture(image: LabelledDepth, bodies: Sequence[DrawnBody], scale: float, title: str) -> bytes:
    """A PNG: the shapes' outlines on the depth image, and measured less rendered depth in colour.

    Args:
        image: the depth image with its masks.
        bodies: the shapes at their poses.
        scale: measured over true depth.
        title: caption of the picture.
    """
    shapes = [(body.mesh, body.camera_from_body) for body in bodies]
    shown = render(image.view.camera, Pose.identity(), shapes, threads=1)
    window = window_of_bodies(np.where(shown.body_ids > 0, 1, image.labels))
    outlines = depth_picture(image.view)
    for number, body in enumerate(bodies, start=1):
        alone = shown.body_ids == number
        colour = KIT if body.label < FIRST_PART_LABEL else part_colour(body.label - FIRST_PART_LABEL)
        outlines[binary_dilation(alone) & ~alone] = colour
    residual = residual_colours(image, shown.depth.astype(float), scale)
    tiles = [_tile(picture[window]) for picture in (outlines, residual)]
    _write_names(tiles[0], bodies, image, window)
    sheet = contact_sheet(tiles, [f"{title}: outlines of the shapes", LEGEND], columns=2)
    buffer, about = BytesIO(), PngInfo()
    about.add_text("Software", "kit1000")
    sheet.save(buffer, "PNG", pnginfo=about)
    return buffer.getvalue()


def residual_colours(image: LabelledDepth, rendered: np.ndarray, scale: float) -> np.ndarray:
    """(H, W, 3) uint8: the residual of each pixel that a shape or a mask has; paper elsewhere.

    rendered: (H, W) [m] depths of the shapes, 0 where there is none.
    """
    measured, inside = image.view.depth.astype(float), rendered > 0
    picture = np.full((*measured.shape, 3), PAPER, np.uint8)
    share = np.clip((measured / scale - rendered) / MOST, -1, 1)
    colours = _ramp(share)
    both = inside & (image.labels > 0) & (measured > 0)
    picture[both] = colours[both]
    picture[inside & (measured == 0)] = NO_RETURN
    picture[inside & (image.labels == 0) & (measured > 0)] = MISSING
    picture[~inside & (image.labels > 0)] = STRAY
    return picture


def _ramp(share: np.ndarray) -> np.ndarray:
    """(..., 3) uint8 colours of residuals (...,) in units of MOST."""
    near, far = np.clip(-share, 0, 1)[..., None], np.clip(share, 0, 1)[..., None]
    middle = np.array(AGREES, float)
    return (middle * (1 - near - far) + np.array(NEARER) * near + np.array(FARTHER) * far).astype(np.uint8)


def _tile(picture: np.ndarray) -> Image.Image:
    height, width = picture.shape[:2]
    size = (TILE_WIDTH, round(height * TILE_WIDTH / width))
    return Image.fromarray(np.ascontiguousarray(picture)).resize(size, Image.Resampling.NEAREST)


def _write_names(
    tile: Image.Image, bodies: Sequence[DrawnBody], image: LabelledDepth, window: tuple[slice, slice]
) -> None:
    """Write the name of each body at its centre."""
    draw, font = ImageDraw.Draw(tile), ImageFont.load_default(size=20)
    factor = TILE_WIDTH / (window[1].stop - window[1].start)
    for body in bodies:
        centre = body.camera_from_body.apply(body.mesh.bounds.mean(0))
        u, v = image.view.camera.project(centre)
        place = ((u - window[1].start) * factor, (v - window[0].start) * factor)
        draw.text(place, body.name, fill=PAPER, font=font, anchor="mm", stroke_width=2, stroke_fill=INK)
