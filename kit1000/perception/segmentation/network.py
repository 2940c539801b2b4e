"""The network that tells parts apart: each pixel says whether it shows a part, and where the middle of that part is.

B batch; images are (B, H, W), sides multiples of `SIDE`; heights count from the table, in the pixels that they would
fill at their own distance, so a scene of another size looks alike from a distance in proportion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.perception.networks.unet import UNet

PACK = 2  # pixels along each side that are channels of one pixel of the network
MAPS, DIRECTIONS = 3, 3  # channels: of a pixel; of the direction that is up
SIDE = PACK * 8  # [px] of which sides of images are multiples
HEIGHT_UNIT = 32.0  # [px] of a height of 1 in the input
OFFSET_UNIT = 16.0  # [px] of an offset of 1 in the output


@dataclass(frozen=True)
class CentresConfig:
    """Sizes of the network."""

    widths: tuple[int, ...] = (32, 48, 72, 96)
    """Channels at each resolution, from half the image's, each half the one before."""
    blocks: int = 1
    """Residual blocks at each resolution, on the way down and on the way up."""
    views: int = 1500
    """Fresh views of scenes, of which the training examples are crops."""
    views_seed: int = 2030
    """Seed of these views."""
    sensor_model: int = 1
    """Data version of the sensors that made the training examples: 1 or 2; training makes those of 2."""


CENTRES = {
    "small": CentresConfig(views=2500, views_seed=2034, sensor_model=2),
    "pretraining": CentresConfig(sensor_model=2),
    "measured": CentresConfig(views=30_000, views_seed=2050, sensor_model=2),
}
"""`small` starts from the weights of `pretraining`, `measured` from those of `small`."""


class Votes(NamedTuple):
    """What each pixel says."""

    offset: Tensor
    """(B, 2, H, W) [px] across and down, to the mean of the visible pixels of its part."""
    part: Tensor
    """(B, H, W) logit of showing a part."""


class CentresNet(UNet):
    """Heights to votes."""

    def __init__(self, config: CentresConfig) -> None:
        super().__init__(PACK * PACK * MAPS + DIRECTIONS, PACK * PACK * 3, config.widths, config.blocks)
        self.config = config

    def forward(self, measured: Tensor, restored: Tensor, returned: Tensor, up: Tensor) -> Votes:
        """The votes of each pixel.

        Args:
            measured: (B, H, W) [px] heights as measured; any where nothing returned.
            restored: (B, H, W) [px] the same in the restored image.
            returned: (B, H, W) bool.
            up: (B, 3) unit vector in the camera frame.
        """
        scaled = restored / HEIGHT_UNIT
        maps = torch.stack([scaled, measured / HEIGHT_UNIT, returned.to(scaled.dtype)], 1)
        packed = F.pixel_unshuffle(maps, PACK)
        evidence = torch.cat([packed, up[:, :, None, None].expand(-1, -1, *packed.shape[2:])], 1)
        out = F.pixel_shuffle(self.image(evidence.contiguous(memory_format=torch.channels_last)), PACK).float()
        return Votes(OFFSET_UNIT * out[:, :2], out[:, 2])
