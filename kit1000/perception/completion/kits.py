"""The network that completes kits, and its use: height maps of plates.

The network takes the seen heights of a plate to how likely each layer of a hidden cell is free. B batch; images are
(B, x, y) in cells, features (B, C, x / 2, y / 2), channels last in memory.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.perception.networks.inference import on_cpu, on_grid, with_mirror
from kit1000.perception.networks.unet import UNet, UNetConfig
from kit1000.perception.observed.columns import MaskedView, ObservedColumns
from kit1000.perception.observed.kits import CELL, CELLS, DEEPEST, CompletedHeights, SeenHeights
from kit1000.perception.observed.pixels import subpixel_points
from kit1000.values import ASSEMBLY_LABEL, LabelledDepth

PACK = 2  # cells along x and along y that are channels of one pixel of the network
MAPS, EXTRA = 3, 2  # channels: of a cell; of the camera
MIDDLE_POLAR, MIDDLE_DISTANCE = 0.8, 0.8  # [rad], [m] of the cameras, which are the origin of their channels
DEPTH_UNIT = 10.0  # [mm] of a depth of 1 in the input
DEPTH_STEP = 0.01  # [mm] to which depths are rounded: sums of float32 depend on the processor


class KitCompletionNet(UNet):
    """The seen heights of a plate to logits of its layers of 1 mm being free."""

    def __init__(self, config: UNetConfig) -> None:
        super().__init__(PACK * PACK * MAPS + EXTRA, PACK * PACK * DEEPEST, config)

    def forward(self, least: Tensor, seen: Tensor, camera: Tensor) -> Tensor:
        """(B, DEEPEST, x, y) logits of layers being free, the highest first; arguments: see `SeenHeights`."""
        depth, known = least / DEPTH_UNIT, seen.to(least.dtype)
        maps = F.pixel_unshuffle(torch.stack([depth, known, depth * known], 1), PACK)
        middle = torch.tensor([MIDDLE_POLAR, MIDDLE_DISTANCE], device=least.device)
        place = (4 * (camera - middle))[:, :, None, None].expand(-1, -1, *maps.shape[2:])
        read = torch.cat([maps, place], 1).contiguous(memory_format=torch.channels_last)
        return F.pixel_shuffle(self.image(read), PACK)


def kit_loss(logits: Tensor, least: Tensor, seen: Tensor, depth: Tensor, weight: Tensor) -> Tensor:
    """() cross-entropy of the layers, summed over those that are not seen free, its mean over hidden cells.

    Args:
        logits: (B, DEEPEST, x, y) of the network.
        least: (B, x, y), see `SeenHeights`.
        seen: (B, x, y) bool, see `SeenHeights`; these cells do not count.
        depth: (B, x, y) [mm] the truth.
        weight: (B, x, y) of the cells.
    """
    share = (depth[:, None] - _tops(logits)).clamp(0, 1)
    weight = weight * ~seen
    counts = weight[:, None] * (least[:, None] < _tops(logits) + 1)
    logits = logits.float()
    return ((F.softplus(logits) - logits * share) * counts).sum() / weight.sum().clamp(min=1)


def likely_depths(logits: Tensor) -> Tensor:
    """(B, x, y) [mm]: the depth at which a cell is as likely free as filled, linear between the middles of layers.

    logits: (B, DEEPEST, x, y). Its mean absolute error is least among all depths, as of any median.
    """
    free = torch.sigmoid(logits.float())
    above = torch.cat([torch.ones_like(free[:, :1]), free[:, :-1]], 1)
    first = (free < 0.5).float().argmax(1, keepdim=True)  # 0 where none is
    here, before = free.gather(1, first)[:, 0], above.gather(1, first)[:, 0]
    crossing = first[:, 0] - 0.5 + (before - 0.5) / (before - here).clamp(min=1e-6)
    return torch.where((free < 0.5).any(1), crossing, float(DEEPEST)).clamp(0, DEEPEST)


def _tops(logits: Tensor) -> Tensor:
    """(1, DEEPEST, 1, 1) [mm]: depth of the upper face of each layer."""
    return torch.arange(DEEPEST, device=logits.device, dtype=torch.float32).view(1, -1, 1, 1)


class KitCompleter:
    """The network with its weights."""

    def __init__(self, weights: Path | KitCompletionNet) -> None:
        """weights: stem of the files, or the network itself."""
        self.net = on_cpu(weights, UNetConfig, KitCompletionNet, fold=False)

    def __call__(self, heights: SeenHeights) -> CompletedHeights:
        """The heights with likely depths of its hidden cells, never above what is seen free.

        They follow from the mean of the logits of the heights and of its mirror image.
        """
        least, seen = with_mirror(heights.least), with_mirror(heights.seen)
        camera = torch.from_numpy(np.stack([heights.camera, heights.camera]))
        with torch.inference_mode():
            logits = self.net(least, seen, camera)
            likely = likely_depths((logits[:1] + logits[1:].flip(3)) / 2)[0].numpy()
        rounded = on_grid(likely, DEPTH_STEP).astype(np.float32)
        hidden = np.maximum(rounded, heights.least)
        return CompletedHeights(heights, np.where(heights.seen, heights.least, hidden))


def filled_by_columns(image: LabelledDepth, shown: SeenHeights) -> CompletedHeights:
    """The heights as `ObservedKits` fills it without the network: DEEPEST in a cell without an observed point."""
    mask = image.labels == ASSEMBLY_LABEL
    half, deep = CELL * CELLS / 2, 1e-3 * DEEPEST
    images, points = [MaskedView(image.view, mask)], subpixel_points(image.view, mask)
    solid = ObservedColumns.of(images, points, shown.world_from_plate, (half, deep), -deep, CELL).filled_cells()
    layers = np.where(solid.any(-1), solid.shape[-1] - solid[..., ::-1].argmax(-1), 0)  # up to the surface
    depth = np.clip(DEEPEST + 0.25 - layers, 0, DEEPEST)  # the middle of the lowest lies 0.25 mm above DEEPEST
    return CompletedHeights(shown, depth.reshape(CELLS, 2, CELLS, 2).mean((1, 3)).astype(np.float32))
