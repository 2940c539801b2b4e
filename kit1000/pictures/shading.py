"""Shaded pictures of parts, kits and scenes: soft light, outlines and creases, a ground with shadows.

`framing_camera` finds a camera, `shaded_picture` renders, `contact_sheet` arranges pictures with captions. Colours are
8-bit sRGB triples; the palette is that of the whole project.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from kit1000.camera import Camera, look_at
from kit1000.errors import InputError, checked
from kit1000.mesh import Mesh
from kit1000.pictures.creases import draw_lines, smooth_patches
from kit1000.pictures.lighting import ShadingScene, draw_ground, illuminate, place_lamps
from kit1000.pose import Pose
from kit1000.sim.raster import Intrinsics
from kit1000.sim.render import render

if TYPE_CHECKING:
    from PIL import Image, ImageFont

Colour = tuple[int, int, int]

KIT: Colour = (224, 219, 210)  # warm light grey: the plates
PART: Colour = (238, 122, 40)  # orange: the main part
BLUE: Colour = (74, 124, 178)
TEAL: Colour = (62, 152, 146)
SAND: Colour = (222, 184, 104)
PLUM: Colour = (146, 98, 142)
MOSS: Colour = (128, 154, 84)
SLATE: Colour = (112, 122, 136)
TABLE: Colour = (232, 234, 236)
PAPER: Colour = (250, 250, 248)  # background
INK: Colour = (44, 46, 50)  # text
SECONDARY: tuple[Colour, ...] = (BLUE, TEAL, SAND, PLUM, MOSS, SLATE)  # the other parts

PRODUCT_VIEW = (0.75, -1.0, 0.8)  # from the scene to the camera: from the front right, well above
OUTLINE_STEP = 0.012  # smallest depth step with an outline, in radii of the scene
SHIFTS = ((-0.375, 0.125), (-0.125, -0.375), (0.125, 0.375), (0.375, -0.125))
"""[px] of the images whose mean is a picture: no two have the same column or row. Each is lit by other lamps."""
LEVELS = 1 << 14  # of a linear colour, in the table of its values in sRGB


def part_colour(part: int) -> Colour:
    """The colour of the part of this index in a scene."""
    return (PART, *SECONDARY)[part % (1 + len(SECONDARY))]


class ColouredBody(NamedTuple):
    """A body of a picture, with its colour."""

    mesh: Mesh
    pose: Pose  # world_from_body
    colour: Colour


def shaded_picture(
    bodies: Sequence[ColouredBody],
    camera: Camera,
    world_from_camera: Pose,
    background: Colour = PAPER,
    ground: bool = True,
) -> np.ndarray:
    """Render bodies in soft light. (H, W, 3) uint8 sRGB.

    With `ground`, bodies cast a soft shadow on a floor through their lowest point, in the colour of the background; a
    camera below the floor does not see it.
    """
    if not bodies:
        return np.full((camera.height, camera.width, 3), background, np.uint8)
    meshes = [(body.mesh, body.pose) for body in bodies]
    scene, patches = _shading_scene(bodies)
    centre, radius = _bounding_ball(scene.corners.reshape(-1, 3))
    lamps = place_lamps(meshes, centre, radius, _key_direction(world_from_camera))
    viewer = (world_from_camera.rotation_matrix(), world_from_camera.xyz)
    behind = np.full((camera.height, camera.width, 3), _linear(background), np.float32)
    if ground:
        draw_ground(Intrinsics.of(camera), *viewer, lamps, float(scene.corners[..., 2].min()), behind[0, 0], behind)
    total = np.zeros_like(behind)
    for sample, (right, down) in enumerate(SHIFTS):
        shifted = replace(camera, cx=camera.cx + right, cy=camera.cy + down)
        rendered = render(shifted, world_from_camera, meshes, threads=1)
        buffers, image = (rendered.depth, rendered.body_ids, rendered.face_ids), behind.copy()
        illuminate(Intrinsics.of(shifted), *viewer, buffers, scene, lamps, sample, len(SHIFTS), image)
        draw_lines(*buffers, scene.first_face, patches, scene.albedo, OUTLINE_STEP * radius, image)
        total += np.minimum(image, 1, out=image)
    return _srgb(np.divide(total, len(SHIFTS), out=total))


def framing_camera(
    bodies: Sequence[tuple[Mesh, Pose] | ColouredBody],
    direction: ArrayLike = PRODUCT_VIEW,
    size: tuple[int, int] = (1280, 960),
    field_deg: float = 20.0,
    margin: float = 0.08,
) -> tuple[Camera, Pose]:
    """A camera that views the bodies from `direction`, as near as possible with all of them in the image.

    Args:
        bodies: meshes and their world_from_body; colours are ignored.
        direction: from the bodies to the camera. (3,), any length.
        size: width and height of the image [px].
        field_deg: field of view along the longer side of the image.
        margin: free border on each side, as a fraction of the image.

    Returns:
        The camera and its world_from_camera.
    """
    if not bodies:
        raise InputError("framing_camera: expected at least one body")
    back = checked("direction", direction, (3,))
    across = 2 * np.tan(np.deg2rad(field_deg) / 2) * np.array(size) / max(size)  # [m] width and height at 1 m
    camera = Camera(
        width=size[0],
        height=size[1],
        fx=size[0] / across[0],
        fy=size[0] / across[0],
        cx=(size[0] - 1) / 2,
        cy=(size[1] - 1) / 2,
    )
    points = np.concatenate([body[1].apply(body[0].vertices) for body in bodies])
    upright = np.linalg.norm(back[:2]) > 1e-3 * abs(back[2])
    rotation = look_at(back, np.zeros(3), up=(0, 0, 1) if upright else (0, 1, 0))
    x, y, z = rotation.inverse().rotate(points).T
    centre, distances = [], []
    for along, slope in zip((x, y), across / 2 * (1 - 2 * margin), strict=True):
        # A point is left of the right border when along - centre <= slope (z + distance), and so on.
        right, left = (along - slope * z).max(), (-along - slope * z).max()
        centre.append((right - left) / 2)
        distances.append((right + left) / (2 * slope))
    return camera, Pose(rotation.wxyz, rotation.rotate(np.array((*centre, -max(distances)))))


def contact_sheet(
    images: Sequence[np.ndarray | Image.Image], labels: Sequence[str], columns: int = 4, background: Colour = PAPER
) -> Image.Image:
    """Arrange pictures in rows, a caption under each; cells have the size of the largest picture."""
    from PIL import Image, ImageDraw, ImageFont  # only here: one picture needs none of them

    if len(images) != len(labels):
        raise InputError(f"contact_sheet: {len(images)} images but {len(labels)} labels")
    if not images:
        raise InputError("contact_sheet: expected at least one image")
    pictures = [image if isinstance(image, Image.Image) else Image.fromarray(image) for image in images]
    width, height = max(p.width for p in pictures), max(p.height for p in pictures)
    size = max(12, round(width / 20))
    font = ImageFont.load_default(size=size)
    gap, caption = max(4, width // 40), round(1.9 * size)
    columns = max(1, min(columns, len(pictures)))
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * (width + gap) + gap, rows * (height + caption + gap) + gap), background)
    draw = ImageDraw.Draw(sheet)
    for number, (picture, label) in enumerate(zip(pictures, labels, strict=True)):
        left = gap + number % columns * (width + gap)
        top = gap + number // columns * (height + caption + gap)
        sheet.paste(picture, (left + (width - picture.width) // 2, top + (height - picture.height) // 2))
        middle = (left + width / 2, top + height + caption / 2)
        draw.text(middle, _shortened(label, font, width), fill=INK, font=font, anchor="mm")
    return sheet


def _shortened(label: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: float) -> str:
    """The label, its end replaced by dots if it is wider than `width` [px]."""
    if font.getlength(label) <= width:
        return label
    while label and font.getlength(label + "...") > width:
        label = label[:-1]
    return label.rstrip() + "..."


def _shading_scene(bodies: Sequence[ColouredBody]) -> tuple[ShadingScene, np.ndarray]:
    """The bodies as the shading loop needs them, and the smooth patch (m,) of each face, distinct over all bodies."""
    meshes = {id(body.mesh): body.mesh for body in bodies}
    smoothed = {key: smooth_patches(mesh) for key, mesh in meshes.items()}
    corners, normals, flat, patches = [], [], [], []
    first, patch = [0], 0
    for mesh, pose, _ in bodies:
        own_patches, smooth_normals = smoothed[id(mesh)]
        corners.append(pose.apply(mesh.triangles))
        normals.append(pose.rotate(smooth_normals))
        flat.append(pose.rotate(mesh.normals))
        patches.append(own_patches + patch)
        first.append(first[-1] + len(mesh.faces))
        patch += own_patches.max(initial=-1) + 1
    albedo = np.stack([_linear(body.colour) for body in bodies])
    shape = (np.concatenate(corners), np.concatenate(normals), np.concatenate(flat))
    return ShadingScene(np.array(first[:-1]), *shape, albedo), np.concatenate(patches)


def _bounding_ball(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre and radius [m] of a ball that contains points (n, 3), about the centre of their box."""
    centre = (points.min(0) + points.max(0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _key_direction(world_from_camera: Pose) -> np.ndarray:
    """(3,) direction to the key light: high above, to the left of the camera and slightly on its side."""
    right, _, forward = world_from_camera.rotation_matrix().T
    aside = -0.75 * right - 0.25 * forward * (1, 1, 0)
    direction = aside + np.array((0.0, 0.0, 1.15))
    return direction / np.linalg.norm(direction)


def _linear(colour: Colour) -> np.ndarray:
    """(3,) linear light of an sRGB colour (IEC 61966-2-1)."""
    value = np.array(colour) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _srgb(linear: np.ndarray) -> np.ndarray:
    """The inverse of `_linear`, for images. (..., 3) -> (..., 3) uint8."""
    value = np.linspace(0, 1, LEVELS)
    curve = np.where(value <= 0.0031308, value * 12.92, 1.055 * value ** (1 / 2.4) - 0.055)
    place = np.clip(linear, 0, 1)
    place *= LEVELS - 1
    place += 0.5
    return np.round(255 * curve).astype(np.uint8)[place.astype(np.int16)]
