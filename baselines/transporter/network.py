"""The networks of TransporterNet: features of the kits, correlated with features of the part at each yaw.

B batch; n pixels across the map of the kits, k across the kernel of the part, m points across the lattice of scores; Y
yaws. Of the FEATURES channels the first SCORED score positions and yaws; the others give height and tilt, 8 each.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
import torch.nn.functional as F
from scipy.fft import next_fast_len
from torch import Tensor, nn

from baselines.transporter.config import YAW_STEP, TransporterConfig
from baselines.transporter.inputs import KIT_SCALE, PART_SCALE

SCORED = 3
SCALARS, PER_SCALAR = 3, 8  # height, tilt about x, tilt about y
FEATURES = SCORED + SCALARS * PER_SCALAR
KIT_HEIGHTS, PART_HEIGHTS = {0: KIT_SCALE}, {0: PART_SCALE, 1: PART_SCALE}
"""Channels of the maps that are heights, and the heights [m] that they show as 1."""
KIT_SEEN, PART_SEEN = 1, 2  # channels that tell whether there is a height
MAP_CHANNELS = 3  # of either map
SEEN = 0.99  # of such a channel: less where it is interpolated, at the outline
STEEPEST = 1.0  # slope: steeper ones are edges and count as this much
HIDDEN = 32  # of the small networks that turn a correlation into a height or a tilt
UNITS = (10e-3, 0.175, 0.175)
"""[m, rad, rad] in which heights and tilts are predicted; in metres and radians heights would not count in the loss."""
COARSEST = 8
"""Pixels of the input along a cell of the coarsest features: sizes are multiples of it."""


class TransporterNet(nn.Module):
    """A network for the kits, one for the part, and three small ones for height and tilt."""

    def __init__(self, config: TransporterConfig) -> None:
        super().__init__()
        self.config = config
        kits, part = (MAP_CHANNELS + 2 * len(heights) * config.slopes for heights in (KIT_HEIGHTS, PART_HEIGHTS))
        self.kits = FCN(kits, config.width, FEATURES, config.skips, config.calm)
        self.part = FCN(part, config.width, FEATURES, config.skips, config.calm)
        self.scalars = nn.ModuleList(_regressor() for _ in range(SCALARS))

    def kit_features(self, kits: Tensor, padded: bool) -> Tensor:
        """(B, MAP_CHANNELS, n, n) -> (B, FEATURES, n, n), or with half a kernel of zeros around it."""
        if self.config.slopes:
            kits = with_slopes(kits, KIT_HEIGHTS, KIT_SEEN, self.config.pixel)
        features = normalised(self.kits(packed(kits)).float())
        return F.pad(features, (self.config.part // 2,) * 4) if padded else features

    def kernels(self, part: Tensor, yaws: Tensor) -> Tensor:
        """(B, MAP_CHANNELS, c, c), (B, Y) -> (B, Y, FEATURES, k, k): the part is rotated, then seen by its network."""
        rotated = rotated_crops(part, yaws * YAW_STEP, self.config.part).flatten(0, 1)
        if self.config.slopes:
            rotated = with_slopes(rotated, PART_HEIGHTS, PART_SEEN, self.config.pixel)
        return normalised(self.part(packed(rotated)).float()).unflatten(0, yaws.shape)

    def scores(self, kit_features: Tensor, kernels: Tensor) -> Tensor:
        """(B, F, n, n) and (B, Y, F, k, k) -> (B, Y, m, m) logits, m = n - k + 1."""
        return correlate(kit_features[:, :SCORED], kernels[:, :, :SCORED])

    def height_and_tilt(self, kit_features: Tensor, kernels: Tensor, first: Tensor, points: int) -> Tensor:
        """Height and tilt at some points of the lattice.

        Args:
            kit_features: (B, F, n, n)
            kernels: (B, Y, F, k, k)
            first: (B, 2) int64 the first point of a square of the lattice.
            points: across that square.

        Returns:
            (B, SCALARS, Y, points, points) in UNITS.
        """
        across = kernels.shape[-1]
        size, read = across + points - 1, []
        with torch.autocast(kernels.device.type, enabled=False):  # groups of bfloat16 are summed wrongly, PyTorch 2.13
            for features, own, (row, column) in zip(kit_features, kernels[:, :, SCORED:], first.tolist(), strict=True):
                patch = features[None, SCORED:, row : row + size, column : column + size]
                weights = own.transpose(0, 1).flatten(0, 1)[:, None]  # of channel c at yaw y: c Y + y
                products = F.conv2d(patch, weights, groups=patch.shape[1])[0] / across**2
                read.append(products.unflatten(0, (SCALARS, PER_SCALAR, -1)))
            means = torch.stack(read, 1)  # (SCALARS, B, PER_SCALAR, Y, points, points)
            each = [net(of.movedim(1, -1))[..., 0] for net, of in zip(self.scalars, means, strict=True)]
        return torch.stack(each, 1)


def with_slopes(maps: Tensor, heights: Mapping[int, float], seen: int, pixel: float) -> Tensor:
    """Maps and the slopes of their heights along both axes; tilts are hard to learn from heights in half precision.

    Args:
        maps: (B, C, h, w).
        heights: channels, and the heights [m] that they show as 1.
        seen: channel that is 1 where there is a height.
        pixel: [m]

    Returns:
        (B, C + 2 len(heights), h, w): central differences, up to STEEPEST, and 0 beside what is not seen.
    """
    middle = slice(1, -1)
    known = F.pad(maps[:, seen] > SEEN, (1, 1, 1, 1))
    slopes = []
    for channel, scale in heights.items():
        height = F.pad(maps[:, channel], (1, 1, 1, 1)) * (scale / (2 * pixel))
        for ahead, behind in (
            ((slice(2, None), middle), (slice(-2), middle)),
            ((middle, slice(2, None)), (middle, slice(-2))),
        ):
            both = known[(..., *ahead)] & known[(..., *behind)]
            rise = height[(..., *ahead)] - height[(..., *behind)]
            slopes.append(torch.where(both, rise, 0).clamp(-STEEPEST, STEEPEST))
    return torch.cat([maps, torch.stack(slopes, 1)], 1)


def normalised(features: Tensor) -> Tensor:
    """(B, FEATURES, h, w) features of mean square 1, those for scores and those for scalars apart.

    Scores are products of the features of two networks: without a bound both grow, and training diverges.
    """
    groups = features.split((SCORED, FEATURES - SCORED), 1)
    return torch.cat([group * group.square().mean((1, 2, 3), True).add(1e-6).rsqrt() for group in groups], 1)


def packed(images: Tensor) -> Tensor:
    """Images (B, C, h, w) with the channels of a pixel side by side in memory, where convolutions are faster for it.

    That is in half precision. In float32 on a CPU PyTorch 2.13 then writes beyond its gradients: the heap is corrupt.
    """
    half = torch.is_autocast_enabled(images.device.type)
    return images.contiguous(memory_format=torch.channels_last if half else torch.contiguous_format)


def _regressor() -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(PER_SCALAR, HIDDEN),
        nn.LeakyReLU(0.1),
        nn.Linear(HIDDEN, HIDDEN),
        nn.LeakyReLU(0.1),
        nn.Linear(HIDDEN, 1),
    )


def rotated_crops(part: Tensor, yaws: Tensor, pixels: int) -> Tensor:
    """The middle of maps of a part after rotations about their middle.

    Args:
        part: (B, C, c, c); the axes of a map are x and y.
        yaws: (B, Y) [rad]
        pixels: of the crops; c is about sqrt(2) times as many.

    Returns:
        (B, Y, C, pixels, pixels), bilinear between pixels and 0 outside the map.
    """
    across = part.shape[-1]
    steps = (torch.arange(pixels, device=part.device, dtype=part.dtype) + 0.5 - pixels / 2) * (2 / across)
    x, y = torch.meshgrid(steps, steps, indexing="ij")
    c, s = yaws.to(part.dtype).cos()[..., None, None], yaws.to(part.dtype).sin()[..., None, None]
    grid = torch.stack([c * y - s * x, c * x + s * y], -1)  # columns, then rows: y, then x of the unturned map
    repeated = part[:, None].expand(-1, yaws.shape[1], -1, -1, -1).flatten(0, 1)
    crops = F.grid_sample(repeated, grid.flatten(0, 1), mode="bilinear", align_corners=False)
    return crops.unflatten(0, yaws.shape)


def correlate(kits: Tensor, kernels: Tensor) -> Tensor:
    """Cross-correlation by Fourier transforms, divided by the kernel's width so that new networks give calm scores.

    Args:
        kits: (B, C, n, n)
        kernels: (B, Y, C, k, k)

    Returns:
        (B, Y, m, m), m = n - k + 1: at (a, b) the sum over C, i, j of kernel[i, j] kits[a + i, b + j], over k.
    """
    points = kits.shape[-1] - kernels.shape[-1] + 1
    size = next_fast_len(kits.shape[-1], real=True)
    product = torch.fft.rfft2(kernels, s=(size, size)).conj() * torch.fft.rfft2(kits, s=(size, size))[:, None]
    sums = torch.fft.irfft2(product.sum(2), s=(size, size))
    return sums[..., :points, :points] / kernels.shape[-1]


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
