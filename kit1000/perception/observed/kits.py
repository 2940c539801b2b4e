"""Kits from one depth image: solid below the observed surface, along the normal of the plate.

A height map has CELLS x CELLS cells in the plate's frame: z along its normal, x away from the camera, the origin on its
face below a given middle. So the scene may stand anywhere and the camera looks from the same side. Depths are counted
from the face, down, in millimetres. What lies in the shadow of rims is hidden; a network may complete it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kit1000.mesh import Mesh
from kit1000.numerics.compiled import compiled
from kit1000.numerics.linear_algebra import length, matmul
from kit1000.perception.image_kinds import Noise
from kit1000.perception.observed.columns import MaskedView, ObservedColumns
from kit1000.perception.observed.occupancy import filled_share
from kit1000.perception.observed.pixels import cropped, depth_slopes, oriented_points, subpixel_points, transformed
from kit1000.perception.observed.plates import Plane, find_planes, plane_frame
from kit1000.pose import Pose
from kit1000.rng import stream
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth, View
from kit1000.voxels import Grid, Volume

CELL = 1e-3  # [m]
CELLS = 80  # across: they hold the cavity of a part of 50 mm with its rim
DEEPEST = 22  # [mm] below the face: a plate's thickness, of which 2 mm are floor
HIGHEST = 2.0  # [mm] above the face
STEP = 2.0  # [mm] along the normal: nothing below a rim's shadow is free again
HALVINGS = 7  # of a step, to the end of what is seen free
BESIDE = 1.0  # [m] behind what is no kit: its surface is none of the plate's
LEAST_OFFSET = 1e-4  # [m] of the middle from the foot of the camera, that gives a direction away from it
HALF_WIDTH = 0.045  # [m] from the middle of a volume to its sides: no part of 50 mm is wider
HALF_HEIGHT = 0.03  # [m] to its top and bottom: no cavity is deeper, and nothing higher touches a part
UPRIGHT = Plane(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0)


@dataclass(frozen=True, eq=False)
class SeenHeights:
    """What one image shows of the heights of a plate."""

    world_from_plate: Pose
    """z along the plate's normal, x away from the camera, the origin on the plate in the middle of the image."""
    least: np.ndarray
    """(CELLS, CELLS) float32 [mm]: the depth down to which the image shows free space, -HIGHEST to DEEPEST."""
    seen: np.ndarray
    """(CELLS, CELLS) bool: whether there is a surface at that depth, or no surface above DEEPEST; else it is hidden."""
    camera: np.ndarray
    """(2,) float32: polar angle [rad] and distance [m] of the camera."""


@dataclass(frozen=True, eq=False)
class CompletedHeights:
    """The heights of a plate with likely depths for hidden cells."""

    shown: SeenHeights
    """What the image shows of it."""
    depths: np.ndarray
    """(CELLS, CELLS) float32 [mm]: seen cells as they were seen, hidden ones likely; DEEPEST where nothing is."""

    def filled(self, fine: Grid) -> np.ndarray:
        """(nx, ny, nz / 2) bool: the cells of every second layer of a grid that lie below the surface of a hidden cell.

        fine: its third axis is the plate's normal, as of `ObservedColumns.fine`.
        """
        nx, ny, nz = fine.shape
        plate_from_grid = self.shown.world_from_plate.inverse() @ fine.world_from_grid
        feet = np.stack([*np.indices((nx, ny)), np.zeros((nx, ny))], -1) * fine.voxel_size
        points = plate_from_grid.apply(feet)
        cells = np.rint(points[..., :2] / CELL + (CELLS - 1) / 2).astype(int)
        inside = ((cells >= 0) & (cells < CELLS)).all(-1)
        at = tuple(np.moveaxis(np.clip(cells, 0, CELLS - 1), -1, 0))
        there = inside & ~self.shown.seen[at] & (self.depths[at] < DEEPEST)
        top = np.where(there, -1e-3 * self.depths[at].astype(np.float64), -np.inf)
        heights = points[0, 0, 2] + np.arange(0, nz, 2) * fine.voxel_size
        return heights <= top[..., None]


