"""First places of a known shape: its heights are compared with those of the image, seen from straight above.

Every face down, every yaw and every cell of the table is compared at once, by Fourier transforms. With H the measured
heights (0 for cells without a return), T those of the shape and W the weight of a cell, the score of a place is

    sum of W (2 H T - H^2)  /  sum of W T^2

1 if H equals T; cells beside the shape count by their height, which T does not explain; hidden cells count nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.ndimage import binary_dilation, grey_dilation, maximum_filter

from kit1000.camera import Camera
from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.shapes import UP, KnownShape, StandingShape, apart, table_frame
from kit1000.pose import Pose
from kit1000.sim.render import inverse_depths

CELL = 4e-3  # [m]
FLAT, HIGH, TALLEST = 2.5e-3, 6e-3, 0.25  # [m] heights of the table, of bodies at least and at most
AROUND, STRAY = 0.06, 0.2  # [m] about all that is high, but for [%] of it on every side
MOST_CELLS = 300  # along a side of the table
LEAST_TOTAL = 1e-9  # [m^2] of a view: a shape may miss the middles of all cells
RIM, BESIDE = 0.4, 0.7  # weights of a cell that an extended edge may cover, and of cells beside the shape
BESIDE_CELLS = 2
ABOVE = 4e-3  # [m] over the top of a shape, from which on measured heights are cut off
CAPS = np.array([12e-3, 18e-3, 26e-3, 36e-3, 50e-3, 70e-3, TALLEST])
CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)
AROUND_CELLS = 8  # about a mask or a shape, in which a part is searched
SAME_SPOT, SAME_YAW = 10e-3, 0.35  # [m], [rad] within which two places of one face are one
SAME_SCORE = 0.02  # [px] by which those of two equal images may differ
SPOT = 15e-3  # [m] within which places belong to one spot
FAR_CAMERA = 20.0  # [m] over the table: rays are nearly parallel


class Place(NamedTuple):
    """A place that a search proposes."""

    score: float
    shape: StandingShape


class Views(NamedTuple):
    """A shape that stands on one of its faces, seen from above at several yaws."""

    level: Pose
    yaws: np.ndarray
    """(k,) [rad]."""
    heights: np.ndarray
    """(k, a, b) [m] on cells along x and y, the origin of the shape in the middle cell; 0 where it is not."""


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """The heights of an image over its table, on cells of it seen from above."""

    corner: np.ndarray
    """(2,) [m] of the first cell."""
    heights: np.ndarray
    """(a, b) [m] the highest point of each cell."""
    seen: np.ndarray
    """(a, b) bool: cells with a return."""
    labels: np.ndarray
    """(a, b) the mask of that point."""
    table: Pose
    """camera_from_table."""

    @staticmethod
    def of(image: DisparityImage, labels: np.ndarray) -> HeightGrid | None:
        """The heights of an image with masks (H, W); None if nothing is high."""
        table, (v, u) = table_frame(image.support), np.nonzero(image.measured > 0)
        points = image.camera.unproject_pixels(np.stack([u, v], -1).astype(float), image.gain / image.measured[v, u])
        points, found = table.inverse().apply(points), labels[v, u]
        kept = points[:, 2] < TALLEST
        points, found = points[kept], found[kept]
        high = points[points[:, 2] > HIGH, :2]
        if not len(high):
            return None
        low, far = np.percentile(high, STRAY, axis=0), np.percentile(high, 100 - STRAY, axis=0)
        corner = low - AROUND
        count = np.ceil((far + AROUND - corner) / CELL).astype(int).clip(1, MOST_CELLS)
        cells = np.floor((points[:, :2] - corner) / CELL).astype(int)
        inside = ((cells >= 0) & (cells < count)).all(1)
        points, found = points[inside], found[inside]
        flat = cells[inside] @ np.array([count[1], 1])  # row by row
        heights, masks = np.full(count, -np.inf), np.zeros(count, int)
        np.maximum.at(heights.ravel(), flat, points[:, 2])
        highest = points[:, 2] == heights.ravel()[flat]
        masks.ravel()[flat[highest]] = found[highest]
        return HeightGrid(corner, np.where(heights < FLAT, 0.0, heights), np.isfinite(heights), masks, table)

    def without(self, shapes: Sequence[StandingShape]) -> HeightGrid:
        """The grid in which the cells of some shapes are not seen."""
        seen = self.seen.copy()
        for each in shapes:
            seen &= ~self.footprint(each)
        return replace(self, heights=np.where(seen, self.heights, 0.0), seen=seen)

    def of_mask(self, label: int) -> HeightGrid | None:
        """The part of the grid about a mask, in which other masks are not seen; None if the mask has no cell."""
        seen = self.seen & np.isin(self.labels, (0, label))
        alone = replace(self, heights=np.where(seen, self.heights, 0.0), seen=seen)
        return alone.about(self.labels == label)

    def about(self, cells: np.ndarray) -> HeightGrid | None:
        """The part of the grid about some cells (a, b) bool; None if there are none."""
        indices = np.argwhere(cells)
        if not len(indices):
            return None
        first = np.maximum(indices.min(0) - AROUND_CELLS, 0)
        window = tuple(slice(a, b) for a, b in zip(first, indices.max(0) + AROUND_CELLS + 1, strict=True))
        corner = self.corner + first * CELL
        return HeightGrid(corner, self.heights[window], self.seen[window], self.labels[window], self.table)

    def footprint(self, standing: StandingShape) -> np.ndarray:
        """(a, b) bool: the cells that a shape covers."""
        heights = _from_above(standing.shape, standing.level, standing.place[2:])[0]
        found = np.zeros(self.seen.shape, bool)
        cells = np.argwhere(heights > 0) - np.array(heights.shape) // 2
        cells += np.round((standing.place[:2] - self.corner) / CELL - 0.5).astype(int)
        cells = cells[((cells >= 0) & (cells < self.seen.shape)).all(1)]
        found[tuple(cells.T)] = True
        return found

    def _scores(self, heights: np.ndarray) -> np.ndarray:
        """(k, a, b) the score of a shape whose middle is at each cell. heights: (k, c, d) [m] seen from above."""
        needed = np.array(self.seen.shape) + np.array(heights.shape[1:]) // 2 + 1
        size = tuple(int(fft.next_fast_len(count, real=True) or 0) for count in needed.tolist())
        seen, squares = _transforms(self, size, int(np.searchsorted(CAPS[:-1], heights.max() + ABOVE)))
        wide = grey_dilation(heights, footprint=CROSS[None])
        weight = np.where(heights > 0, 1.0, np.where(wide > 0, RIM, 0.0)).astype(np.float32)
        weight[(weight == 0) & binary_dilation(wide > 0, CROSS[None], iterations=BESIDE_CELLS)] = BESIDE
        found = 2 * seen * np.conj(_transform(weight * wide, size)) - squares * np.conj(_transform(weight, size))
        found = np.roll(np.asarray(fft.irfft2(found, size)), np.array(heights.shape[1:]) // 2, (1, 2))
        total = (weight * wide * wide).sum((1, 2))
        return found[:, : self.seen.shape[0], : self.seen.shape[1]] / np.maximum(total, LEAST_TOTAL)[:, None, None]

    def places(self, shape: KnownShape, views: Sequence[Views], most: int, a_spot: int, a_view: int) -> list[Place]:
        """The best places of a shape, the best first, with a limit for all, for each spot and for each view."""
        found = []
        for k, (_, yaws, heights) in enumerate(views):
            scores = self._scores(heights)
            yaw, row, column = np.nonzero((scores > 0) & (scores == maximum_filter(scores, (1, 5, 5))))
            score = scores[yaw, row, column]
            order = np.lexsort((-score, yaw))
            kept = order[np.arange(len(order)) - np.searchsorted(yaw, yaw) < a_view]  # nonzero gives yaws in order
            xy = self.corner + CELL * (np.stack([row, column], -1)[kept] + 0.5)
            found.append(np.column_stack([score[kept], np.full(len(kept), k), xy, yaws[yaw[kept]]]))
        every = np.concatenate(found)
        best = _limited(every[np.argsort(-every[:, 0], kind="stable")], most, a_spot)
        return [Place(row[0], StandingShape(shape, views[int(row[1])].level, row[2:], self.table)) for row in best]


@lru_cache(maxsize=16)
def _transforms(grid: HeightGrid, size: tuple[int, int], cap: int) -> tuple[np.ndarray, np.ndarray]:
    """The transforms of the heights, cut off at one of CAPS, and of their squares."""
    heights = np.minimum(grid.heights, CAPS[cap]).astype(np.float32)
    return _transform(heights, size), _transform(heights**2, size)


def _transform(heights: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    return np.asarray(fft.rfft2(heights, size))


def _limited(places: np.ndarray, most: int, a_spot: int) -> list[np.ndarray]:
    """The first of rows (n, 5) of score, face, x, y and yaw, with a limit for all and for each spot."""
    kept: list[np.ndarray] = []
    spots, counts = np.empty((0, 2)), np.empty(0, int)
    for row in places:
        if len(kept) == most:
            break
        near = np.flatnonzero(np.hypot(*(spots - row[2:4]).T) < SPOT)
        if not len(near):
            spots, counts = np.vstack([spots, row[2:4]]), np.append(counts, 1)
        elif counts[near[0]] == a_spot:
            continue
        else:
            counts[near[0]] += 1
        kept.append(row)
    return kept


def distinct(places: Sequence[Place], most: int) -> list[Place]:
    """The first of some places that are not the same."""
    kept: list[Place] = []
    for place in places:
        if len(kept) == most:
            break
        if not any(_same(each, place) for each in kept):
            kept.append(place)
    return kept


def _same(a: Place, b: Place) -> bool:
    """Whether near places have one face down at one yaw, or show a symmetric shape alike."""
    if apart(a.shape, b.shape) > SAME_SPOT:
        return False
    rotation = abs((a.shape.place[2] - b.shape.place[2] + np.pi) % (2 * np.pi) - np.pi)
    return (a.shape.level is b.shape.level and rotation < SAME_YAW) or abs(a.score - b.score) < SAME_SCORE


@lru_cache(maxsize=64)
def views_from_above(shape: KnownShape, yaws: int) -> list[Views]:
    """A shape seen from above with each of its faces down, at each of some yaws."""
    angles = np.arange(yaws) * (2 * np.pi / yaws)
    return [Views(level, angles, _from_above(shape, level, angles)) for level in shape.levels]


def _from_above(shape: KnownShape, level: Pose, yaws: np.ndarray) -> np.ndarray:
    """(k, a, a) [m] top heights of a shape at yaws (k,) on cells along x and y, with a margin; 0 where it is not."""
    reach = np.hypot(*level.apply(shape.mesh.vertices)[:, :2].T).max()
    side = int(2 * np.ceil(reach / CELL) + 5 + 2 * BESIDE_CELLS)
    focal = FAR_CAMERA / CELL
    camera = Camera(side, side, focal, focal, (side - 1) / 2, (side - 1) / 2)
    down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # rows along x, columns along y
    eye = Pose.from_rotation_matrix(down, np.array([0.0, 0.0, FAR_CAMERA]))
    rotated = Pose.from_rotvec(yaws[:, None] * UP) @ level
    inverse = np.stack([inverse_depths(camera, shape.mesh, pose) for pose in eye.inverse() @ rotated])
    depth = np.divide(1.0, inverse, out=np.full(inverse.shape, FAR_CAMERA), where=inverse > 0)
    return (FAR_CAMERA - depth).astype(np.float32)
