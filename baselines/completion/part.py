"""A part as one depth image shows it: solid down to the table, but for what was seen to be free."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from baselines.completion.columns import extruded
from baselines.completion.pixels import spread_points
from kit1000.pose import Pose
from kit1000.values import LabelledDepth
from kit1000.voxels import Volume

REACH = 0.042  # [m] from the middle of a part of 50 mm, however it lies
AROUND = 0.06  # [m] the table is looked at so far around a part
FLYING = 0.02  # share of the points of a part that may float far from it


@dataclass(frozen=True, eq=False)
class SeenPart:
    """A part in an image that may be a window of a larger one, AROUND wider than the part on every side."""

    look: LabelledDepth
    label: int
    """Of the part, in the masks."""
    pivot: np.ndarray
    """(3,) [m] world: about where the part lies."""

    def volume(self, voxel: float) -> Volume:
        """Signed distances to what was seen of the part, with all under it that nobody saw to be free, to the table.

        Args:
            voxel: [m] edge.

        Returns:
            A volume that stands upright about the middle, REACH to every side; nowhere unknown.
        """
        upright = Pose.from_translation(self.middle)
        floor = self.table_height() - self.middle[2]
        return extruded(self.look.view, self._mask, self._points, upright, (REACH, REACH), floor, voxel, one=True)

    def table_height(self) -> float:
        """[m] of the table around the part, as this image has it: a sensor's scale and pose are a little off."""
        view, labels = self.look.view, self.look.labels
        camera = view.world_from_camera.inverse().apply(self.pivot)
        u, v = np.rint(view.camera.project(camera)).astype(int)
        reach = round(AROUND * view.camera.fx / camera[2])
        box = np.s_[max(v - reach, 0) : v + reach, max(u - reach, 0) : u + reach]
        rows, columns = np.nonzero((labels[box] == 0) & (view.depth[box] > 0))
        if len(rows) == 0:
            return 0.0
        rows, columns = rows + box[0].start, columns + box[1].start
        points = view.camera.unproject_pixels(np.stack([columns, rows], -1), view.depth[rows, columns])
        return float(np.median(view.world_from_camera.apply(points)[:, 2]))

    @cached_property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: between the extents of what was seen of the part, but for the outermost FLYING of it.

        The pivot lies between the extents of all its points, also of those that float in front of it or behind.
        """
        if len(self._points) == 0:
            return self.pivot
        low, high = np.percentile(self._points, [100 * FLYING, 100 * (1 - FLYING)], axis=0)
        return (low + high) / 2

    @cached_property
    def _mask(self) -> np.ndarray:
        return self.look.labels == self.label

    @cached_property
    def _points(self) -> np.ndarray:
        return spread_points(self.look.view, self._mask)
