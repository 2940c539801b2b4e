"""The network that restores noisy depth: from measured disparities to where the surface of each pixel really is.

Disparities count from that of the table's plane [px]: 0 on the table, more for what is nearer. B batch; images are
(B, H, W), sides multiples of `PACK * 8`; features (B, C, H / 2, W / 2), channels last in memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.perception.networks.unet import UNet

PACK = 2  # pixels along each side that are channels of one pixel of the network
MAPS, SLOPES = 4, 2  # channels: of a pixel; of the table's plane
SIDE = PACK * 8  # [px] of which sides of images are multiples
DISPARITY_UNIT = 4.0  # [px] of a disparity of 1 in the input
SLOPE_UNIT = 0.05  # [px/px] of a slope of 1
LEVEL_UNIT = 0.2  # [px] of a level of 1
LEAST_SPREAD, FIRST_SPREAD = 0.01, 0.1  # [px]


@dataclass(frozen=True)
class RestorationConfig:
    """Sizes of the network."""

    widths: tuple[int, ...] = (32, 48, 72, 96)
    """Channels at each resolution, from half the image's, each half the one before."""
    blocks: int = 1
    """Residual blocks at each resolution, on the way down and on the way up."""
    labelled: bool = True
    """Whether it reads masks; without them it says where bodies end."""
    level: bool = False
    """Whether it reads how noisy the image is."""
    sensor_model: int = 1
    """Data version of the sensors that made the training examples: 1 or 2; training makes those of 2."""
    views: int = 1500
    """Fresh views of scenes, of which the training examples are crops."""
    views_seed: int = 2029
    """Seed of these views."""


RESTORATION = {
    "small": RestorationConfig(level=True, sensor_model=2, views=3000, views_seed=2035),
    "pretraining": RestorationConfig(level=True, sensor_model=2),
    "measured": RestorationConfig(level=True, sensor_model=2, views=30_000, views_seed=2048),
    "large": RestorationConfig((48, 72, 108, 144), 2, level=True, sensor_model=2, views=30_000, views_seed=2048),
}
"""`small` starts from the weights of `pretraining`, `measured` from those of `small`, `large` from none."""
UNMASKED = {
    "small": RestorationConfig(labelled=False, level=True, sensor_model=2),
    "measured": RestorationConfig(labelled=False, level=True, sensor_model=2, views=30_000, views_seed=2049),
}
"""`measured` starts from the weights of `small`."""
HOLES = {
    "small": RestorationConfig(level=True, sensor_model=2, views=2000, views_seed=2062),
    "pretraining": RestorationConfig(level=True, sensor_model=2, views=2500, views_seed=2061),
}
"""For holes in a scanner's image; `small` starts from the weights of `pretraining`."""


class Mixture(NamedTuple):
    """What is known of the surface of each pixel: one of two disparities, each with a Laplace distribution."""

    disparity: Tensor
    """(B, 2, H, W) [px] the medians."""
    spread: Tensor
    """(B, 2, H, W) [px] mean absolute deviations."""
    log_share: Tensor
    """(B, 2, H, W) logarithms of the weights."""

    def log_likelihood(self, disparity: Tensor) -> Tensor:
        """(B, H, W) of disparities (B, H, W) [px]."""
        away = (disparity[:, None] - self.disparity).abs() / self.spread
        return torch.logsumexp(self.log_share - torch.log(2 * self.spread) - away, 1)

    def likeliest(self) -> Tensor:
        """(B, H, W) [px]: the median of the likelier component; never one between a near and a far surface."""
        second = self.log_share[:, 1] > self.log_share[:, 0]
        return torch.where(second, self.disparity[:, 1], self.disparity[:, 0])

    def probability_near(self, disparity: Tensor, reach: float) -> Tensor:
        """(B, H, W) that the surface is within a reach [px] of disparities (B, H, W) [px]."""
        away = disparity[:, None] - self.disparity
        near = _laplace((away + reach) / self.spread) - _laplace((away - reach) / self.spread)
        return (self.log_share.exp() * near).sum(1)


def _laplace(x: Tensor) -> Tensor:
    """The cumulative distribution of a Laplace variable of median 0 and mean absolute deviation 1."""
    return torch.where(x < 0, x.clamp(max=0).exp() / 2, 1 - (-x.clamp(min=0)).exp() / 2)


class RestorationNet(UNet):
    """Measured disparities to a mixture a pixel."""

    def __init__(self, config: RestorationConfig) -> None:
        super().__init__(PACK * PACK * MAPS + SLOPES + config.level, PACK * PACK * 5, config.widths, config.blocks)
        self.config = config
        torch.nn.init.zeros_(self.head.weight)  # at first the measured disparities

    def forward(
        self, disparity: Tensor, returned: Tensor, labels: Tensor, slope: Tensor, level: Tensor | None = None
    ) -> Mixture:
        """The mixture of each pixel.

        Args:
            disparity: (B, H, W) [px] measured; where nothing returned, any estimate of it.
            returned: (B, H, W) bool.
            labels: (B, H, W) uint8: 0 the table, 1 the kits, 2 a part; 0 everywhere without masks.
            slope: (B, 2) [px/px] of the disparity of the table's plane, across and down.
            level: (B, 1) [px] how noisy the image is, see `disparity.noise_level`; needed if the config says so.
        """
        scaled = disparity / DISPARITY_UNIT
        maps = torch.stack([scaled, returned.to(scaled.dtype), *((labels == k).to(scaled.dtype) for k in (1, 2))], 1)
        plane = slope / SLOPE_UNIT
        if self.config.level:
            assert level is not None, "this network reads how noisy the image is"
            plane = torch.cat([plane, level / LEVEL_UNIT], 1)
        plane = plane[:, :, None, None]
        packed = F.pixel_unshuffle(maps, PACK)
        evidence = torch.cat([packed, plane.expand(-1, -1, *packed.shape[2:])], 1)
        out = F.pixel_shuffle(self.image(evidence.contiguous(memory_format=torch.channels_last)), PACK).float()
        spread = FIRST_SPREAD * torch.exp(out[:, 2:4].clamp(-8, 4)) + LEAST_SPREAD
        log_share = F.logsigmoid(torch.cat([out[:, 4:], -out[:, 4:]], 1))
        return Mixture(disparity[:, None] + out[:, :2], spread, log_share)
