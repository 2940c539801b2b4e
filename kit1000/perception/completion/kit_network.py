"""The network that completes kits: from the seen heights of a plate to how likely each layer of a hidden cell is free.

B batch; images are (B, x, y) in cells, features (B, C, x / 2, y / 2), channels last in memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.perception.networks.unet import UNet
from kit1000.perception.observed.kits import DEEPEST

PACK = 2  # cells along x and along y that are channels of one pixel of the network
MAPS, EXTRA = 3, 2  # channels: of a cell; of the camera
MIDDLE_POLAR, MIDDLE_DISTANCE = 0.8, 0.8  # [rad], [m] of the cameras, which are the origin of their channels
DEPTH_UNIT = 10.0  # [mm] of a depth of 1 in the input


@dataclass(frozen=True)
class KitCompletionConfig:
    """Sizes of the network, and what its examples show."""

    widths: tuple[int, ...] = (32, 48, 72, 96)
    """Channels at each resolution, from 40 x 40 pixels, each half the one before."""
    blocks: int = 1
    """Residual blocks at each resolution, on the way down and on the way up."""
    views: int = 14_000
    """Fresh views that the training examples show, mirrored or not."""
    drawn_share: float = 0.5
    """Share of the views with a kit cut for a newly sampled part instead of one of the train split."""
    drawn_kits: int = 3000
    """Number of these newly cut kits."""
    stretched_share: float = 0.75
    """Share of the views with their kit stretched."""
    views_seed: int = 2034
    """Seed of views and kits."""
    sensor_model: int = 1
    """Data version of the sensors that made the training examples: 1 or 2; training makes those of 2."""


KIT_COMPLETION = {
    "small": KitCompletionConfig(sensor_model=2),
    "pretraining": KitCompletionConfig(
        views=12_000, drawn_share=0.75, drawn_kits=3000, stretched_share=0.0, views_seed=2032, sensor_model=2
    ),
    "pretraining-2": KitCompletionConfig(
        views=10_000, drawn_share=0.25, drawn_kits=600, stretched_share=0.0, views_seed=2033, sensor_model=2
    ),
    "measured": KitCompletionConfig(views_seed=2052, sensor_model=2),
}
"""Runs, each from the weights of the one before: `pretraining` sees more kinds of kits than those of datasets,
`pretraining-2` mostly theirs, `small` and `measured` fresh and stretched ones of both."""


class KitCompletionNet(UNet):
    """The seen relief of a plate to logits of its layers of 1 mm being free."""

    def __init__(self, config: KitCompletionConfig) -> None:
        super().__init__(PACK * PACK * MAPS + EXTRA, PACK * PACK * DEEPEST, config.widths, config.blocks)
        self.config = config

    def forward(self, least: Tensor, seen: Tensor, camera: Tensor) -> Tensor:
        """(B, DEEPEST, x, y) logits of layers being free, the highest first; arguments as of `SeenRelief`."""
        depth, known = least / DEPTH_UNIT, seen.to(least.dtype)
        maps = F.pixel_unshuffle(torch.stack([depth, known, depth * known], 1), PACK)
        middle = torch.tensor([MIDDLE_POLAR, MIDDLE_DISTANCE], device=least.device)
        place = (4 * (camera - middle))[:, :, None, None].expand(-1, -1, *maps.shape[2:])
        evidence = torch.cat([maps, place], 1).contiguous(memory_format=torch.channels_last)
        return F.pixel_shuffle(self.image(evidence), PACK)


def kit_loss(logits: Tensor, least: Tensor, seen: Tensor, depth: Tensor, weight: Tensor) -> Tensor:
    """() cross-entropy of the layers, summed over those that are not seen free, its mean over hidden cells.

    Args:
        logits: (B, DEEPEST, x, y) of the network.
        least: (B, x, y) as of `SeenRelief`.
        seen: (B, x, y) bool as of `SeenRelief`; these cells do not count.
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
