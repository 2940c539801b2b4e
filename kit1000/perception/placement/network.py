"""The placement network: how a fit is moved in its plate, by least squares whose weights it learned.

The image beside the rendered cavity of a fit is a linear problem: disparities change with the fit's place and yaw by
the slopes of the cavity. Plain least squares follow rims that a completed part does not have, and ramps that no cavity
has. The network predicts for each cell how much it weighs, and how far its disparity is off.

B batch, n cells of a side; features are (B, C, x, y), channels last in memory.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.perception.networks.inference import on_cpu, on_grid
from kit1000.perception.networks.unet import UNet, UNetConfig
from kit1000.perception.placement import Channel

LEVER = 20.0  # [mm] by which yaws [rad] are lengths too
INPUTS = len(Channel) + 9  # two residuals and a smooth one, three slopes, two places, and whether the patch is mirrored
OUTPUTS = 3  # weight, error, and share of the measured image
POOLED = 2  # cells of a side of the network's pixels
APART = 0.4  # [px] a usual error of a disparity
FARTHEST = 1.5  # [px] a residual: what differs more is another surface
SHARPNESS, SMOOTHNESS, WIDE = 3, 5, 7  # cells over which a cavity is averaged, for its slopes, and a residual
SHOWN = 0.9  # share of a cell's pixels that show the kits, from which on it counts
WEIGHT_OF_ONE = 0.5413  # softplus of it is 1: at first all cells weigh the same
SHARE_AT_FIRST = -3.0  # logit of the share of the measured image
HOLD = 4.0  # [cells (px/mm)^2] weight of the fit's former place
BEND = 1e-2  # [cells] the same of the bend of the face
SHARE = 0.7  # of a move that is made: on the split val fewer fits are lost than with all of it
MOVE_STEP = 1e-3  # [mm] to which moves are rounded: the last digits of sums depend on the processor
MIRRORED = np.array([-1.0, 1.0, -1.0])
"""Signs of a move when left and right are exchanged."""


class PlacementNet(UNet):
    """A patch to the move of its fit."""

    def __init__(self, config: UNetConfig) -> None:
        super().__init__(INPUTS, OUTPUTS, config)
        torch.nn.init.zeros_(self.head.weight)  # at first plain least squares
        if self.head.bias is not None:
            torch.nn.init.zeros_(self.head.bias)

    def forward(self, patch: Tensor, mirrored: Tensor) -> Tensor:
        """The moves.

        Args:
            patch: (B, Channel, n, n), see `Channel`, n a multiple of 8.
            mirrored: (B,) bool: whether left and right are exchanged, as shadows of a stereo camera are then too.

        Returns:
            (B, 3) [mm] yaw about the middle times LEVER, shift along x and y.
        """
        slopes, residuals = cavity_slopes(patch[:, Channel.CAVITY]), _residuals(patch)
        read = F.avg_pool2d(_inputs(patch, slopes, residuals, mirrored), POOLED)
        predicted = self.image(read.contiguous(memory_format=torch.channels_last))
        weight, error, share = F.interpolate(predicted, scale_factor=POOLED, mode="bilinear").unbind(1)
        share = torch.sigmoid(share + SHARE_AT_FIRST)
        restored, measured = residuals.unbind(1)
        mixed = (restored * (1 - share) + measured * share).clamp(-FARTHEST, FARTHEST) + APART * error
        shown = patch[:, Channel.IS_RESTORED] > SHOWN
        return placed(slopes, mixed, F.softplus(weight + WEIGHT_OF_ONE) * shown)


def cavity_slopes(cavity: Tensor) -> Tensor:
    """(B, 3, n, n) [px/mm] by which disparities (B, n, n) [px] of a cavity grow when it is rotated, shifted along x, y.

    The rotation is times LEVER.
    """
    x, y = _places(cavity)
    smooth = _averaged(cavity, SMOOTHNESS)
    along_x, along_y = torch.zeros_like(smooth), torch.zeros_like(smooth)
    along_x[:, 1:-1] = (smooth[:, 2:] - smooth[:, :-2]) / 2
    along_y[:, :, 1:-1] = (smooth[:, :, 2:] - smooth[:, :, :-2]) / 2
    return torch.stack([(y * along_x - x * along_y) / LEVER, -along_x, -along_y], 1)


def placed(slopes: Tensor, residuals: Tensor, weights: Tensor) -> Tensor:
    """(B, 3) the move that explains residuals (B, n, n) [px] by slopes (B, 3, n, n), beside a bend of the plate's face.

    weights: (B, n, n) of the cells.
    """
    half = residuals.shape[-1] / 2
    x, y = _places(residuals)
    bend = torch.stack([torch.ones_like(x), x / half, y / half]).expand(len(slopes), -1, -1, -1)
    terms, weight = torch.cat([slopes, bend], 1).flatten(2), weights.flatten(1)[:, None]
    held = torch.diag(terms.new_tensor([HOLD] * 3 + [BEND] * 3))
    normal = (terms * weight) @ terms.transpose(1, 2) + held
    right = (terms * weight * residuals.flatten(1)[:, None]).sum(2)
    return torch.linalg.solve(normal, right)[:, :3]


def _residuals(patch: Tensor) -> Tensor:
    """(B, 2, n, n) [px]: the restored and the measured image, beyond the fit's cavity; 0 where they show no kit."""
    cavity = _averaged(patch[:, Channel.CAVITY], SHARPNESS)
    restored = (patch[:, Channel.RESTORED] - cavity) * (patch[:, Channel.IS_RESTORED] > SHOWN)
    measured = (patch[:, Channel.MEASURED] - cavity) * (patch[:, Channel.IS_MEASURED] > SHOWN)
    return torch.stack([restored, measured], 1)


