"""What several images show of one object: its truncated signed distance where any of them knows it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kit1000.values import LabelledDepth, View
from kit1000.voxels import Grid, Volume, tsdf


class MaskedView(NamedTuple):
    """A depth image and the pixels of an object."""

    view: View
    mask: np.ndarray
    """(H, W) bool"""

    @classmethod
    def of(cls, image: LabelledDepth, label: int) -> MaskedView:
        """The pixels of a label."""
        return cls(image.view, image.labels == label)


def observed_distance(grid: Grid, images: Sequence[MaskedView]) -> Volume:
    """The projective truncated signed distance of the voxels of a grid, NaN where no image knows it.

    Free is what any image shows to be free: the distance is then the least of those that do. Behind all surfaces the
    nearest one counts. A mean, as of `kit1000.voxels.fuse`, would fill space that is seen from the side.
    """
    first, *others = (tsdf(grid, image.view, image.mask, threads=1) for image in images)
    if not others:
        return first
    values = first.values.copy()
    for other in others:
        both = np.where(
            (values > 0) & (other.values > 0), np.minimum(values, other.values), np.fmax(values, other.values)
        )
        values = np.where(np.isnan(values), other.values, np.where(np.isnan(other.values), values, both))
    return Volume.adopt(grid, values)
