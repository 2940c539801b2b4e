"""Where the method's volumes come from: the true meshes, or one depth image with its masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from baselines.completion import SeenPart
from baselines.completion.part import REACH
from baselines.completion.pixels import IDEAL, SENSOR, Noise, noise_of, oriented_points
from kit1000.compiled import compiled
from kit1000.mesh import Mesh
from kit1000.pose import Pose
from kit1000.values import FIRST_PART_LABEL, LabelledDepth, Query, View
from kit1000.voxels import Grid, Volume, signed_distance, surface_points, tsdf

VOXEL = 1e-3  # [m] of the part's volume
SIDE = 2 * round(REACH / VOXEL)  # voxels
COARSE = 2e-3  # [m] voxels among which planes are looked for
EDGE = 5e-3  # [m] a step in depth that is no noise
GAP = 20  # pixels


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
        return self._noise.near

    @property
    def flat(self) -> float:
        """[rad] noise of faces."""
        return self._noise.flat

    @property
    def _noise(self) -> Noise:
        return noise_of(self.query.sensor)

    @cached_property
    def view(self) -> View:
        """The image; one that is noisy is smoothed in the part and in the kits, gaps closed, not across edges."""
        view = self.query.view
        if self._noise is IDEAL:
            return view
        depth = view.depth.copy()
        for mask in (self.query.part_mask, self.query.kit_region):
            _close_gaps(depth, mask)
            _smooth(depth, mask & (depth > 0))
        return View(view.camera, view.world_from_camera, depth)

    def part(self) -> Volume:
        """What was seen of the part, and under it all that nobody saw to be free, down to the table."""
        return self._part.volume(VOXEL)

    def oriented_points(self, box: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, float]:
        """Points of the image on the kits, with normals from their neighbours."""
        points, normals, area = oriented_points(self.view, self.query.kit_region, self._noise.smooth)
        inside = np.ones(len(points), bool) if box is None else ((points >= box[0]) & (points <= box[1])).all(1)
        return points[inside], normals[inside], area

    def plate(self, grid: Grid) -> Volume:
        """What the image says of the kits."""
        return tsdf(grid, self.view, self.query.kit_region, threads=1)

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: of what was seen of the part."""
        return self._part.middle

    @cached_property
    def _part(self) -> SeenPart:
        look = LabelledDepth(self.view, self.query.image.labels)
        return SeenPart(look, FIRST_PART_LABEL + self.query.part, self.query.pivot)


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
    """Replace the depths (H, W) [m] of a mask by means over its pixels around that are as far away within EDGE."""
    v, u = np.nonzero(mask)
    if len(v) == 0:
        return
    reach = SENSOR.smooth // 2
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
