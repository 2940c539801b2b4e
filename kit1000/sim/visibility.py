"""What a camera sees of a part and of the cavity it belongs in, and whether that is enough to ask about them.

Letters: H, W the image, n sample points. Poses are `world_from_x`, depth images as the renderer makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from kit1000.camera import Camera
from kit1000.compiled import compiled
from kit1000.errors import InputError
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.sim.raster import NEAR_PLANE, Intrinsics
from kit1000.sim.render import Frame, render
from kit1000.values import Kit

# What a question about a part and its slot asks of the view; less, and no method could do better than guess.
MIN_PART_PIXELS = 800  # of the part: a patch of 28 x 28, or 30 mm seen from 1 m
MIN_PART_SHARE = 0.5  # of the part's silhouette: with more of it hidden, even a person would have to guess its shape
MAX_SLOT_ANGLE = float(
    np.radians(70)
)  # between slot axis and line of sight: beyond, a cavity is a slit of a third its width
MIN_CAVITY_SHARE = 0.15  # of the cavity's surface: about a wall and a strip of the floor, less tells no turn

CAVITY_SAMPLES = 2000  # of a cavity: the share of surface seen is good to a percent, five slots take under 3 ms
PLANE_TOLERANCE = 1e-6  # [m] coordinates on the float32 grid, compared with the plate's planes
DEPTH_TOLERANCE = 1e-3  # [m] that a point may lie behind what a pixel sees and still be what it sees
MAX_SLOPE = 10e-3  # [m] that a surface's depth may change within half a pixel; at 1 m, one seen at 86 degrees
RIM_MARGIN = (
    0.3e-3  # [m] that a pixel of a cavity lies below the top face: well over a recorded depth's step of 0.12 mm
)
SIDE_MARGIN = 0.5e-3  # [m] that it lies inside the plate's other faces


@dataclass(frozen=True)
class PartVisibility:
    """How much of a part is seen."""

    pixels: int
    share: float
    """Of its silhouette, were it alone in an image without borders."""


@dataclass(frozen=True)
class SlotVisibility:
    """How a slot is seen."""

    angle: float
    """See `slot_angle`."""
    share: float
    """Of the cavity's surface area."""


class CavitySurface(NamedTuple):
    """Points that stand for equal shares of the area of a kit's cavity, in the kit frame; arrays read-only."""

    points: np.ndarray
    """(n, 3) [m]"""
    normals: np.ndarray
    """(n, 3) unit vectors, out of the material."""


def part_visibility(
    frame: Frame, index: int, camera: Camera, world_from_camera: Pose, mesh: Mesh, world_from_part: Pose
) -> PartVisibility:
    """How much a frame shows of the body that was handed to the renderer at place `index`, with this mesh and pose."""
    pixels = int(np.count_nonzero(frame.ids == index + 1))
    alone = silhouette_pixels(camera, world_from_camera, mesh, world_from_part)
    return PartVisibility(pixels, pixels / alone if alone else 0.0)


def silhouette_pixels(camera: Camera, world_from_camera: Pose, mesh: Mesh, world_from_part: Pose) -> int:
    """How many pixels a body covers that stands alone, those that lie outside the image included.

    Only the box around it is rendered: a camera that differs in its corner alone sees the very same pixels.
    """
    uv = camera.project((world_from_camera.inverse() @ world_from_part).apply(mesh.vertices))
    if np.isnan(uv).any():
        raise InputError("part: expected one wholly before the camera, got vertices behind it")
    (left, top), (right, bottom) = np.floor(uv.min(0)).astype(int), np.ceil(uv.max(0)).astype(int)
    around = Camera(right - left + 1, bottom - top + 1, camera.fx, camera.fy, camera.cx - left, camera.cy - top)
    return int(np.count_nonzero(render(around, world_from_camera, [(mesh, world_from_part)], threads=1).ids))


def slot_visibility(
    depth: np.ndarray, camera: Camera, world_from_camera: Pose, kit: Kit, world_from_kit: Pose
) -> SlotVisibility:
    """How a depth image (H, W) [m] without noise shows the slot of a kit."""
    camera_from_kit = world_from_camera.inverse() @ world_from_kit
    points, normals = cavity_surface(kit)
    rotation, shift = camera_from_kit.rotation_matrix(), camera_from_kit.xyz
    count = _count_visible(Intrinsics.of(camera), depth, points, normals, rotation, shift)
    return SlotVisibility(slot_angle(world_from_camera, world_from_kit), count / len(points))


def slot_angle(world_from_camera: Pose, world_from_kit: Pose) -> float:
    """[rad] between a kit's +z and the direction from the middle of its top face to the camera."""
    axis, to_camera = world_from_kit.rotate((0.0, 0.0, 1.0)), world_from_camera.xyz - world_from_kit.xyz
    return float(np.arctan2(np.linalg.norm(np.cross(axis, to_camera)), axis @ to_camera))


