"""Where the method's volumes come from: the true meshes, or one depth image with its masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.ndimage import distance_transform_edt, label, uniform_filter

from kit1000.compiled import compiled
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.values import Query, View
from kit1000.voxels import Grid, Volume, signed_distance, surface_points, tsdf
from kit1000.voxels.grid import TRUNCATION

VOXEL = 1e-3  # [m] of the part's volume
SIDE = 84  # voxels: no part of 50 mm reaches beyond, however it lies
COARSE = 2e-3  # [m] voxels among which planes are looked for
SMOOTH = 7  # pixels over which a noisy image is averaged
EDGE = 5e-3  # [m] a step in depth that is no noise
AROUND = 0.06  # [m] the table is looked at so far around a part
FLYING = 0.02  # share of the points of a part that may float far from it
GAP = 20  # pixels
SPREAD = 4  # places across a pixel
STRIDE = 2  # every second pixel of rows and columns names planes


class Source(Protocol):
    """What the method asks of a scene."""

    @property
    def near(self) -> float:
        """[m] how far points of a plane may lie from it."""
        ...

    @property
    def flat(self) -> float:
        """[rad] how far facets of one face may lean from it."""
        ...

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: about the middle of the part."""
        ...

    def part(self) -> Volume:
        """The part as it lies now."""
        ...

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Points on the kits, (n, 3) [m], normals (n, 3), and the area [m^2] of a point, in a box (2, 3) or all."""
        ...

    def plate(self, grid: Grid) -> Volume:
        """The kits on a grid."""
        ...


@dataclass(frozen=True, eq=False)
class TrueSource:
    """Exact volumes from meshes that stand where they truly do."""

    part_body: tuple[Mesh, Pose]
    kit_bodies: Sequence[tuple[Mesh, Pose]]
    near: float = 0.5e-3
    flat: float = float(np.radians(1.5))

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: of the part's extents; what a noisy image shows of them may be off by centimetres."""
        mesh, world_from_part = self.part_body
        corners = world_from_part.apply(mesh.vertices)
        return (corners.min(0) + corners.max(0)) / 2

    def part(self) -> Volume:
        """The part, exact."""
        return signed_distance(_around(self.middle), [self.part_body], threads=1)

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Zero crossings of a coarse volume, with its slopes."""
        if box is None:
            corners = np.concatenate([pose.apply(mesh.vertices) for mesh, pose in self.kit_bodies])
            box = np.stack([corners.min(0), corners.max(0)])
        shape = np.ceil((box[1] - box[0]) / COARSE).astype(int) + 4
        grid = Grid.centred(Pose.from_translation(box.mean(0)), tuple(shape.tolist()), COARSE)
        volume = signed_distance(grid, self.kit_bodies, threads=1)
        points = surface_points(volume)
        return points, _slopes(volume, points), COARSE**2 * 2 / 3  # crossings along three axes: 1.5 a cell on average

    def plate(self, grid: Grid) -> Volume:
        """The kits, exact."""
        return signed_distance(grid, self.kit_bodies, threads=1)


@dataclass(frozen=True, eq=False)
class DepthSource:
    """What one depth image says, with the masks of the part and of the kits."""

    query: Query

    @property
    def near(self) -> float:
        """[m] noise of the image."""
        return 2e-3 if self._noisy else 0.5e-3

    @property
    def flat(self) -> float:
        """[rad] noise of faces."""
        return float(np.radians(8 if self._noisy else 4))

    @property
    def _noisy(self) -> bool:
        return self.query.sensor != "ideal"

    @cached_property
    def view(self) -> View:
        """The image; one that is noisy is smoothed in the part and in the kits, gaps closed, not across edges."""
        view = self.query.view
        if not self._noisy:
            return view
        depth = view.depth.copy()
        for mask in (self.query.part_mask, self.query.kit_region):
            _close_gaps(depth, mask)
            _smooth(depth, mask & (depth > 0))
        return View(view.camera, view.world_from_camera, depth)

    def part(self) -> Volume:
        """What was seen of the part, and under it all that nobody saw to be free, down to the table."""
        fine = Grid.centred(Pose.from_translation(self.middle), (2 * SIDE, 2 * SIDE, 2 * SIDE), VOXEL / 2)
        seen = tsdf(fine, self.view, self.query.part_mask, threads=1).values[..., ::2]
        top = _top(fine, self._points)
        heights = fine.world(np.arange(0, 2 * SIDE, 2)[:, None] * [0, 0, 1])[:, 2]
        solid = _largest((heights <= top[..., None]) & (heights > self.table_height()) & ~(seen > 0))
        return Volume.adopt(Grid((SIDE, SIDE, SIDE), VOXEL, fine.world_from_grid), _distances(solid, seen)[::2, ::2])

    def table_height(self) -> float:
        """[m] of the table around the part, as this image has it: a sensor's scale and pose are a little off."""
        view, labels = self.view, self.query.seen.labels
        camera = view.world_from_camera.inverse().apply(self.query.pivot)
        u, v = np.rint(view.camera.project(camera)).astype(int)
        reach = round(AROUND * view.camera.fx / camera[2])
        box = np.s_[max(v - reach, 0) : v + reach, max(u - reach, 0) : u + reach]
        rows, columns = np.nonzero((labels[box] == 0) & (view.depth[box] > 0))
        if len(rows) == 0:
            return 0.0
        rows, columns = rows + box[0].start, columns + box[1].start
        points = view.camera.unproject_pixels(np.stack([columns, rows], -1), view.depth[rows, columns])
        return float(np.median(view.world_from_camera.apply(points)[:, 2]))

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Points of the image on the kits, with normals from their neighbours."""
        view = self.view
        mask = self.query.kit_region & (view.depth > 0)
        v, u = np.nonzero(mask)
        if len(v) == 0:
            return np.empty((0, 3)), np.empty((0, 3)), 0.0
        low, high = (v.min(), u.min()), (v.max() + 1, u.max() + 1)
        crop = np.s_[low[0] : high[0], low[1] : high[1]]
        v, u = np.mgrid[crop]
        cloud = view.camera.unproject_pixels(np.stack([u, v], -1), view.depth[crop])
        wide = SMOOTH if self._noisy else 3
        share = uniform_filter(mask[crop].astype(float), wide)
        smooth = np.stack([uniform_filter(cloud[..., k] * mask[crop], wide) for k in range(3)], -1)
        smooth /= np.maximum(share, 1e-9)[..., None]
        normals = np.cross(np.gradient(smooth, axis=0), np.gradient(smooth, axis=1))
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
        good = mask[crop] & (share > 0.999)
        good[::STRIDE] = False
        good[:, ::STRIDE] = False
        sight = cloud / np.maximum(np.linalg.norm(cloud, axis=-1, keepdims=True), 1e-9)
        cosine = np.einsum("ijk,ijk->ij", normals, sight)
        normals = np.where(cosine[..., None] > 0, -normals, normals)
        area = cloud[..., 2] ** 2 / (view.camera.fx * view.camera.fy) / np.maximum(np.abs(cosine), 0.2)
        points = view.world_from_camera.apply(cloud[good])
        turned = view.world_from_camera.rotate(normals[good])
        inside = np.ones(len(points), bool) if box is None else ((points >= box[0]) & (points <= box[1])).all(1)
        return points[inside], turned[inside], float(np.median(area[good])) * STRIDE**2

    def plate(self, grid: Grid) -> Volume:
        """What the image says of the kits."""
        return tsdf(grid, self.view, self.query.kit_region, threads=1)

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: see `_between`."""
        return self._between

    @cached_property
    def _between(self) -> np.ndarray:
        """(3,) [m] world: between the extents of what was seen of the part, but for the outermost FLYING of it.

        The pivot lies between the extents of all its points, also of those that float in front of it or behind.
        """
        if len(self._points) == 0:
            return self.query.pivot
        low, high = np.percentile(self._points, [100 * FLYING, 100 * (1 - FLYING)], axis=0)
        return (low + high) / 2

    @cached_property
    def _points(self) -> np.ndarray:
        """(n, 3) [m] world: places spread evenly over the pixels of the part, on the plane that each pixel saw.

        The mask holds the pixels whose centres the part covers: on average it ends half a pixel beyond the last.
        """
        view = self.view
        mask = self.query.part_mask & (view.depth > 0)
        v, u = np.nonzero(mask)
        across, down = (_slope(view.depth, mask, axis)[v, u] for axis in (1, 0))
        steps = (np.arange(SPREAD) + 0.5) / SPREAD - 0.5
        a, b = (grid.ravel() for grid in np.meshgrid(steps, steps))
        pixels = np.stack([u[:, None] + a, v[:, None] + b], axis=-1)
        depth = view.depth[v, u][:, None] + across[:, None] * a + down[:, None] * b
        points = view.camera.unproject_pixels(pixels.reshape(-1, 2), depth.ravel())
        return view.world_from_camera.apply(points)


