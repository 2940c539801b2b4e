"""Pictures of depth images and masks: colour encodes the distance or the body, light shows the shape, holes are dark.

The light is that of the pictures of meshes (`kit1000.pictures.lighting`), without shadows. Everything is computed by
sums, products, quotients and square roots: a picture has the same bytes on every processor.
"""

from __future__ import annotations

import numpy as np

from kit1000.camera import Camera
from kit1000.pictures.creases import draw_lines
from kit1000.pictures.lighting import open_light
from kit1000.pictures.shading import INK, KIT, TABLE, Colour, part_colour
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, View

NEAR_COLOUR: Colour = (250, 214, 120)
MIDDLE_COLOUR: Colour = (76, 148, 150)
FAR_COLOUR: Colour = (46, 52, 110)
KEY = np.array((-0.55, -0.62, -0.56))  # towards the light, in the camera frame: from the upper left
UP = np.array((0.0, -0.6, -0.8))  # towards the sky, in the frame of a camera that looks down at 53 degrees
REACH = 2  # [px] from a pixel to those that determine its normal: steps of the depth grid matter less
LINE_STEP = 0.004  # [m] departure from a plane beyond which a line is drawn


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
    light = np.square(ramp)
    light[valid] *= surface_light(view.camera, depth, valid)
    return colours_of(light, valid)


def mask_picture(image: LabelledDepth, table: Colour = TABLE) -> np.ndarray:
    """The masks of the kits and of each part in colour, lit, with lines around bodies. (H, W, 3) uint8 sRGB."""
    whole = (slice(None), slice(None))
    return colours_of(mask_light(image.view, image.labels, table, whole), image.view.depth > 0)


def mask_light(view: View, labels: np.ndarray, table: Colour, window: tuple[slice, slice]) -> np.ndarray:
    """(h, w, 3) float32 light of a picture of masks, as `colours_of` expects it; the table is unlit.

    Args:
        view: the depth image (H, W).
        labels: (H, W) uint8 masks.
        table: colour of the table.
        window: rows and columns of the image that the picture shows.
    """
    parts = (part_colour(part) for part in range(256 - FIRST_PART_LABEL))
    squares = np.square([table, KIT, *parts]).astype(np.float32)
    depth, kinds = view.depth[window], labels[window]
    picture, bodies = squares[kinds], kinds > 0
    inside = np.zeros(labels.shape, bool)
    inside[window] = bodies
    picture[bodies] *= surface_light(view.camera, view.depth, inside)
    faces, zeros = np.zeros(kinds.shape, np.int32), np.zeros(256, np.int32)
    draw_lines(depth, kinds.astype(np.int32) + 1, faces, zeros, zeros, squares, LINE_STEP, picture)
    return picture


def colours_of(light: np.ndarray, valid: np.ndarray, nothing: Colour = INK) -> np.ndarray:
    """(H, W, 3) uint8 sRGB of light in squares of 0 .. 255; `nothing` where valid (H, W) is false."""
    colours = np.sqrt(np.clip(light, 0, 255 * 255)) + 0.5
    return np.where(valid[..., None], colours, np.array(nothing)).astype(np.uint8)


def surface_light(camera: Camera, depth: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(n, 3) the light on a surface that nothing shades, about 1 on a level one, at the pixels of a mask.

    It is 1 at pixels without return, and at those whose neighbours determine no normal.

    Args:
        camera: the intrinsics.
        depth: (H, W) [m], 0 for no return.
        where: (H, W) bool, true at n pixels.
    """
    return np.nan_to_num(open_light(surface_normals(camera, depth, where), KEY, UP), nan=1.0)


def surface_normals(camera: Camera, depth: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(n, 3) unit normals towards the camera in its frame, with the arguments of `surface_light`; nan for unknown ones.

    A pixel takes the flatter of the surfaces on its two sides, so that edges stay sharp. On a plane the inverse depth
    is linear: it is m . ((u - cx) / fx, (v - cy) / fy, 1) for a vector m along the normal.
    """
    padded = np.full(np.add(depth.shape, 2 * REACH), np.nan)
    np.divide(1.0, depth, out=padded[REACH:-REACH, REACH:-REACH], where=depth > 0)
    row, values = len(padded[0]), padded.ravel()
    v, u = np.divmod(np.flatnonzero(where), len(where[0]))
    place = (v + REACH) * row + u + REACH
    here = values[place]
    down = _flatter(here - values[place - REACH * row], values[place + REACH * row] - here)
    across = _flatter(here - values[place - REACH], values[place + REACH] - here)
    forward = here - across * (u - camera.cx) - down * (v - camera.cy)
    normals = np.stack([across * camera.fx, down * camera.fy, forward], axis=-1)
    squares = normals * normals
    return -normals / np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2])[:, None]


def _flatter(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(n,) the smaller of two differences over REACH pixels, as a slope; the other one if one is nan."""
    return np.where((np.abs(after) < np.abs(before)) | np.isnan(before), after, before) / REACH
