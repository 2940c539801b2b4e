"""A part completed by the network: how likely each cell is filled, and the solid of the likely ones."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from kit1000.numerics.compiled import compiled
from kit1000.perception.completion.part_network import (
    CODE,
    CompletionConfig,
    CompletionNet,
    FramedPart,
    framed,
    packed,
    scale_of,
    unpacked,
)
from kit1000.perception.networks.inference import on_cpu, on_grid
from kit1000.perception.observed.columns import ObservedColumns
from kit1000.perception.observed.parts import ObservedPart, PartBounds
from kit1000.values import LabelledDepth
from kit1000.voxels import Grid, Volume

TEMPERATURE = 1.35  # by which logits are divided, so that probabilities are shares; fitted to the split val
LIKELY, LIKELY_NOISY = 0.2, -0.4  # logits above which a cell is taken as solid: there the IoU is largest (split val)
LOGIT_STEP = 1 / 64  # to which logits are rounded: sums of float32 depend on the processor
SEEN_FREE = -12.0  # logit of cells that are seen free


@dataclass(frozen=True, eq=False)
class FillLogits:
    """Logits of the cells of a grid being filled."""

    grid: Grid
    values: np.ndarray
    """(nx, ny, nz) float32"""

    @property
    def probability(self) -> np.ndarray:
        """(nx, ny, nz) float32, 0 to 1."""
        return 1 / (1 + np.exp(-self.values))

    def at(self, grid: Grid, step: tuple[int, int, int]) -> np.ndarray:
        """(nx, ny, nz) float32: the logits at every so many voxels of another grid, interpolated; SEEN_FREE outside."""
        shape = tuple(n // s for n, s in zip(grid.shape, step, strict=True))
        here_from_there = self.grid.world_from_grid.inverse() @ grid.world_from_grid
        scale = grid.voxel_size / self.grid.voxel_size * np.array(step, float)
        values = np.full(shape, np.float32(SEEN_FREE))
        shift = here_from_there.xyz / self.grid.voxel_size
        _interpolate(self.values, here_from_there.rotation_matrix() * scale, shift, values)
        return values


class PartCompleter:
    """The network with its weights."""

    def __init__(self, weights: Path | CompletionNet) -> None:
        """weights: stem of the files, or the network itself."""
        self.net = on_cpu(weights, CompletionConfig, CompletionNet, fold=False)

    def __call__(self, part: FramedPart) -> FillLogits:
        """The mean of the logits of the evidence and of its mirror image; cells that are seen free are not filled."""
        pair = np.stack([packed(part.codes), packed(part.codes[:, ::-1])])
        camera = np.stack([part.camera, part.camera])
        with torch.inference_mode():
            logits = self.net(torch.from_numpy(pair), torch.from_numpy(camera)).float().numpy()
        mean = (unpacked(logits[0]) + unpacked(logits[1])[:, ::-1]) / (2 * TEMPERATURE)
        mean = on_grid(mean, LOGIT_STEP).astype(np.float32)
        return FillLogits(part.grid, np.where(part.codes == CODE, np.float32(SEEN_FREE), mean))


@dataclass(frozen=True, eq=False)
class CompletedPart:
    """A part in a depth image, completed by the network; on the grids of `ObservedPart`."""

    observed: ObservedPart
    completer: PartCompleter
    raw: LabelledDepth | None = None
    """The calibrated image of a noisy sensor as it was measured; None: that of `observed`, which is exact."""

    @property
    def middle(self) -> np.ndarray:
        """(3,) [m] world: of the grids, see `ObservedPart.middle`."""
        return self.observed.middle

    @cached_property
    def framed(self) -> FramedPart | None:
        """What the network reads; None where no pixel has a return."""
        image, label, height = self.raw or self.observed.image, self.observed.label, self.observed.table_height()
        return framed(image, label, height, scale=scale_of(image, label, height))

    @cached_property
    def logits(self) -> FillLogits | None:
        """On the grid of the network; None where no pixel has a return."""
        return None if self.framed is None else self.completer(self.framed)

    def probability(self, voxel: float) -> Volume:
        """1 - 2 p at each voxel of `ObservedPart.volume`, p the probability of it being filled: negative where likely.

        voxel: [m] edge.
        """
        grid = self.observed.columns(voxel).grid
        if self.logits is None:
            return Volume.adopt(grid, np.ones(grid.shape, np.float32))
        return Volume.adopt(grid, -np.tanh(self.logits.at(grid, (1, 1, 1)) / 2))

    def solid_above(self, logit: float, voxel: float) -> Volume:
        """Negative where the logit is above another one, else positive, -1 to 1; on the grid of `probability`."""
        odds = self.probability(voxel)
        return Volume.adopt(odds.grid, np.clip(odds.values + np.float32(np.tanh(logit / 2)), -1, 1))

    def volume(self, voxel: float) -> Volume:
        """Signed distances to the part, on the grid of `ObservedPart`.

        Solid where the logit is above LIKELY, in noisy images above LIKELY_NOISY.
        """
        return self._filled(self.observed.columns(voxel))

    def bounds(self, voxel: float) -> PartBounds:
        """The bounds of the part, as `ObservedPart` has them, and the likely solid between."""
        columns = self.observed.columns(voxel)
        return PartBounds(self._filled(columns), columns.sure(), columns.possible())

    def _filled(self, columns: ObservedColumns) -> Volume:
        if self.logits is None:
            return columns.filled(largest_only=True)
        likely = self.logits.at(columns.fine, (1, 1, 2)) > (LIKELY if self.raw is None else LIKELY_NOISY)
        return columns.completed(likely, exact=self.raw is None)


@compiled
def _interpolate(source, linear, shift, values):
    """Fill `values` with the trilinear interpolation of `source` at linear @ (i, j, k) + shift, where that is inside.

    The third axes of both are parallel.
    """
    nx, ny, nz = source.shape
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            x = linear[0, 0] * i + linear[0, 1] * j + shift[0]
            y = linear[1, 0] * i + linear[1, 1] * j + shift[1]
            if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1):
                continue
            a, b = min(int(x), nx - 2), min(int(y), ny - 2)
            u, v = x - a, y - b
            near = source[a, b], source[a + 1, b], source[a, b + 1], source[a + 1, b + 1]
            share = (1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v
            for k in range(values.shape[2]):
                z = min(max(linear[2, 2] * k + shift[2], 0.0), nz - 1.0)
                if abs(z - (linear[2, 2] * k + shift[2])) > 0.5:
                    continue
                c = min(int(z), nz - 2)
                w, total = z - c, 0.0
                for n in range(4):
                    total += share[n] * ((1 - w) * near[n][c] + w * near[n][c + 1])
                values[i, j, k] = total
