"""Depth images and masks as colour pictures: colour encodes the distance, shading the shape, and holes are dark."""

from __future__ import annotations

import numpy as np

from kit1000.pictures.shading import INK, KIT, TABLE, Colour, part_colour
from kit1000.values import ASSEMBLY_LABEL, FIRST_PART_LABEL, LabelledDepth, View

NEAR_COLOUR: Colour = (250, 214, 120)
MIDDLE_COLOUR: Colour = (76, 148, 150)
FAR_COLOUR: Colour = (46, 52, 110)
LIGHT_DIRECTION = np.array((-0.5, -0.6, -0.62))  # towards the light, in the camera frame: at the upper left
MAX_SLOPE = 8.0  # steeper surfaces, such as the steps between bodies, are shaded like this one


def depth_picture(view: View) -> np.ndarray:
    """A depth image in colour. (H, W, 3) uint8 sRGB; pixels without return in INK."""
    depth = view.depth
    valid = depth > 0
    if not valid.any():
        return np.full((*depth.shape, 3), INK, np.uint8)
    near, far = np.percentile(depth[valid], (0.5, 99.5))
    share = np.clip((depth - near) / max(far - near, 1e-6), 0, 1)[..., None]
    first, last = np.minimum(2 * share, 1), np.maximum(2 * share - 1, 0)
    ramp = np.array(NEAR_COLOUR) * (1 - first) + np.array(MIDDLE_COLOUR) * (first - last) + np.array(FAR_COLOUR) * last
    picture = ramp * _relief_shading(view)[..., None]
    return np.where(valid[..., None], np.clip(picture, 0, 255), INK).astype(np.uint8)


def mask_picture(image: LabelledDepth) -> np.ndarray:
    """The masks of the kits and of each part in colour, shaded. (H, W, 3) uint8 sRGB."""
    colours = np.full((256, 3), TABLE, float)
    colours[ASSEMBLY_LABEL] = np.array(KIT) * 0.8
    for i in range(256 - FIRST_PART_LABEL):
        colours[FIRST_PART_LABEL + i] = part_colour(i)
    picture = colours[image.labels] * _relief_shading(image.view)[..., None]
    return np.where((image.view.depth > 0)[..., None], np.clip(picture, 0, 255), INK).astype(np.uint8)


def _relief_shading(view: View) -> np.ndarray:
    """(H, W) brightness 0.25 .. 1.1 of the surface under one light, from differences of neighbouring depths."""
    depth = np.where(view.depth > 0, view.depth, np.nan).astype(np.float64)
    pixel = depth / view.camera.fx  # [m] width of a pixel at that distance
    with np.errstate(invalid="ignore", divide="ignore"):
        along_u = np.clip(np.gradient(depth, axis=1) / pixel, -MAX_SLOPE, MAX_SLOPE)
        along_v = np.clip(np.gradient(depth, axis=0) / pixel, -MAX_SLOPE, MAX_SLOPE)
    normal = np.stack([along_u, along_v, -np.ones_like(depth)], axis=-1)
    lit = normal @ LIGHT_DIRECTION / np.linalg.norm(normal, axis=-1)
    return np.nan_to_num(0.45 + 0.65 * np.clip(lit, -0.3, 1), nan=0.45)
