"""First places of a known shape: its heights are compared with those of the image, seen from straight above.

Every face down, every yaw and every cell of the table is compared at once, by Fourier transforms. With H the measured
heights (0 for cells without a return), T those of the shape and W the weight of a cell, the score of a place is

    sum of W (2 H T - H^2)  /  sum of W T^2

1 if H equals T; cells beside the shape count by their height, which T does not explain; hidden cells count nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.fft import irfft2, rfft2
from scipy.fft import next_fast_len
from scipy.ndimage import binary_dilation, grey_dilation, maximum_filter

from kit1000.camera import Camera
from kit1000.known_shapes.disparity import DisparityImage
from kit1000.known_shapes.shapes import KnownShape, StandingShape, apart, table_frame
from kit1000.pose import Pose
from kit1000.sim.render import render

CELL = 4e-3  # [m]
FLAT, HIGH, TALLEST = 2.5e-3, 6e-3, 0.25  # [m] heights of the table, of bodies at least and at most
AROUND = 0.06  # [m] about all that is high
MOST_CELLS = 300  # along a side of the table
RIM, BESIDE = 0.4, 0.7  # weights of a cell that an extended edge may cover, and of cells beside the shape
BESIDE_CELLS = 2
ABOVE = 4e-3  # [m] over the top of a shape, from which on measured heights are cut off
CAPS = np.array([12e-3, 18e-3, 26e-3, 36e-3, 50e-3, 70e-3, TALLEST])
CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)
MARGIN = 40  # cells beyond the grid, so that a shape at one border does not reach the other
PEAKS = 40  # highest cells of a score among which local maxima count
SAME_SPOT, SAME_YAW = 10e-3, 0.35  # [m], [rad] within which two places of one face are one
SPOT = 15e-3  # [m] within which places belong to one spot
FAR_CAMERA = 20.0  # [m] over the table: rays are nearly parallel


class Place(NamedTuple):
    """A place that a search proposes."""

    score: float
    shape: StandingShape


class _Template(NamedTuple):
    level: Pose
    yaw: float
    heights: np.ndarray  # (a, b) [m], the origin of the shape in the middle cell


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
        low = points[:, 2] < TALLEST
        points, found = points[low], found[low]
        high = points[points[:, 2] > HIGH, :2]
        if not len(high):
            return None
        corner = np.percentile(high, 1, axis=0) - AROUND
        count = np.ceil((np.percentile(high, 99, axis=0) + AROUND - corner) / CELL).astype(int).clip(1, MOST_CELLS)
        cells = np.floor((points[:, :2] - corner) / CELL).astype(int)
        inside = ((cells >= 0) & (cells < count)).all(1)
        order = np.flatnonzero(inside)[np.argsort(points[inside, 2], kind="stable")]  # the highest is written last
        rows, columns = cells[order].T
        heights, masks, seen = np.zeros(count), np.zeros(count, int), np.zeros(count, bool)
        heights[rows, columns], masks[rows, columns], seen[rows, columns] = points[order, 2], found[order], True
        return HeightGrid(corner, np.where(heights < FLAT, 0.0, heights), seen, masks, table)

    def without(self, shapes: Sequence[StandingShape]) -> HeightGrid:
        """The grid in which the cells of some shapes are not seen."""
        seen = self.seen.copy()
        for each in shapes:
            seen &= ~self.footprint(each)
        return HeightGrid(self.corner, np.where(seen, self.heights, 0.0), seen, self.labels, self.table)

    def of_mask(self, label: int, margin: int) -> HeightGrid | None:
        """The part of the grid about a mask, in which other masks are not seen; None if the mask has no cell."""
        cells = np.argwhere(self.labels == label)
        if not len(cells):
            return None
        first = np.maximum(cells.min(0) - margin, 0)
        window = tuple(slice(a, b) for a, b in zip(first, cells.max(0) + margin + 1, strict=True))
        seen = self.seen[window] & np.isin(self.labels[window], (0, label))
        heights = np.where(seen, self.heights[window], 0.0)
        return HeightGrid(self.corner + first * CELL, heights, seen, self.labels[window], self.table)

    def footprint(self, standing: StandingShape) -> np.ndarray:
        """(a, b) bool: the cells that a shape covers."""
        heights = _heights_from_above(standing.shape, standing.level, float(standing.place[2]))
        found = np.zeros(self.seen.shape, bool)
        cells = np.argwhere(heights > 0) - np.array(heights.shape) // 2
        cells += np.round((standing.place[:2] - self.corner) / CELL - 0.5).astype(int)
        cells = cells[((cells >= 0) & (cells < self.seen.shape)).all(1)]
        found[tuple(cells.T)] = True
        return found

    @cached_property
    def _size(self) -> tuple[int, int]:
        rows, columns = (next_fast_len(count + 2 * MARGIN, real=True) for count in self.seen.shape)
        return int(rows or 0), int(columns or 0)

    @cached_property
    def _transforms(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """For each of CAPS the transforms of the heights, cut off there, and of their squares."""
        cut = (np.minimum(self.heights, cap) for cap in CAPS)
        return [(rfft2(heights, self._size), rfft2(heights**2, self._size)) for heights in cut]

    def _scores(self, heights: np.ndarray) -> np.ndarray:
        """(a, b) the score of a shape whose middle is at each cell. heights: (c, d) [m] of a template."""
        size, index = self._size, int(np.searchsorted(CAPS[:-1], heights.max() + ABOVE))
        seen, squares = self._transforms[index]
        wide = grey_dilation(heights, footprint=CROSS)
        weight = np.where(heights > 0, 1.0, np.where(wide > 0, RIM, 0.0))
        weight[(weight == 0) & binary_dilation(wide > 0, iterations=BESIDE_CELLS)] = BESIDE
        found = irfft2(2 * seen * np.conj(rfft2(weight * wide, size)) - squares * np.conj(rfft2(weight, size)), size)
        found = np.roll(found, np.array(heights.shape) // 2, (0, 1)) / (weight * wide * wide).sum()
        return found[: self.seen.shape[0], : self.seen.shape[1]]

    def places(self, shape: KnownShape, templates: Sequence[_Template], most: int, most_a_spot: int) -> list[Place]:
        """The best places of a shape, the best first, with a limit for all and for each spot."""
        found = []
        for level, yaw, heights in templates:
            if (np.array(heights.shape) > self._size).any():
                continue
            scores = self._scores(heights)
            for row, column in _peaks(scores):
                x, y = self.corner + CELL * (np.array([row, column]) + 0.5)
                place = StandingShape(shape, level, np.array([x, y, yaw]), self.table)
                found.append(Place(float(scores[row, column]), place))
        found.sort(key=lambda place: -place.score)
        kept: list[Place] = []
        for place in found:
            at_spot = [each.shape for each in kept if apart(each.shape, place.shape) < SPOT]
            if place.score <= 0 or len(kept) == most:
                break
            if len(at_spot) < most_a_spot and not any(_same(each, place.shape) for each in at_spot):
                kept.append(place)
        return kept


def _peaks(scores: np.ndarray) -> Iterator[tuple[int, int]]:
    """The local maxima among the highest cells."""
    many = min(PEAKS, scores.size)
    highest = np.argpartition(scores.ravel(), -many)[-many:]
    rows, columns = np.unravel_index(highest, scores.shape)
    top = maximum_filter(scores, 5)[rows, columns] == scores[rows, columns]
    yield from zip(rows[top].tolist(), columns[top].tolist(), strict=True)


def _same(a: StandingShape, b: StandingShape) -> bool:
    turn = abs((a.place[2] - b.place[2] + np.pi) % (2 * np.pi) - np.pi)
    return a.level is b.level and turn < SAME_YAW and apart(a, b) < SAME_SPOT


def templates(shape: KnownShape, yaws: int) -> list[_Template]:
    """The heights of a shape with each face down at each of some yaws."""
    angles = np.arange(yaws) * (2 * np.pi / yaws)
    return [_Template(level, yaw, _heights_from_above(shape, level, yaw)) for level in shape.levels for yaw in angles]


def _heights_from_above(shape: KnownShape, level: Pose, yaw: float) -> np.ndarray:
    """(a, b) [m] top heights of a shape on cells along x and y, with a margin; 0 where it is not."""
    pose = Pose.from_rotvec((0.0, 0.0, yaw)) @ level
    reach = np.abs(pose.apply(shape.mesh.vertices)[:, :2]).max(0)
    rows, columns = (2 * np.ceil(reach / CELL).astype(int) + 5 + 2 * BESIDE_CELLS).tolist()
    focal = FAR_CAMERA / CELL
    camera = Camera(columns, rows, focal, focal, (columns - 1) / 2, (rows - 1) / 2)
    down = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # rows along x, columns along y
    eye = Pose.from_rotation_matrix(down, np.array([0.0, 0.0, FAR_CAMERA]))
    depth = render(camera, eye, [(shape.mesh, pose)], threads=1).depth.astype(float)
    return np.where(depth > 0, FAR_CAMERA - depth, 0.0)
