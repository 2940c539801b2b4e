"""The completion network: height layers are channels, so that 2-D convolutions complete a 3-D shape.

A grid on the table is an image from above: 2 x 2 cells of all layers are the channels of a pixel (`frame.packed`). B
batch, C channels; features are (B, C, x, y), channels last in memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.perception.completion.parts.frame import CODE, PACK, SHAPE
from kit1000.perception.networks.unet import UNet

EXTRA = 4  # channels of place and camera
JACCARD = 0.5  # weight of the Jaccard distance in the loss
MIDDLE_POLAR, MIDDLE_DISTANCE = 0.8, 0.8  # [rad], [m] of the cameras, which are the origin of their channels


@dataclass(frozen=True)
class CompletionConfig:
    """Sizes of the network."""

    widths: tuple[int, ...] = (96, 128, 192, 256)
    """Channels at each resolution, from 40 x 40 pixels, each half the one before."""
    blocks: int = 2
    """Residual blocks at each resolution, on the way down and on the way up."""
    parts: int = 20_000
    """Fresh parts that the training examples show."""
    parts_seed: int = 2026
    """Seed of these parts."""
    d415_share: float = 0.35
    """Share of the training examples that the d415 measures; the others are ideal."""
    sensor_model: int = 1
    """Data version of the sensors that made the training examples: 1 or 2; training makes those of 2."""


COMPLETION = {
    "small": CompletionConfig(parts_seed=2027, d415_share=0.0, sensor_model=2),
    "pretraining": CompletionConfig(sensor_model=2),
    "measured": CompletionConfig(parts_seed=2051, sensor_model=2),
}
"""`small` starts from the weights of `pretraining`, `measured` of noisy parts from those of `small`."""


class CompletionNet(UNet):
    """Evidence about a part to the logit of each cell being filled."""

    def __init__(self, config: CompletionConfig) -> None:
        layers = PACK * PACK * SHAPE[2]
        super().__init__(layers + EXTRA, layers, config.widths, config.blocks)
        self.config = config

    def forward(self, codes: Tensor, camera: Tensor) -> Tensor:
        """Logits of the cells.

        Args:
            codes: (B, nx / 2, ny / 2, 4 nz) int8 as of `FramedPart`, packed.
            camera: (B, 2) float32 as of `FramedPart`.

        Returns:
            (B, nx / 2, ny / 2, 4 nz), packed.
        """
        half = torch.is_autocast_enabled(codes.device.type)
        evidence = network_input(codes, camera, torch.bfloat16 if half else torch.float32)
        return self.image(evidence).permute(0, 2, 3, 1)


def network_input(codes: Tensor, camera: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
    """(B, C, x, y) of evidence, channels last: the layers, x, |y|, and polar angle and distance of the camera.

    Of y only the magnitude: mirrored evidence is then nothing but a mirrored image.
    """
    layers = codes.to(dtype).permute(0, 3, 1, 2) * (1 / CODE)
    batch, _, nx, ny = layers.shape
    x = torch.linspace(-1, 1, nx, device=layers.device).view(1, 1, nx, 1).expand(batch, 1, nx, ny)
    y = torch.linspace(-1, 1, ny, device=layers.device).abs().view(1, 1, 1, ny).expand(batch, 1, nx, ny)
    middle = torch.tensor([MIDDLE_POLAR, MIDDLE_DISTANCE], device=layers.device)
    place = (4 * (camera - middle)).view(batch, 2, 1, 1).expand(batch, 2, nx, ny)
    return torch.cat([layers, torch.cat([x, y, place], 1).to(dtype)], 1)


def completion_loss(logits: Tensor, codes: Tensor, solid: Tensor) -> Tensor:
    """() cross-entropy plus JACCARD times the soft Jaccard distance, both over the cells that are not seen free.

    Args:
        logits: (B, x, y, C) of the network.
        codes: (B, x, y, C) int8, packed; cells of code CODE do not count.
        solid: (B, x, y, C) uint8, packed: 255 times the filled shares.
    """
    return _Loss.apply(logits, codes, solid)


class _Loss(torch.autograd.Function):
    """The loss with its gradient in closed form, one example at a time: all its arrays then stay in the cache."""

    @staticmethod
    def forward(ctx: Any, logits: Tensor, codes: Tensor, solid: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        gradient, total = torch.empty_like(logits), logits.new_zeros((), dtype=torch.float32)
        for i in range(len(logits)):
            loss, slope = _loss_of(logits[i].detach().float(), codes[i] < CODE, solid[i].float() / 255)
            total += loss / len(logits)
            gradient[i] = slope.div_(len(logits))
        ctx.save_for_backward(gradient)
        return total

    @staticmethod
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor, None, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        (gradient,) = ctx.saved_tensors
        return gradient * above.to(gradient.dtype), None, None


def _loss_of(logits: Tensor, counts: Tensor, share: Tensor) -> tuple[Tensor, Tensor]:
    """The loss of one example and its gradient by the logits; all of one shape, counts bool."""
    weight = counts.to(logits.dtype)
    share, cells = share * weight, weight.sum().clamp(min=1)
    entropy = (F.softplus(logits) * weight).sum() - (logits * share).sum()
    filled = torch.sigmoid(logits) * weight
    both = (filled * share).sum()
    union = (filled.sum() + share.sum() - both).clamp(min=1e-3)
    slope = (filled - share).div_(cells)  # of the entropy
    by_filled = share.mul_(1 / union + both / union**2).sub_(both / union**2)  # of both / union
    slope.sub_(by_filled.mul_(filled).mul_(1 - filled), alpha=JACCARD)
    return entropy / cells + JACCARD * (1 - both / union), slope
