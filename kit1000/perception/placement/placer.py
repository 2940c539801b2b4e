"""The placement network with its weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from kit1000.perception.networks.loading import ready
from kit1000.perception.networks.unet import folded, in_float64
from kit1000.perception.placement.network import LEVER, PlacementConfig, PlacementNet

SHARE = 0.7  # of a move that is made: on the split val fewer fits are lost than with all of it
STEP = 1e-3  # [mm] to which moves are rounded: the last digits of sums depend on the processor
MIRRORED = np.array([-1.0, 1.0, -1.0])
"""Signs of a move when left and right are exchanged."""


class Placer:
    """The network with its weights."""

    def __init__(self, weights: Path | PlacementNet) -> None:
        """weights: stem of the files, or the network itself."""
        net = folded(ready(weights, PlacementConfig, PlacementNet)).to("cpu")  # on which the last digits are known
        self.net = in_float64(net)

    def __call__(self, channels: np.ndarray) -> np.ndarray:
        """(3,) yaw [rad] and shift along x and y [m] of the fit of a patch (Channel, n, n), in its frame.

        A SHARE of the mean of those of the patch and of its mirror image.
        """
        pair = torch.from_numpy(np.stack([channels, channels[:, :, ::-1]]).astype(np.float64))
        with torch.inference_mode():
            move, mirrored = self.net(pair, torch.tensor([False, True])).numpy()
        made = SHARE * (move + MIRRORED * mirrored) / 2
        return STEP * np.rint(made / STEP) * (1 / LEVER, 1e-3, 1e-3)