def _close_gaps(depth: np.ndarray, mask: np.ndarray) -> None:
    """Give pixels of a mask without return, in gaps of at most GAP along a row, the farther depth of the two sides.

    Such gaps are shadows of the sensor's projector or of its second eye: what they hide belongs to what is farther.
    """
    v, u = np.nonzero(mask)
    if len(v) == 0:
        return
    box = np.s_[v.min() : v.max() + 1, u.min() : u.max() + 1]
    here, inside = depth[box], mask[box]
    known = inside & (here > 0)
    columns = np.arange(here.shape[1])
    left = np.maximum.accumulate(np.where(known, columns, -GAP - 1), axis=1)
    right = np.minimum.accumulate(np.where(known, columns, len(columns) + GAP)[:, ::-1], axis=1)[:, ::-1]
    sides = [np.where(np.abs(side - columns) <= GAP, side, -1) for side in (left, right)]
    rows = np.arange(here.shape[0])[:, None]
    farther = np.maximum(*(np.where(side >= 0, here[rows, side], 0) for side in sides))
    here[inside & ~known] = farther[inside & ~known]


def _smooth(depth: np.ndarray, mask: np.ndarray) -> None:
    """Replace the depths (H, W) [m] of a mask by means over SMOOTH x SMOOTH of its pixels, as far away within EDGE."""
    v, u = np.nonzero(mask)
    if len(v) == 0:
        return
    reach = SMOOTH // 2
    box = np.s_[max(v.min() - reach, 0) : v.max() + reach + 1, max(u.min() - reach, 0) : u.max() + reach + 1]
    smoothed = np.empty_like(depth[box])
    _means(depth[box], mask[box], reach, EDGE, smoothed)
    depth[box] = smoothed


