"""The position network: features of part and kits, cross-correlated, score each position of the part.

B batch; p* and k* voxels of the part's and the kits' volume; w* cells of the scores; F features. A cell is two voxels
wide: features have half the resolution of volumes. Cell c of n is the offset (c - n // 2) * 2 * voxel along an axis.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from baselines.snapnet.config import Cells, PositionConfig
from baselines.snapnet.convolutions import (
    Region,
    SingleChannelConv,
    UpsampleConcatConv,
    coarser,
    correlate,
    cropped,
    downsampled,
    finer,
    relative,
)
from kit1000.errors import InputError

COARSEST = 16
"""Voxels along a cell of the coarsest features: sizes are multiples of it."""


class Encoder(nn.Module):
    """Features of a volume at half its resolution: down to a sixteenth and up again, with the layers of the paper."""

    def __init__(self, channels: tuple[int, int, int, int, int], features: int) -> None:
        super().__init__()
        one, two, three, four, five = channels
        self.d1 = SingleChannelConv(one)
        self.d2 = nn.Conv3d(one, two, 3, stride=2, padding=1)
        self.d3 = nn.Conv3d(two, three, 3, stride=2, padding=1)
        self.d4 = nn.Conv3d(three, four, 3, stride=2, padding=1)
        self.b = nn.Conv3d(four, five, 3, stride=2, padding=1)
        self.u1 = UpsampleConcatConv(four, five, four)
        self.u2 = UpsampleConcatConv(three, four, three)
        self.u3 = UpsampleConcatConv(two, three, two)
        self.f = nn.Conv3d(two, features, 1)

    def forward(self, volume: Tensor, region: Region | None = None) -> Tensor:
        """(B, x, y, z) -> (B, F, x/2, y/2, z/2), or only its region, for which less is computed."""
        d2 = downsampled(self.d1, self.d2, volume[:, None])
        d3 = F.relu_(self.d3(d2))
        d4 = F.relu_(self.d4(d3))
        b = F.relu_(self.b(d4))
        x, y, z = d2.shape[-3:]
        r3 = region or ((0, x), (0, y), (0, z))
        r2 = coarser(r3, tuple(d3.shape[-3:]))  # what u3 needs of u2's output; then likewise, downwards
        r1 = coarser(r2, tuple(d4.shape[-3:]))
        r0 = coarser(r1, tuple(b.shape[-3:]))
        u1 = F.relu_(self.u1(cropped(d4, finer(r0)), cropped(b, r0)))
        u2 = F.relu_(self.u2(cropped(d3, finer(r1)), cropped(u1, relative(r1, finer(r0)))))
        u3 = F.relu_(self.u3(cropped(d2, finer(r2)), cropped(u2, relative(r2, finer(r1)))))
        return self.f(cropped(u3, relative(r3, finer(r2))))  # (B, F, x/2, y/2, z/2)


class PositionNet(nn.Module):
    """Scores of all positions in the window, as in the paper: two encoders and a valid cross-correlation.

    The release pads the part's features with zeros at the high end, which changes no sum: left out.

    Raises:
        InputError: sizes that do not halve four times, or a kit volume too small for the window.
    """

    def __init__(self, config: PositionConfig) -> None:
        super().__init__()
        self.config = config
        self.region = kit_region(config)
        self.part = Encoder(config.channels, config.features)
        self.kit = Encoder(config.channels, config.features)

    def forward(self, part: Tensor, kit: Tensor) -> Tensor:
        """(B, px, py, pz), (B, kx, ky, kz) -> (B, wx, wy, wz) logits.

        Raises:
            InputError: volumes of other sizes than configured.
        """
        for name, volume, cells in (("part", part, self.config.part_cells), ("kit", kit, self.config.kit_cells)):
            if volume.ndim != 4 or tuple(volume.shape[1:]) != tuple(cells):
                raise InputError(f"{name}: expected volumes (B, {', '.join(map(str, cells))}), got {(*volume.shape,)}")
        return correlate(self.part(part), self.kit(kit, self.region), self.config.window)


def kit_region(config: PositionConfig) -> Region:
    """The features of the kits that are correlated: at cell w // 2 the middles (n // 2) of both volumes coincide.

    Raises:
        InputError: sizes that do not halve four times, or a kit volume too small for the window.
    """
    spans = []
    for part, kit, window in zip(config.part_cells, config.kit_cells, config.window, strict=True):
        if part % COARSEST or kit % COARSEST:
            raise InputError(f"volumes: expected multiples of {COARSEST} voxels, got {part} of a part, {kit} of kits")
        first = kit // 4 - part // 4 - window // 2
        last = first + part // 2 + window - 1
        if window < 1 or first < 0 or last > kit // 2:
            raise InputError(f"window: {window} cells do not fit a part of {part} voxels in kits of {kit}")
        spans.append((first, last))
    return spans[0], spans[1], spans[2]


def position_loss(scores: Tensor, offset: Tensor, config: PositionConfig) -> Tensor:
    """Cross-entropy over the cells of the window.

    An offset whose nearest cell is outside the window has zero loss and gradient: the release leaves such samples out.
    Within half a cell outside the window's outermost centres, the target is the edge.

    Args:
        scores: (B, wx, wy, wz) logits.
        offset: (B, 3) [m], the correct one.
        config: `target` cell: the nearest cell (the release rounds down); spread: trilinear over the eight around.

    Returns:
        (B,) losses, >= 0.
    """
    sizes = scores.new_tensor(config.window)  # (3,)
    position = offset / (2 * config.voxel) + sizes.div(2, rounding_mode="floor")  # (B, 3) cells
    nearest = torch.floor(position + 0.5)
    inside = ((nearest >= 0) & (nearest < sizes)).all(dim=1)
    bounded = torch.minimum(nearest.clamp(min=0), sizes - 1)
    spread = torch.minimum(position.clamp(min=0), sizes - 1)
    target = target_of(spread if config.target == "spread" else bounded, config.window)
    return torch.where(inside, -(target * scores.flatten(1).log_softmax(dim=1)).sum(dim=1), 0)


def target_of(position: Tensor, window: Cells) -> Tensor:
    """(B, 3) in cells, 0 to window - 1 -> (B, wx wy wz) weights of the cells around it, which sum to one."""
    axes = []
    for axis, count in enumerate(window):
        cells = torch.arange(count, device=position.device, dtype=position.dtype)
        axes.append((1 - (cells - position[:, axis, None]).abs()).clamp(min=0))  # (B, count)
    return torch.einsum("bx,by,bz->bxyz", *axes).flatten(1)  # (B, wx wy wz)


def position_of(scores: Tensor, config: PositionConfig) -> Tensor:
    """(B, wx, wy, wz) logits -> (B, 3) [m] predicted offset.

    `peak` cell: the centre of the best cell. mean: the mean of the up to 27 cells around and including it,
    weighted by probability; where the scores are logarithms of a spread target, this is its offset exactly.
    """
    cells = torch.unravel_index(scores.flatten(1).argmax(dim=1), scores.shape[1:])
    best = torch.stack(cells, dim=1).to(scores.dtype)  # (B, 3)
    if config.peak == "mean":
        best = best + mean_around(scores, best)
    middle = best.new_tensor([count // 2 for count in config.window])
    return (best - middle) * (2 * config.voxel)


def mean_around(scores: Tensor, best: Tensor) -> Tensor:
    """(B, wx, wy, wz) logits, (B, 3) cells -> (B, 3) cells from there to the mean of the 3x3x3 cells around it."""
    step = torch.arange(-1, 2, device=scores.device)
    steps = torch.cartesian_prod(step, step, step)  # (27, 3)
    sizes = torch.tensor(scores.shape[1:], device=scores.device)
    cells = best.long()[:, None] + steps  # (B, 27, 3)
    inside = ((cells >= 0) & (cells < sizes)).all(dim=2)  # (B, 27)
    x, y, z = torch.minimum(cells.clamp(min=0), sizes - 1).unbind(dim=2)
    around = scores.flatten(1).gather(1, (x * sizes[1] + y) * sizes[2] + z)
    share = around.masked_fill(~inside, -torch.inf).softmax(dim=1)  # (B, 27)
    return share @ steps.to(scores.dtype)  # (B, 3)
