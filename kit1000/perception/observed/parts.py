"""A part from one depth image, or from several: solid down to the table, except where the image shows free space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from kit1000.perception.observed.columns import MaskedView, ObservedColumns
from kit1000.perception.observed.pixels import subpixel_points
from kit1000.pose import Pose
from kit1000.values import LabelledDepth
from kit1000.voxels import Volume

HALF_WIDTH = 0.042  # [m] least from the middle of a volume to its sides: it holds a part of 50 mm in any orientation
AROUND = 1.5e-3  # [m] around a larger part, to the sides of its volume
TABLE_MARGIN = 0.06  # [m] around a part: the pixels from which the height of the table is read
OUTLIERS = 0.02  # share of a part's points that is cut off at either end of each axis


class PartBounds(NamedTuple):
    """Bounds of a part of which images show some sides: the true part contains `sure` and lies within `possible`."""

    filled: Volume
    """A guess between both: solid below the observed points down to the table, except for free space."""
    sure: Volume
    """Solid just behind the observed surface."""
    possible: Volume
    """All that is not surely free, that is seen free, outside the silhouette, or below the table."""


@dataclass(frozen=True, eq=False)
class ObservedPart:
    """A part in a depth image, which may be cropped to TABLE_MARGIN around the part."""

    image: LabelledDepth
    label: int
    """Label of the part in the masks."""
    pivot: np.ndarray
    """(3,) [m] world: about where the part lies."""
    others: tuple[LabelledDepth, ...] = ()
    """Images of further cameras, with the same labels."""

    def volume(self, voxel: float) -> Volume:
        """Signed distances to the part: solid below its observed points down to the table, except for free space.

        Args:
            voxel: [m] edge.

        Returns:
            A volume along the axes of the world about the middle, `half_width` to every side; no voxel is unknown.
        """
        return self.columns(voxel).filled(largest_only=True)

    def bounds(self, voxel: float) -> PartBounds:
        """The bounds of the part, each on the grid of `volume`."""
        columns = self.columns(voxel)
        return PartBounds(columns.filled(largest_only=True), columns.sure(), columns.possible())

    def columns(self, voxel: float) -> ObservedColumns:
        """What the image shows, in cells of half a voxel [m]."""
        upright = Pose.from_translation(self.middle)
        floor = self.table_height() - self.middle[2]
        half_sizes = (self.half_width, self.half_width)
        return ObservedColumns.of(self._images, self._points, upright, half_sizes, floor, voxel)

    def table_height(self) -> float:
        """[m] of the table around the part in this image: a sensor's scale and pose are a little off."""
        view, labels = self.image.view, self.image.labels
        camera = view.world_from_camera.inverse().apply(self.pivot)
        u, v = np.rint(view.camera.project(camera)).astype(int)
        reach = round(TABLE_MARGIN * view.camera.fx / camera[2])
        box = np.s_[max(v - reach, 0) : v + reach, max(u - reach, 0) : u + reach]
        rows, columns = np.nonzero((labels[box] == 0) & (view.depth[box] > 0))
        if len(rows) == 0:
            return 0.0
        rows, columns = rows + box[0].start, columns + box[1].start
        points = view.camera.unproject_pixels(np.stack([columns, rows], -1), view.depth[rows, columns])
        return float(np.median(view.world_from_camera.apply(points)[:, 2]))

    @cached_property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: the centre of the extents of the part's points, without the OUTLIERS.

        The pivot is the centre of the extents of all its points, also of those that float in front of it or behind.
        """
        if len(self._points) == 0:
            return self.pivot
        low, high = np.percentile(self._points, [100 * OUTLIERS, 100 * (1 - OUTLIERS)], axis=0)
        return (low + high) / 2

    @cached_property
    def half_width(self) -> float:
        """[m] from the middle of a volume to its sides: HALF_WIDTH, unless the part is seen to reach farther."""
        if len(self._points) == 0:
            return HALF_WIDTH
        away = np.sqrt(np.square(self._points - self.middle).sum(-1))
        return max(HALF_WIDTH, float(np.percentile(away, 100 * (1 - OUTLIERS))) + AROUND)

    @cached_property
    def _images(self) -> list[MaskedView]:
        return [MaskedView.of(image, self.label) for image in (self.image, *self.others)]

    @cached_property
    def _points(self) -> np.ndarray:
        return np.concatenate([subpixel_points(image.view, image.mask) for image in self._images])
