"""The inputs of TransporterNet: maps of the kits and of the part, along the axes of a work frame.

A work frame is the world's, shifted level and rotated about the vertical. With a guess its origin is the guessed
position of the pivot and the part is first rotated by the guess; without one it is the middle of the observed kits and
the part is as it lies. From there the networks search.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from scipy.ndimage import uniform_filter

from baselines.heights.maps import UNSEEN, HeightMap, cell_centres, envelopes
from baselines.heights.scene_heights import SceneHeights
from baselines.transporter.config import TransporterConfig
from kit1000.pose import Pose
from kit1000.queries.guesses import MAX_OFFSET

KIT_SCALE, PART_SCALE, DETAIL_SCALE = 50e-3, 20e-3, 10e-3  # [m] that maps show as 1
DETAIL = 50e-3  # [m] across the neighbourhood whose mean height is taken off for the channel of details
BASE = 20e-3  # [m] across the square about a position whose mean height the height of the part is counted from
CANVAS = 1.5  # times a kernel: across the map of the part, so that its corners stay filled when it is rotated


@dataclass(frozen=True, eq=False)
class Start:
    """Where the search begins."""

    work_from_world: Pose
    """A level shift and a yaw."""
    work_from_part: Pose
    """The rotation of the part, as it lies, to where the search begins; the shift is not read."""
    guessed: bool

    def cropped(self, config: TransporterConfig) -> int:
        """Pixels across the map of the kits."""
        return config.near if self.guessed else config.kits

    def points(self, config: TransporterConfig) -> int:
        """Points across the lattice of scores."""
        return config.near - config.part + 1 if self.guessed else config.kits + 1


def start_of(heights: SceneHeights, pivot: np.ndarray, guess: Pose | None, yaw: float = 0.0) -> Start:
    """The start of a query in a work frame of some yaw [rad]; pivot: (3,) [m] of the part."""
    origin = heights.middle if guess is None else guess.apply(pivot)[:2]
    work_from_world = Pose.from_rotvec((0, 0, -yaw)) @ Pose.from_translation((-origin[0], -origin[1], 0.0))
    rotated = Pose.identity() if guess is None else work_from_world @ guess
    return Start(work_from_world, Pose(rotated.wxyz, np.zeros(3)), guess is not None)


def search_inputs(kits: HeightMap, shell: np.ndarray, start: Start, config: TransporterConfig) -> dict[str, np.ndarray]:
    """What a search reads: `kits` and `base` of `kit_maps`, `part` of `part_maps`, `window` (m, m) bool points.

    Args:
        kits: heights of the kits.
        shell: (n, 3) [m] points of the part along the axes of the world, about its pivot.
        start: where the search begins.
        config: of the network.
    """
    maps, base = kit_maps(kits, start, config)
    points = start.points(config)
    window = guess_window(start, config) if start.guessed else np.ones((points, points), bool)
    return {"kits": maps, "part": part_maps(shell, start, config), "window": window, "base": base}


def kit_maps(kits: HeightMap, start: Start, config: TransporterConfig) -> tuple[np.ndarray, np.ndarray]:
    """Maps of the kits, and the heights that predicted heights are counted from.

    Returns:
        (3, n, n) float32: height, whether seen, height above the mean nearby; (m, m) float32 [m] mean height about each
        point of the lattice.
    """
    n, work = start.cropped(config), start.work_from_world
    xy = cell_centres((n, n), config.pixel)
    world = work.inverse().apply(np.concatenate([xy, np.zeros((n, n, 1))], -1))[..., :2]
    heights = kits.at(world)
    seen = (heights > UNSEEN).astype(np.float32)
    heights = np.where(seen > 0, heights, np.float32(0))
    across = round(DETAIL / config.pixel)
    nearby = uniform_filter(heights, across, mode="constant") / np.maximum(
        uniform_filter(seen, across, mode="constant"), 1e-3
    )
    detail = np.where(seen > 0, heights - nearby, 0) / DETAIL_SCALE
    maps = np.stack([heights / KIT_SCALE, seen, detail]).astype(np.float32)
    return maps, _base_heights(heights, seen, start, config)


def _base_heights(heights: np.ndarray, seen: np.ndarray, start: Start, config: TransporterConfig) -> np.ndarray:
    """(m, m) float32 [m] mean height of the seen pixels in a square of an even number of pixels about each point."""
    reach, points, n = round(BASE / config.pixel / 2), start.points(config), len(heights)
    outside = max((points - 1) // 2 + reach - n // 2, 0)
    sums = []
    for image in (heights, seen):
        corner = np.pad(np.pad(image.astype(float), outside).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        first = n // 2 + outside - (points - 1) // 2 - reach
        low, high = slice(first, first + points), slice(first + 2 * reach, first + 2 * reach + points)
        sums.append(corner[high, high] - corner[low, high] - corner[high, low] + corner[low, low])
    return (sums[0] / np.maximum(sums[1], 1)).astype(np.float32)


def part_maps(shell: np.ndarray, start: Start, config: TransporterConfig) -> np.ndarray:
    """(3, c, c) float32 maps of a part about its pivot: highest and lowest point, and whether there is one.

    shell: (n, 3) [m] its points along the axes of the world, about the pivot.
    """
    across = 8 * ceil(config.part * CANVAS / 8)
    top, bottom, seen = envelopes(start.work_from_part.rotate(shell), (across, across), config.pixel)
    return np.stack([top / PART_SCALE, bottom / PART_SCALE, seen]).astype(np.float32)


def guess_window(start: Start, config: TransporterConfig) -> np.ndarray:
    """(m, m) bool: the points within the largest offset of a guess along axes of the world, and two pixels more."""
    points = start.points(config)
    axis = (np.arange(points) - (points - 1) / 2) * config.pixel
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1)
    offsets = start.work_from_world.inverse().rotate(np.concatenate([xy, np.zeros((points, points, 1))], -1))
    return np.asarray((np.abs(offsets[..., :2]) <= MAX_OFFSET + 2 * config.pixel).all(-1))
