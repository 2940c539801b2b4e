"""The residual network of Transporter Networks, "43 layers, stride 8": an image to features of the same size."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor, nn

COARSEST = 8
"""Pixels of the input along a cell of the coarsest features: sizes are multiples of it."""


class Block(nn.Module):
    """Convolutions of 1x1, 3x3 and 1x1 beside a shortcut; the first one has the stride."""

    def __init__(
        self, before: int, channels: tuple[int, int, int], stride: int = 1, last: bool = False, opens: bool = True
    ) -> None:
        """New weights. last: without a ReLU at the output. opens: whether the shortcut has weights."""
        super().__init__()
        first, second, after = channels
        self.narrow = nn.Conv2d(before, first, 1, stride)
        self.middle = nn.Conv2d(first, second, 3, 1, 1)
        self.widen = nn.Conv2d(second, after, 1)
        self.shortcut = nn.Conv2d(before, after, 1, stride) if opens else nn.Identity()
        self.last = last

    def forward(self, x: Tensor) -> Tensor:
        """(B, before, h, w) -> (B, after, h / stride, w / stride)."""
        y = self.widen(F.relu(self.middle(F.relu(self.narrow(x))))) + self.shortcut(x)
        return y if self.last else F.relu(y)


def _stage(before: int, channels: tuple[int, int, int], stride: int = 1, last: bool = False) -> nn.Sequential:
    return nn.Sequential(Block(before, channels, stride, last), Block(channels[-1], channels, 1, last, opens=False))


class FCN(nn.Module):
    """Eight stages of two blocks: down to an eighth of the size and back, by bilinear upsampling."""

    def __init__(self, inputs: int, width: int, outputs: int, skips: bool = False, calm: bool = False) -> None:
        """New weights, uniform after Glorot.

        Args:
            inputs: channels.
            width: channels at full size; 8 times as many at an eighth of it.
            outputs: channels.
            skips: whether features on the way down are added on the way up; not in the paper.
            calm: whether the last layer of each block starts at zero.
        """
        super().__init__()
        self.skips = skips
        one, two, four, eight = ((width * k, width * k, width * k) for k in (1, 2, 4, 8))
        self.stem = nn.Conv2d(inputs, width, 3, 1, 1)
        self.down = nn.ModuleList(
            [_stage(width, one), _stage(width, two, 2), _stage(2 * width, four, 2), _stage(4 * width, eight, 2)]
        )
        self.bottom = _stage(8 * width, four)
        narrow = max(width // 4, 8)
        self.up = nn.ModuleList(
            [_stage(4 * width, two), _stage(2 * width, one), _stage(width, (narrow, narrow, outputs), 1, True)]
        )
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.xavier_uniform_(module.weight)
                nn.init.zeros_(module.bias)  # pyright: ignore[reportArgumentType]
        for module in self.modules() if calm else ():
            if isinstance(module, Block):
                nn.init.zeros_(module.widen.weight)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, h, w) -> (B, outputs, h, w); h and w multiples of COARSEST."""
        x = F.relu(self.stem(x))
        passed = []
        for stage in self.down:
            x = stage(x)
            passed.append(x)
        x = self.bottom(x)
        for stage, finer in zip(self.up, passed[-2::-1], strict=True):
            x = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            x = stage(x + finer if self.skips else x)
        return x
