"""Visibility of a part and of its cavity in a view, and whether the view is good enough for a query.

Letters: H, W the image, n sample points. Poses are `world_from_x`, depth images as rendered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera
from kit1000.errors import InputError
from kit1000.mesh import Mesh, even_points
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.pose import Pose
from kit1000.sim.raster import NEAR_PLANE, Intrinsics
from kit1000.sim.render import RenderedImage, render
from kit1000.values import Kit

# Limits on the view of a query. With less, no method could do better than guess.
MIN_PART_PIXELS = 800  # a patch of 28 x 28, or 30 mm seen from 1 m
MIN_PART_SHARE = 0.5  # of the part's silhouette: if more is occluded, even a human can only guess its shape
MAX_SLOT_ANGLE = float(np.radians(70))  # from slot axis to line of sight: beyond, a cavity appears a third as wide
MIN_CAVITY_SHARE = 0.15  # of the cavity's surface: about a wall and a strip of floor; less leaves the yaw unknown

CAVITY_SAMPLES = 2000  # points on a cavity: the visible share is accurate to a percent, five slots take under 3 ms
PLANE_TOLERANCE = 1e-6  # [m] for coordinates on the float32 grid, compared with the plate's planes
DEPTH_TOLERANCE = 1e-3  # [m] of a visible sample point behind the depth of its pixel
MAX_SLOPE = 10e-3  # [m] change of a surface's depth within half a pixel; at 1 m, one seen at 86 degrees
RIM_MARGIN = 0.3e-3  # [m] of a cavity's pixels below the top face: well over the 0.12 mm step of recorded depths
ANGLE_DECIMALS = 9  # of a recorded angle [rad]: the last bits of an arctangent differ between processors
UNBOUNDED = np.array([1e9, 1e9])  # [px] farther than any body extends in an image
SIDE_MARGIN = 0.5e-3  # [m] of a cavity's pixels inside the plate's other faces


@dataclass(frozen=True)
class PartVisibility:
    """How much of a part is visible."""

    pixels: int
    share: float
    """Visible share of the silhouette of the part alone in an unbounded image."""


@dataclass(frozen=True)
class SlotVisibility:
    """How a slot is visible."""

    angle: float
    """[rad], as of `slot_angle`."""
    share: float
    """Visible share of the cavity's surface area."""


class CavitySurface(NamedTuple):
    """Sample points of a kit's cavity, of equal area each, in the kit frame; arrays read-only."""

    points: np.ndarray
    """(n, 3) [m]"""
    normals: np.ndarray
    """(n, 3) unit vectors, out of the material."""


def part_visibility(
    frame: RenderedImage, index: int, camera: Camera, world_from_camera: Pose, mesh: Mesh, world_from_part: Pose
) -> PartVisibility:
    """How much a rendered image shows of body `index`, which has this mesh and pose."""
    pixels = int(np.count_nonzero(frame.body_ids == index + 1))
    alone = silhouette_pixels(camera, world_from_camera, mesh, world_from_part)
    return PartVisibility(pixels, pixels / alone if alone else 0.0)


def silhouette_pixels(camera: Camera, world_from_camera: Pose, mesh: Mesh, world_from_part: Pose) -> int:
    """The number of pixels that a body alone covers, including those outside the image.

    Only its bounding box is rendered: a camera with a shifted principal point sees exactly the same pixels.
    """
    points = (world_from_camera.inverse() @ world_from_part).apply(mesh.vertices)
    _, _, around = camera.window(points, -UNBOUNDED, UNBOUNDED)
    return int(np.count_nonzero(render(around, world_from_camera, [(mesh, world_from_part)], threads=1).body_ids))


def slot_visibility(
    depth: np.ndarray, camera: Camera, world_from_camera: Pose, kit: Kit, world_from_kit: Pose
) -> SlotVisibility:
    """How visible the slot of a kit is in a depth image (H, W) [m] without noise."""
    camera_from_kit = world_from_camera.inverse() @ world_from_kit
    points, normals = cavity_surface(kit)
    rotation, translation = camera_from_kit.rotation_matrix(), camera_from_kit.xyz
    count = _count_visible(Intrinsics.of(camera), depth, points, normals, rotation, translation)
    return SlotVisibility(slot_angle(world_from_camera, world_from_kit), count / len(points))


def slot_angle(world_from_camera: Pose, world_from_kit: Pose) -> float:
    """[rad] between a kit's +z and the direction from the centre of its top face to the camera."""
    axis, to_camera = world_from_kit.rotate((0.0, 0.0, 1.0)), world_from_camera.xyz - world_from_kit.xyz
    return round(float(np.arctan2(length(np.cross(axis, to_camera)), matmul(axis, to_camera))), ANGLE_DECIMALS)


def view_redraw_reason(part: PartVisibility, slot: SlotVisibility) -> str | None:
    """The redraw reason of a view that is not good enough for a query about a part and its slot; else None."""
    if part.pixels < MIN_PART_PIXELS:
        return "part small in the image"
    if part.share < MIN_PART_SHARE:
        return "part mostly hidden"
    if slot.angle > MAX_SLOT_ANGLE:
        return "slot turned away"
    if slot.share < MIN_CAVITY_SHARE:
        return "cavity mostly hidden"
    return None