def _inputs(patch: Tensor, slopes: Tensor, residuals: Tensor, mirrored: Tensor) -> Tensor:
    """(B, INPUTS, n, n): the channels in like units, residuals, slopes, places, mirrored or not."""
    cavity = patch[:, Channel.CAVITY]
    channels = patch.clone()
    for channel in (Channel.WIDER, Channel.SLIMMER):
        channels[:, channel] = (patch[:, channel] - cavity) / APART
    channels[:, Channel.HEIGHTS] = patch[:, Channel.HEIGHTS] / 12e-3
    x, y = (place.expand_as(cavity) / cavity.shape[-1] * 2 for place in _places(cavity))
    side = torch.where(mirrored, -1.0, 1.0).to(patch.dtype)[:, None, None].expand_as(cavity)
    smooth = _averaged(residuals[:, 0], WIDE)
    beyond = torch.cat([residuals, smooth[:, None]], 1).div(APART).clamp(-3, 3)
    return torch.cat([channels, beyond, 3 * slopes, torch.stack([x, y, side], 1)], 1)


def _places(cells: Tensor) -> tuple[Tensor, Tensor]:
    """Two (n, n) [mm]: x and y of the cells of patches (..., n, n), of 1 mm each."""
    n = cells.shape[-1]
    along = torch.arange(n, device=cells.device, dtype=cells.dtype) - (n - 1) / 2
    return along[:, None].expand(n, n), along.expand(n, n)


def _averaged(image: Tensor, cells: int) -> Tensor:
    """(B, n, n) averaged over squares of an odd number of cells of a side."""
    padded = F.pad(image[:, None], (cells // 2,) * 4, mode="replicate")
    return F.avg_pool2d(padded, cells, 1)[:, 0]


class Placer:
    """The network with its weights."""

    def __init__(self, weights: Path | PlacementNet) -> None:
        """weights: stem of the files, or the network itself."""
        self.net = on_cpu(weights, UNetConfig, PlacementNet, exact=True)

    def __call__(self, channels: np.ndarray) -> np.ndarray:
        """(3,) yaw [rad] and shift along x and y [m] of the fit of a patch (Channel, n, n), in its frame.

        A SHARE of the mean of those of the patch and of its mirror image.
        """
        pair = torch.from_numpy(np.stack([channels, channels[:, :, ::-1]]).astype(np.float64))
        with torch.inference_mode():
            move, mirrored = self.net(pair, torch.tensor([False, True])).numpy()
        made = SHARE * (move + MIRRORED * mirrored) / 2
        return on_grid(made, MOVE_STEP) * (1 / LEVER, 1e-3, 1e-3)
