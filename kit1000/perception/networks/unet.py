"""The U-Net of residual blocks that completes parts and kits and restores depth.

B batch, C channels; features are (B, C, x, y), channels last in memory.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

Net = TypeVar("Net", bound="UNet")


@dataclass(frozen=True)
class UNetConfig:
    """Sizes of a U-Net."""

    widths: tuple[int, ...] = (32, 48, 72, 96)
    """Channels at each resolution, each half the one before."""
    blocks: int = 1
    """Residual blocks at each resolution, on the way down and on the way up."""


class UNet(nn.Module):
    """A U-Net of residual blocks."""

    ENDS = ("stem", "head")
    """Layers that are no hidden ones, for the optimiser."""

    def __init__(self, inputs: int, outputs: int, config: UNetConfig) -> None:
        """inputs, outputs: channels."""
        super().__init__()
        self.config, widths, blocks = config, config.widths, config.blocks
        self.stem = nn.Conv2d(inputs, widths[0], 3, padding=1)
        self.down = nn.ModuleList(_blocks(width, blocks) for width in widths)
        pairs = list(pairwise(widths))
        self.coarser = nn.ModuleList(nn.Conv2d(fine, coarse, 2, stride=2) for fine, coarse in pairs)
        self.finer = nn.ModuleList(nn.ConvTranspose2d(coarse, fine, 2, stride=2) for fine, coarse in reversed(pairs))
        self.up = nn.ModuleList(_blocks(width, blocks) for width in reversed(widths[:-1]))
        self.head = nn.Conv2d(widths[0] + inputs, outputs, 1)

    def image(self, input: Tensor) -> Tensor:
        """(B, inputs, x, y) -> (B, outputs, x, y)."""
        features = self.stem(input)
        kept = []
        for blocks, coarser in zip(self.down, self.coarser, strict=False):
            features = blocks(features)
            kept.append(features)
            features = coarser(features)
        features = self.down[-1](features)
        for finer, blocks in zip(self.finer, self.up, strict=True):
            features = blocks(finer(features) + kept.pop())
        return self.head(torch.cat([features, input.to(features.dtype)], 1))


class ResidualBlock(nn.Module):
    """Two convolutions with batch normalisation, added to their input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.first_norm = nn.BatchNorm2d(width)
        self.second = nn.Conv2d(width, width, 3, padding=1, bias=False)
        self.second_norm = nn.BatchNorm2d(width)
        nn.init.zeros_(self.second_norm.weight)  # at first each block is the identity

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, x, y) -> (B, C, x, y)."""
        inner = F.relu(self.first_norm(self.first(F.relu(input))), inplace=True)
        return input + self.second_norm(self.second(inner))


def folded(net: Net) -> Net:
    """A copy of a network in evaluation mode with its batch normalisation folded into its convolutions: faster."""
    copy = deepcopy(net).eval()
    for block in copy.modules():
        if isinstance(block, ResidualBlock):
            for name in ("first", "second"):
                convolution, norm = getattr(block, name), getattr(block, f"{name}_norm")
                setattr(block, name, fuse_conv_bn_eval(convolution, norm))
                setattr(block, f"{name}_norm", nn.Identity())
    return copy


class BandedConv2d(nn.Module):
    """A 3 x 3 convolution in bands of BAND rows, whose patches stay in the cache: in float64 three times as fast."""

    BAND = 4

    def __init__(self, whole: nn.Conv2d) -> None:
        """whole: of one pixel of padding and no stride."""
        super().__init__()
        self.weight, self.bias = whole.weight, whole.bias

    def forward(self, input: Tensor) -> Tensor:
        """(B, C, x, y) -> (B, C', x, y)."""
        padded = F.pad(input, (1, 1, 1, 1))
        bands = (padded[:, :, first : first + self.BAND + 2] for first in range(0, input.shape[2], self.BAND))
        return torch.cat([F.conv2d(band, self.weight, self.bias) for band in bands], 2)


def in_float64(net: Net) -> Net:
    """A copy of a network that calculates in float64, its 3 x 3 convolutions in bands."""
    copy = deepcopy(net).double()
    for name, layer in list(copy.named_modules()):
        if isinstance(layer, nn.Conv2d) and layer.kernel_size == (3, 3):
            copy.set_submodule(name, BandedConv2d(layer))
    return copy


def _blocks(width: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(ResidualBlock(width) for _ in range(count)))