@compiled
def _means(depth, inside, reach, edge, smoothed):
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            smoothed[v, u] = depth[v, u]
            if not inside[v, u]:
                continue
            total, count = 0.0, 0
            for y in range(max(v - reach, 0), min(v + reach + 1, height)):
                for x in range(max(u - reach, 0), min(u + reach + 1, width)):
                    if inside[y, x] and abs(depth[y, x] - depth[v, u]) < edge:
                        total += depth[y, x]
                        count += 1
            smoothed[v, u] = total / count


def _slope(depth: np.ndarray, mask: np.ndarray, axis: int) -> np.ndarray:
    """(H, W) [m a pixel]: how the depth goes on across each pixel, by the nearer of its two neighbours in the mask."""
    ahead = np.roll(depth, -1, axis) - depth
    behind = depth - np.roll(depth, 1, axis)
    ahead = np.where(np.roll(mask, -1, axis), ahead, np.inf)
    behind = np.where(np.roll(mask, 1, axis), behind, np.inf)
    nearer = np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
    return np.where(np.isfinite(nearer), nearer, 0.0)


def _around(pivot: np.ndarray) -> Grid:
    return Grid.centred(Pose.from_translation(pivot), (SIDE, SIDE, SIDE), VOXEL)


def _slopes(volume: Volume, points: np.ndarray) -> np.ndarray:
    """(n, 3) unit: the direction in which the distance grows, at the voxels nearest to points (n, 3) [m]."""
    limit = np.array(volume.grid.shape) - 2
    i, j, k = np.clip(np.rint(volume.grid.indices(points)).astype(int), 1, limit).T
    v = volume.values
    slopes = np.stack(
        [
            v[i + 1, j, k] - v[i - 1, j, k],
            v[i, j + 1, k] - v[i, j - 1, k],
            v[i, j, k + 1] - v[i, j, k - 1],
        ],
        axis=-1,
    )
    return slopes / np.maximum(np.linalg.norm(slopes, axis=1, keepdims=True), 1e-12)


def _top(grid: Grid, points: np.ndarray) -> np.ndarray:
    """(nx, ny) [m]: the highest point seen of each column of the world; below the table where none was."""
    i, j = np.rint(grid.indices(points)[:, :2]).astype(int).T
    inside = (i >= 0) & (j >= 0) & (i < grid.shape[0]) & (j < grid.shape[1])
    top = np.full(grid.shape[:2], -1.0)
    np.maximum.at(top, (i[inside], j[inside]), points[inside, 2])
    return top


def _largest(solid: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) bool: the largest piece of a solid; the others are points that float."""
    names, count = label(solid)  # type: ignore[misc]
    return solid if count < 2 else names == 1 + np.bincount(names[solid])[1:].argmax()


def _distances(solid: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(nx, ny, nz) float32: distance / truncation to the surface of a solid; nearer where a surface was seen nearer.

    Cells are VOXEL / 2 wide and VOXEL high.
    """
    values = np.ones(solid.shape, np.float32)
    held = np.nonzero(solid)
    if len(held[0]) == 0:
        return values
    margins = (2 * int(TRUNCATION) + 1, 2 * int(TRUNCATION) + 1, int(TRUNCATION) + 1)
    box = tuple(slice(max(i.min() - m, 0), i.max() + m + 1) for i, m in zip(held, margins, strict=True))
    solid, seen = solid[box], seen[box]
    outside, inside = (np.asarray(distance_transform_edt(place, (0.5, 0.5, 1.0))) for place in (~solid, solid))
    away = np.maximum(np.where(solid, inside, outside) - 0.25, 0) / TRUNCATION
    away = np.fmin(away, np.abs(seen) / 2)  # of half a voxel, so is its truncation
    values[box] = np.where(solid, -away, away).clip(-1, 1)
    return values
