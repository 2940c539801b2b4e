"""The network of KitNet: two views to the rotation between them, as a quaternion.

B batch, P pixels of a view; quaternions are wxyz.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from baselines.kitnet.config import KitNetConfig

POOLED = 4  # pixels of the features that the head reads


class Residual(nn.Module):
    """Two 3x3 convolutions beside a shortcut."""

    def __init__(self, channels: int, stride: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, stride, 1, bias=False)
        self.second = nn.Conv2d(channels, channels, 3, 1, 1, bias=False)
        self.first_norm, self.second_norm = nn.BatchNorm2d(channels), nn.BatchNorm2d(channels)
        self.shortcut = nn.Identity()
        if stride > 1:
            self.shortcut = nn.Sequential(
                nn.Conv2d(channels, channels, 1, stride, bias=False), nn.BatchNorm2d(channels)
            )

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, P, P) -> (B, C, P / stride, P / stride)."""
        y = F.relu(self.first_norm(self.first(x)))
        return F.relu(self.second_norm(self.second(y)) + self.shortcut(x))


def _stage(before: int, after: int, stride: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, stride, 1, bias=False), nn.BatchNorm2d(after), nn.ReLU(), Residual(after)
    )


def _encoder(width: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(1, width, 3, 2, 1, bias=False), nn.BatchNorm2d(width), nn.ReLU(), Residual(width, 2))


class KitNet(nn.Module):
    """An encoder for each view, a trunk for both together, and one linear layer."""

    def __init__(self, config: KitNetConfig) -> None:
        super().__init__()
        self.config = config
        width, wide = config.width, 4 * config.width
        self.part, self.cavity = _encoder(width), _encoder(width)
        first, second, third = config.strides
        self.trunk = nn.Sequential(
            _stage(2 * width, wide, first), _stage(wide, wide, second), _stage(wide, wide, third)
        )
        self.head = nn.Linear(wide * POOLED**2, 4)
        with torch.no_grad():
            self.head.bias[0] += 1.0  # no rotation

    def forward(self, part: Tensor, cavity: Tensor) -> Tensor:
        """(B, P, P) and (B, P, P) -> (B, 4) unit quaternions."""
        joined = torch.cat([self.part(part[:, None]), self.cavity(cavity[:, None])], 1)
        pooled = F.adaptive_avg_pool2d(self.trunk(joined), POOLED)
        return F.normalize(self.head(pooled.flatten(1)).float(), dim=1)


def rotation_loss(predicted: Tensor, goals: Tensor, weights: Tensor) -> Tensor:
    """(B,) squared sine of half the angle to the nearest goal.

    A quaternion and its negative are the same rotation and have the same loss. The release has 1 - <q, g>, which
    punishes one of the two.

    Args:
        predicted: (B, 4).
        goals: (B, m, 4).
        weights: (B, m) 1 for a goal, 0 for a row without one.
    """
    cosine = _cosine(predicted, goals, weights)
    return 1 - cosine.square().amax(1).clamp(max=1)


def rotation_error(predicted: Tensor, goals: Tensor, weights: Tensor) -> Tensor:
    """(B,) [rad]: the angle to the nearest goal; arguments as for `rotation_loss`."""
    cosine = _cosine(predicted, goals, weights)
    return 2 * torch.arccos(cosine.abs().amax(1).clamp(max=1))


def _cosine(predicted: Tensor, goals: Tensor, weights: Tensor) -> Tensor:
    """(B, m) of half the angles; products of matrices would be in half precision, whose steps near 1 are 5 degrees."""
    return (predicted[:, None] * goals).sum(-1) * weights