def invisibility_reason(part: PartVisibility, slot: SlotVisibility) -> str | None:
    """Why a view is not good enough to ask about a part and its slot, in a few words; None when it is."""
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
    """(H, W) int16: the number of the kit in whose cavity the point behind a pixel lies, -1 for none.

    A point lies in a cavity when it lies BELOW_RIM and OFF_SIDES of the other faces inside the block that the plate
    was cut from: there is air there and nowhere else.
    """
    if len(kits) != len(world_from_kits):
        raise InputError(f"kits: expected one for each of {len(world_from_kits)} poses, got {len(kits)}")
    labels = np.full(depth.shape, -1, np.int16)
    lens, camera_from_world = Intrinsics.of(camera), world_from_camera.inverse()
    for number, (kit, world_from_kit) in enumerate(zip(kits, world_from_kits, strict=True)):
        camera_from_kit = camera_from_world @ world_from_kit
        low = kit.extent * (-0.5, -0.5, -1) + SIDE_MARGIN
        high = np.array([*(kit.extent[:2] / 2 - SIDE_MARGIN), -RIM_MARGIN])
        window = _pixel_window(camera, camera_from_kit.apply(_box_corners(low, high)))
        rotation, shift = camera_from_kit.rotation_matrix(), camera_from_kit.xyz
        _label_box(lens, depth, window, rotation, shift, low, high, number, labels)
    return labels


@lru_cache(maxsize=64)
def cavity_surface(kit: Kit) -> CavitySurface:
    """SAMPLES points of the cavity's surface, the same ones at every call.

    Evenly spaced along the running sum of the areas of the faces, and spread within them by the additive recurrence
    of the plastic number (Roberts 2018), whose every run of points is even in two dimensions.
    """
    triangles, normals = _cavity_faces(kit)
    corner, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    total = np.cumsum(np.linalg.norm(np.cross(u, v), axis=1))
    order = np.arange(CAVITY_SAMPLES) + 0.5
    face = np.searchsorted(total, order / CAVITY_SAMPLES * total[-1])
    a, b = (order[:, None] * _PLASTIC % 1).T
    a, b = np.where(a + b > 1, 1 - a, a), np.where(a + b > 1, 1 - b, b)  # fold the square onto the triangle
    points = corner[face] + a[:, None] * u[face] + b[:, None] * v[face]
    return CavitySurface(_read_only(points), _read_only(normals[face]))


_PLASTIC = 1.3247179572447460 ** -np.arange(1.0, 3.0)  # the recurrence's two steps; the number solves x^3 = x + 1


def _cavity_faces(kit: Kit) -> tuple[np.ndarray, np.ndarray]:
    """(k, 3, 3) corners and (k, 3) normals of the faces of a kit that lie on none of its plate's six planes."""
    middles = kit.mesh.triangles.mean(1)
    low, high = kit.extent * (-0.5, -0.5, -1) + PLANE_TOLERANCE, kit.extent * (0.5, 0.5, 0) - PLANE_TOLERANCE
    inside = ((middles > low) & (middles < high)).all(1)
    if not inside.any():
        raise InputError(f"kit {kit.id}: expected a plate with a cavity, got none")
    return kit.mesh.triangles[inside], kit.mesh.normals[inside]


@compiled
def _count_visible(lens, depth, points, normals, rotation, shift):
    """How many points (n, 3) of a surface a depth image without noise shows; the pose takes them to the camera."""
    count = 0
    for i in range(points.shape[0]):
        x, y, z = _rotated(rotation, points, i)
        a, b, c = _rotated(rotation, normals, i)
        x, y, z = x + shift[0], y + shift[1], z + shift[2]
        distance = a * x + b * y + c * z  # of the camera from the surface's plane; negative: before it
        if z < NEAR_PLANE or distance >= 0:
            continue
        u, v = round(lens.fx * x / z + lens.cx), round(lens.fy * y / z + lens.cy)
        if u < 0 or v < 0 or u >= lens.width or v >= lens.height or depth[v, u] == 0:
            continue
        # The pixel's centre looks past the point by half a pixel, where a sloping surface has another depth.
        along = a * (u - lens.cx) / lens.fx + b * (v - lens.cy) / lens.fy + c
        slope = min(abs(distance / along - z), MAX_SLOPE) if along < 0 else MAX_SLOPE
        count += z - depth[v, u] < DEPTH_TOLERANCE + slope
    return count


@compiled
def _rotated(rotation, vectors, i):
    """Vector i of (n, 3), turned."""
    x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


def _box_corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(8, 3) corners of a box."""
    return np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, 8).T


def _pixel_window(camera: Camera, points: np.ndarray) -> tuple[int, int, int, int]:
    """Rows and columns, each from and up to, that can show the hull of points (k, 3) in the camera frame."""
    uv = camera.project(points)
    if np.isnan(uv).any():  # it reaches behind the camera: its image has no bounds
        return 0, camera.height, 0, camera.width
    size = np.array([camera.width, camera.height])
    left, top = np.clip(np.floor(uv.min(0)), 0, size).astype(int).tolist()
    right, bottom = np.clip(np.ceil(uv.max(0)) + 1, 0, size).astype(int).tolist()
    return top, bottom, left, right


@compiled
def _label_box(lens, depth, window, rotation, shift, low, high, number, labels):
    """Write `number` to `labels` (H, W) where a pixel's point lies in a box; the pose takes its frame to the camera."""
    top, bottom, left, right = window
    for v in range(top, bottom):
        for u in range(left, right):
            z = depth[v, u]
            x, y, z = (u - lens.cx) / lens.fx * z - shift[0], (v - lens.cy) / lens.fy * z - shift[1], z - shift[2]
            inside = depth[v, u] > 0
            for axis in range(3):  # the inverse rotation is the transpose
                along = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
                inside &= low[axis] <= along <= high[axis]
            if inside:
                labels[v, u] = number


def _read_only(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array
