"""Height maps: the highest observed point above each square of the table.

Cell (i, j) of a map covers x from x0 + i * cell to x0 + (i + 1) * cell, and y likewise: its centre is half a cell
further. Points and cells follow that one rule everywhere, so nothing is shifted by half a cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kit1000.errors import checked
from kit1000.numerics.compiled import compiled

UNSEEN = np.float32(-1.0)
"""Stands for the height of a cell that no camera sees; the table is at 0."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights along the axes of the world."""

    corner: np.ndarray
    """(2,) [m] x and y of the outer corner of cell (0, 0)."""
    cell: float
    """[m] edge."""
    heights: np.ndarray
    """(nx, ny) float32 [m] above the table; UNSEEN where no point was observed."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "corner", checked("corner", self.corner, (2,)))
        object.__setattr__(self, "heights", checked("heights", self.heights, np.shape(self.heights)[:2], np.float32))

    def at(self, xy: np.ndarray) -> np.ndarray:
        """(...,) float32 [m]: heights of the cells that hold points (..., 2) [m]; UNSEEN outside the map."""
        index = np.floor((xy - self.corner) / self.cell).astype(np.int64)
        inside = np.asarray(((index >= 0) & (index < self.heights.shape)).all(-1))
        index = np.where(inside[..., None], index, 0)
        return np.where(inside, self.heights[index[..., 0], index[..., 1]], UNSEEN)

    def points(self) -> np.ndarray:
        """(n, 3) float64 [m] world: the middle of each seen cell, at its height."""
        i, j = np.nonzero(self.heights > UNSEEN)
        xy = self.corner + (np.stack([i, j], -1) + 0.5) * self.cell
        return np.column_stack([xy, self.heights[i, j]])


def cell_centres(cells: tuple[int, int], cell: float) -> np.ndarray:
    """(nx, ny, 2) [m]: the middles of the cells of a map that is centred on the origin."""
    i, j = np.indices(cells)
    return (np.stack([i, j], -1) + 0.5 - np.array(cells) / 2) * cell


def envelopes(points: np.ndarray, cells: tuple[int, int], cell: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The surface of points from above and from below, on a map that is centred on the origin.

    Args:
        points: (n, 3) [m].
        cells: (nx, ny).
        cell: [m] edge.

    Returns:
        Highest and lowest z of each cell (nx, ny) float32 [m], 0 where there is none, and whether there is one.
    """
    top, bottom = np.full(cells, -np.inf, np.float32), np.full(cells, np.inf, np.float32)
    _fill_envelopes(top, bottom, points, cell)
    seen = top > -np.inf
    return np.where(seen, top, np.float32(0)), np.where(seen, bottom, np.float32(0)), seen


@compiled
def _fill_envelopes(top, bottom, points, cell):
    for n in range(len(points)):
        i = int(np.floor(points[n, 0] / cell + top.shape[0] / 2))
        j = int(np.floor(points[n, 1] / cell + top.shape[1] / 2))
        if 0 <= i < top.shape[0] and 0 <= j < top.shape[1]:
            z = np.float32(points[n, 2])
            top[i, j] = max(top[i, j], z)
            bottom[i, j] = min(bottom[i, j], z)
