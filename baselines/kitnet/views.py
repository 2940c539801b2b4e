"""The two depth views of KitNet: the part from above, and the cavity along the normal of its plate.

The cavity is shown as the method's authors do, turned inside out: its depth below the plate is drawn as a height, so
that part and cavity look alike. Beside the part and beside the cavity a view is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_closing, binary_fill_holes, label

from baselines.heights.maps import HeightMap, cell_centres, envelopes
from kit1000.numerics.compiled import compiled
from kit1000.perception.observed.plates import Plane, plane_frame
from kit1000.pose import Pose

SCALE = 20e-3  # [m] that a view shows as 1
CELL = 1e-3  # [m] of the image of a cavity
SEARCH = (136, 136)  # cells about the middle of a plate of 99 mm, whose middle may be observed 15 mm off
CAVITY = (96, 96)  # cells of the image of a cavity about its middle: no part is longer than 50 mm
STEP = 0.5e-3  # [m] along a ray
HIGHEST, DEEPEST = 3e-3, 30e-3  # [m] above and below the plate, between which a ray is followed
FLUSH = 1.5e-3  # [m] from the plane of a plate that counts as plate
SMALLEST = 100  # cells of a cavity


@dataclass(frozen=True, eq=False)
class CavityView:
    """A cavity, seen along the normal of its plate."""

    world_from_view: Pose
    """z out of the cavity; the origin is at its middle, in the plane of the plate."""
    depths: np.ndarray
    """CAVITY float32 [m] below the plate; 0 beside the cavity."""

    @property
    def centroid(self) -> np.ndarray:
        """(2,) [m] of the area of its mouth, in the view."""
        return cell_centres(CAVITY, CELL)[self.depths > 0].mean(0)

    @property
    def floor(self) -> float:
        """[m] depth of the floor: nine tenths of the cavity are shallower."""
        return float(np.quantile(self.depths[self.depths > 0], 0.9))


def cavity_view(kits: HeightMap, plane: Plane) -> CavityView | None:
    """The largest cavity in a plate; None if there is none."""
    world_from_plate = plane_frame(plane, plane.point)
    depths = _depths(kits, world_from_plate, SEARCH)
    plate = np.abs(depths) < FLUSH
    filled = np.asarray(binary_fill_holes(binary_closing(plate, iterations=2)))
    pieces, _ = label(filled & ~(depths < FLUSH))  # pyright: ignore[reportGeneralTypeIssues]
    sizes = np.bincount(pieces.ravel())[1:]
    if sizes.max(initial=0) < SMALLEST:
        return None
    inside = pieces == 1 + int(sizes.argmax())
    cells = np.argwhere(inside)
    middle = (cells.min(0) + cells.max(0) + 1) // 2
    known = np.where(np.isnan(depths), np.nanmax(np.where(inside, depths, np.nan), initial=FLUSH), depths)
    first = middle - np.array(CAVITY) // 2
    padded = np.pad(np.where(inside, known, 0).astype(np.float32), np.array(CAVITY) // 2)
    crop = padded[tuple(slice(i + n // 2, i + n // 2 + n) for i, n in zip(first, CAVITY, strict=True))]
    offset = (middle - np.array(SEARCH) / 2) * CELL
    return CavityView(world_from_plate @ Pose.from_translation((*offset, 0.0)), crop)


def _depths(kits: HeightMap, world_from_plate: Pose, cells: tuple[int, int]) -> np.ndarray:
    """Cells float64 [m]: how far below a plane rays against its normal meet the map; NaN where they meet nothing."""
    levels = np.arange(-HIGHEST, DEEPEST, STEP)
    starts = world_from_plate.apply(np.concatenate([cell_centres(cells, CELL), np.zeros((*cells, 1))], -1))
    depths = np.full(cells, np.nan)
    _follow(depths, starts, world_from_plate.rotate((0.0, 0.0, 1.0)), levels, kits.heights, kits.corner, kits.cell)
    return depths


@compiled
def _follow(depths, starts, normal, levels, heights, corner, cell):
    for a in range(depths.shape[0]):
        for b in range(depths.shape[1]):
            x, y, z = starts[a, b]
            for level in levels:
                i = int(np.floor((x - level * normal[0] - corner[0]) / cell))
                j = int(np.floor((y - level * normal[1] - corner[1]) / cell))
                if 0 <= i < heights.shape[0] and 0 <= j < heights.shape[1]:
                    surface = heights[i, j]
                    if surface >= 0 and z - level * normal[2] <= surface:
                        depths[a, b] = level
                        break


def cavity_image(cavity: CavityView, yaw: float, shift: np.ndarray, pixels: int, pixel: float) -> np.ndarray:
    """(pixels, pixels) float32: a cavity, rotated by a yaw [rad] about its middle and shifted by (2,) [m]."""
    return _rotated(HeightMap(-np.array(CAVITY) * CELL / 2, CELL, cavity.depths), yaw, shift, pixels, pixel)


def _rotated(image: HeightMap, yaw: float, shift: np.ndarray, pixels: int, pixel: float) -> np.ndarray:
    xy = cell_centres((pixels, pixels), pixel) - shift
    c, s = np.cos(yaw), np.sin(yaw)
    there = np.stack([c * xy[..., 0] + s * xy[..., 1], c * xy[..., 1] - s * xy[..., 0]], -1)
    return np.maximum(image.at(there), 0) / np.float32(SCALE)


def part_image(shell: np.ndarray, shift: np.ndarray, pixels: int, pixel: float) -> np.ndarray:
    """(pixels, pixels) float32: a part from above, about the middle of its extents.

    Args:
        shell: (n, 3) [m] its points along the axes of the view.
        shift: (2,) [m] of the part in the view.
        pixels: of the view.
        pixel: [m]
    """
    if not len(shell):
        return np.zeros((pixels, pixels), np.float32)
    low, high = shell.min(0), shell.max(0)
    middle = (low + high) / 2
    top, _, seen = envelopes(shell - (*(middle[:2] - shift), low[2]), (pixels, pixels), pixel)
    return np.where(seen, top / np.float32(SCALE), 0).astype(np.float32)