def seen_heights(image: LabelledDepth, plate: Plane, middle: np.ndarray, noise: Noise) -> SeenHeights:
    """The heights of a plate about the foot of a middle.

    Args:
        image: may be cropped.
        plate: its face.
        middle: (3,) [m] world.
        noise: what is farther than its distance behind the depth of a pixel is hidden.
    """
    view = image.view
    world_from_plate = away_frame(plate, middle, view.world_from_camera.xyz)
    mask = (image.labels == ASSEMBLY_LABEL) & (view.depth > 0)
    depth = view.depth.astype(np.float64)
    signed = np.where(mask, depth, -depth)
    slopes = [depth_slopes(depth, mask, axis) for axis in (1, 0)]
    camera_from_plate = view.world_from_camera.inverse() @ world_from_plate
    intrinsics = np.array([view.camera.fx, view.camera.fy, view.camera.cx, view.camera.cy])
    least, seen = np.empty((CELLS, CELLS), np.float32), np.zeros((CELLS, CELLS), bool)
    rotation, shift = camera_from_plate.rotation_matrix(), camera_from_plate.xyz
    _descend(signed, *slopes, intrinsics, rotation, shift, noise.distance, least, seen)
    towards = world_from_plate.inverse().apply(view.world_from_camera.xyz)
    distance = max(length(towards), CELL)
    polar = np.arccos(np.clip(towards[2] / distance, -1, 1))
    return SeenHeights(world_from_plate, least, seen, np.array([polar, distance], np.float32))


def away_frame(plate: Plane, middle: np.ndarray, camera: np.ndarray) -> Pose:
    """world_from_plate about the foot of a middle (3,) [m], x away from a camera (3,) [m]; world."""
    level = plane_frame(plate, middle)
    away = middle - camera
    away = away - plate.normal * float(matmul(plate.normal, away))
    if length(away) < LEAST_OFFSET:
        return level
    x = away / length(away)
    return Pose.from_rotation_matrix(np.stack([x, np.cross(plate.normal, x), plate.normal], axis=1), level.xyz)


def true_depths(mesh: Mesh, world_from_mesh: Pose, world_from_plate: Pose) -> np.ndarray:
    """(CELLS, CELLS) float32 [mm], 0 to DEEPEST: the mean depth of a mesh's surface in each cell of a heights."""
    return DEEPEST - filled_share(mesh, world_from_mesh, height_grid(world_from_plate)).sum(-1)


def height_grid(world_from_plate: Pose) -> Grid:
    """The cells of 1 mm below the cells of a heights, down to DEEPEST."""
    middle = Pose.from_translation((0.0, 0.0, -CELL * DEEPEST / 2))
    return Grid.centred(world_from_plate @ middle, (CELLS, CELLS, DEEPEST), CELL)


@compiled
def _descend(signed, across, down, intrinsics, rotation, shift, skin, least, seen):
    """Fill `least` and `seen`, going down each cell until a sample is not seen to be free.

    signed: (H, W) [m] depth, negated outside the kits, 0 without return; across, down: its slopes [m/px].
    """
    n = least.shape[0]
    for i in range(n):
        for j in range(n):
            x, y = (i - (n - 1) / 2) * CELL, (j - (n - 1) / 2) * CELL
            free, depth, behind = np.nan, -HIGHEST, np.nan
            while depth <= DEEPEST:
                behind = _behind(x, y, depth, signed, across, down, intrinsics, rotation, shift)
                if behind > 0:
                    break
                free = depth if behind <= 0 else free
                depth += STEP
            if not behind > 0:  # down to the deepest, or the image knows nothing more
                least[i, j] = -HIGHEST if np.isnan(free) else free
                seen[i, j] = free > DEEPEST - STEP
                continue
            low = depth - STEP if np.isnan(free) else free
            for _ in range(HALVINGS):
                middle = (low + depth) / 2
                there = _behind(x, y, middle, signed, across, down, intrinsics, rotation, shift)
                if there <= 0:
                    low = middle
                else:
                    depth, behind = middle, there
            least[i, j], seen[i, j] = max(low, -HIGHEST), behind < skin