def cavity_labels(
    depth: np.ndarray,
    camera: Camera,
    world_from_camera: Pose,
    world_from_kits: Sequence[Pose] | Pose,
    kits: Sequence[Kit],
) -> np.ndarray:
    """(H, W) int16: the index of the kit whose cavity contains the point seen by a pixel, -1 for none.

    A point is in a cavity when it is inside the bounding box of the plate, by RIM_MARGIN from its top face and by
    SIDE_MARGIN from the others: inside the box, only the cavity is empty.
    """
    labels = np.full(depth.shape, -1, np.int16)
    intrinsics, camera_from_world = Intrinsics.of(camera), world_from_camera.inverse()
    size = (camera.width, camera.height)
    for number, (kit, world_from_kit) in enumerate(zip(kits, world_from_kits, strict=True)):
        camera_from_kit = camera_from_world @ world_from_kit
        low = kit.extent * (-0.5, -0.5, -1) + SIDE_MARGIN
        high = np.array([*(kit.extent[:2] / 2 - SIDE_MARGIN), -RIM_MARGIN])
        left, top, seen = camera.window(camera_from_kit.apply(_box_corners(low, high)), (0, 0), size)
        window = np.array([[left, top], [left + seen.width, top + seen.height]])
        rotation, translation = camera_from_kit.rotation_matrix(), camera_from_kit.xyz
        _label_box(intrinsics, depth, window, rotation, translation, low, high, number, labels)
    return labels


@lru_cache(maxsize=64)
def cavity_surface(kit: Kit) -> CavitySurface:
    """CAVITY_SAMPLES points evenly spread over the cavity's surface, the same ones at every call."""
    triangles, normals = _cavity_faces(kit)
    points, face = even_points(triangles, CAVITY_SAMPLES)
    surface = CavitySurface(points, normals[face])
    for array in surface:
        array.setflags(write=False)
    return surface


def _cavity_faces(kit: Kit) -> tuple[np.ndarray, np.ndarray]:
    """(k, 3, 3) corners and (k, 3) normals of the faces of a kit that are on none of its plate's six planes."""
    middles = kit.mesh.triangles.mean(1)
    low, high = kit.extent * (-0.5, -0.5, -1) + PLANE_TOLERANCE, kit.extent * (0.5, 0.5, 0) - PLANE_TOLERANCE
    inside = ((middles > low) & (middles < high)).all(1)
    if not inside.any():
        raise InputError(f"kit {kit.id}: expected a plate with a cavity, got none")
    return kit.mesh.triangles[inside], kit.mesh.normals[inside]


@compiled
def _count_visible(intrinsics, depth, points, normals, rotation, translation):
    """The number of visible points (n, 3) of a surface in a depth image without noise; the pose is camera_from_kit."""
    count = 0
    for i in range(points.shape[0]):
        x, y, z = _rotated(rotation, points, i)
        a, b, c = _rotated(rotation, normals, i)
        x, y, z = x + translation[0], y + translation[1], z + translation[2]
        distance = a * x + b * y + c * z  # of the camera from the surface's plane; negative in front of it
        if z < NEAR_PLANE or distance >= 0:
            continue
        u, v = round(intrinsics.fx * x / z + intrinsics.cx), round(intrinsics.fy * y / z + intrinsics.cy)
        if u < 0 or v < 0 or u >= intrinsics.width or v >= intrinsics.height or depth[v, u] == 0:
            continue
        # The pixel's centre is up to half a pixel from the point, where a sloping surface has another depth.
        along = a * (u - intrinsics.cx) / intrinsics.fx + b * (v - intrinsics.cy) / intrinsics.fy + c
        slope = min(abs(distance / along - z), MAX_SLOPE) if along < 0 else MAX_SLOPE
        count += z - depth[v, u] < DEPTH_TOLERANCE + slope
    return count


@compiled
def _rotated(rotation, vectors, i):
    """Vector i of (n, 3), rotated."""
    x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


def _box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(8, 3) corners of a box."""
    return np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, 8).T


@compiled
def _label_box(intrinsics, depth, window, rotation, translation, low, high, number, labels):
    """Write `number` to `labels` (H, W) where the point of a pixel is in a box; the pose is camera_from_box.

    window: (2, 2) first and last + 1 pixel x, y to look at.
    """
    for v in range(window[0, 1], window[1, 1]):
        for u in range(window[0, 0], window[1, 0]):
            z = depth[v, u]
            x, y, z = (
                (u - intrinsics.cx) / intrinsics.fx * z - translation[0],
                (v - intrinsics.cy) / intrinsics.fy * z - translation[1],
                z - translation[2],
            )
            inside = depth[v, u] > 0
            for axis in range(3):  # the inverse rotation is the transpose
                along = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
                inside &= low[axis] <= along <= high[axis]
            if inside:
                labels[v, u] = number
