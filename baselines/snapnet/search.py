"""Where a part without a guess may belong: the position network over all kits, with the part at yaws all around.

The network was trained in the window of a guess, for parts that a guess has rotated by up to 27.5 degrees. Its features
are those of convolutions, so they serve a window over all kits as well; yaws 30 degrees apart keep the part within the
range of its training. Scores at different cavities were never compared in training, and in one image a wide cavity
scores high at every yaw: half of a cell's mean over the yaws is therefore taken off there.
"""

from __future__ import annotations

import numpy as np
import torch

from baselines.snapnet.config import Cells, PositionConfig
from baselines.snapnet.convolutions import correlate
from baselines.snapnet.position import COARSEST, PositionNet
from baselines.snapnet.query_volumes import QueryVolumes
from kit1000.pose import Pose

YAWS = 12
RISE = 0.038  # [m] of the middle of the window above that of the observed kits; the mean of seated pivots in val
REACH = (0.11, 0.11, 0.042)  # [m] of the window to every side: the largest in val is 0.096 level and 0.029 in height
MEAN_SHARE = {"truth": 0.0, "depth": 0.5}
"""Share of a cell's mean over the yaws that is taken off, by source. In 54 queries of `val`, from one image, the right
start is then among the best five in 52, without it in 47; with true volumes the mean position error grows from 1.3 to
3.5 mm."""
APART = 8  # cells along level axes, and one yaw, within which a better start leaves no other


def likely_starts(net: PositionNet, volumes: QueryVolumes, count: int) -> list[Pose]:
    """The motions of an upright part, goal_from_now, that the position network scores best, the best first.

    Args:
        net: trained with a guess.
        volumes: of a query without a guess; InputError where no kit is observed.
        count: motions.
    """
    config, pivot = net.config, volumes.query.pivot
    middle = volumes.initial_guess().apply(pivot) + (0, 0, RISE)
    work, device = Pose.from_translation(middle), next(net.parameters()).device
    cells, window = wide_window(config)
    yaws = [Pose.from_rotvec((0, 0, 2 * np.pi * k / YAWS)) for k in range(YAWS)]
    there = [Pose(yaw.wxyz, middle - yaw.apply(pivot)) for yaw in yaws]
    parts = np.stack([volumes.part_volume(guess, work, config.part_cells, config.voxel) for guess in there])
    kit = volumes.kit_volume(work, cells, config.voxel)[None]
    features = net.part(torch.as_tensor(parts, device=device)), net.kit(torch.as_tensor(kit, device=device))
    scores = correlate(*features, window).float().cpu().numpy()
    best = best_cells(scores - MEAN_SHARE[volumes.source] * scores.mean(0), count)
    offsets = (best[:, 1:] - np.array(window) // 2) * (2 * config.voxel)
    return [Pose(there[k].wxyz, there[k].xyz + offset) for k, offset in zip(best[:, 0], offsets, strict=True)]


def wide_window(config: PositionConfig) -> tuple[Cells, Cells]:
    """Voxels of the kits' volume and cells of the scores, for a window of REACH to every side."""
    step = 2 * COARSEST  # the middles of both volumes are then a whole number of cells from their first voxels
    reach = (round(2 * side / config.voxel / step) * step for side in REACH)
    x, y, z = (part + more for part, more in zip(config.part_cells, reach, strict=True))
    a, b, c = ((kit - part) // 2 + 1 for kit, part in zip((x, y, z), config.part_cells, strict=True))
    return (x, y, z), (a, b, c)


def best_cells(scores: np.ndarray, count: int) -> np.ndarray:
    """The best cells (count, 4), yaw and position, of scores (YAWS, wx, wy, wz), no two in one place; best first."""
    left, found = scores.copy(), []
    for _ in range(count):
        k, a, b, c = (int(i) for i in np.unravel_index(int(left.argmax()), left.shape))
        found.append((k, a, b, c))
        for yaw in (k - 1, k, k + 1):
            left[yaw % YAWS, max(a - APART, 0) : a + APART + 1, max(b - APART, 0) : b + APART + 1] = -np.inf
    return np.array(found)