@compiled
def _behind(x, y, depth, signed, across, down, intrinsics, rotation, shift):
    """[m] of a point of the plate's frame behind what its pixel shows, negative where it is seen free; NaN: unknown."""
    fx, fy, cx, cy = intrinsics
    px, py, pz = transformed(rotation, shift, x, y, -1e-3 * depth)
    if pz <= 0:
        return np.nan
    u, v = px / pz * fx + cx, py / pz * fy + cy
    a, b = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    if not (0 <= a < signed.shape[1] and 0 <= b < signed.shape[0]) or signed[b, a] == 0:
        return np.nan
    if signed[b, a] > 0:
        return pz - signed[b, a] - across[b, a] * (u - a) - down[b, a] * (v - b)
    return -1.0 if pz <= -signed[b, a] else BESIDE


Completer = Callable[[SeenHeights], CompletedHeights]
"""Completes what no pixel shows of a plate."""


@dataclass(frozen=True, eq=False)
class ObservedKits:
    """The kits in a depth image, which may be cropped."""

    image: LabelledDepth
    noise: Noise
    name: str
    """Name of the image and of the stream of its random draws."""
    half_width: float = HALF_WIDTH
    """[m] from the middle of a volume to its sides."""
    completer: Completer | None = None
    """The network that completes what no pixel shows; None leaves it free where no point of a column was observed."""

    @property
    def view(self) -> View:
        """The depth image."""
        return self.image.view

    @cached_property
    def mask(self) -> np.ndarray:
        """(H, W) bool: the pixels of the kits."""
        return self.image.labels == ASSEMBLY_LABEL

    @cached_property
    def plates(self) -> list[Plane]:
        """The planes of all observed plates, the largest first."""
        points, normals, area = oriented_points(self.view, self.mask, self.noise.window)
        return find_planes(points, normals, area, self.noise, stream(0, "plates", self.name))

    def volume(self, middle: np.ndarray, voxel: float) -> Volume:
        """Signed distances to the kits around a point: solid below what was observed, along the nearest plate's normal.

        A cavity is what its part sweeps along that normal, so its walls run along it. Where no point of its floor was
        observed it has no floor, unless the network completes it.

        Args:
            middle: (3,) [m] world.
            voxel: [m] edge.

        Returns:
            A volume about the middle, its z axis the normal, of `half_width` and HALF_HEIGHT; no voxel is unknown.
        """
        columns, heights = self.columns(middle, voxel), self.height_map(middle)
        return columns.filled(largest_only=False, more=None if heights is None else heights.filled(columns.fine))

    def height_map(self, middle: np.ndarray) -> CompletedHeights | None:
        """The heights of the plate nearest to a point (3,) [m] of the world, about its foot; None without network."""
        plate = self._nearest(middle)
        if self.completer is None or plate is None:
            return None
        return self.completer(seen_heights(self._cropped_about(middle), plate, middle, self.noise))

    def columns(self, middle: np.ndarray, voxel: float) -> ObservedColumns:
        """What the image shows around a point, for `volume`."""
        nearest = self._nearest(middle) or UPRIGHT
        along = Pose(plane_frame(nearest, middle).wxyz, middle)
        near = self._cropped_about(middle)
        mask = near.labels == ASSEMBLY_LABEL
        points, half_sizes = subpixel_points(near.view, mask), (self.half_width, HALF_HEIGHT)
        return ObservedColumns.of([MaskedView(near.view, mask)], points, along, half_sizes, -HALF_HEIGHT, voxel)

    def _nearest(self, middle: np.ndarray) -> Plane | None:
        """The plate nearest to a point (3,) [m]."""
        return min(self.plates, key=lambda plate: float(np.linalg.norm(plate.point - middle)), default=None)

    def _cropped_about(self, middle: np.ndarray) -> LabelledDepth:
        """The image, cropped to what shows the volume around a point."""
        camera, (height, width) = self.view.camera, self.view.depth.shape
        point = self.view.world_from_camera.inverse().apply(middle)
        u, v = np.rint(camera.project(point)).astype(int)
        radius = np.hypot(np.sqrt(2) * self.half_width, HALF_HEIGHT)
        reach = int(np.ceil(radius * camera.fx / max(point[2] - self.half_width, self.half_width)))
        rows, columns = (
            slice(*np.clip((i - reach, i + reach), (0, 1), (n - 1, n)).tolist()) for i, n in ((v, height), (u, width))
        )
        return cropped(self.image, (rows, columns))
