"""From maps to a motion: the best cell, then height and tilt there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from baselines.transporter.lattice import peak_of, position_of
from baselines.transporter.network import UNITS, TransporterNet


class Found(NamedTuple):
    """A pose of the part in the work frame, after the rotation of the start."""

    xyz: np.ndarray
    """(3,) [m] of the pivot."""
    tilt: np.ndarray
    """(2,) [rad]"""
    yaw: float
    """[rad]"""
    confidence: float
    """Probability of the best cell and those around it."""


def search(
    net: TransporterNet, kits: Tensor, part: Tensor, yaws: np.ndarray, window: np.ndarray, base: np.ndarray
) -> Found:
    """The pose that the networks score best.

    Args:
        net: the networks.
        kits: (3, n, n) and part: (3, c, c) maps.
        yaws: (Y,) int64 that are searched.
        window: (m, m) bool points that are searched.
        base: (m, m) [m] mean heights about the points.
    """
    points, padded = len(window), len(window) > kits.shape[-1]
    features = net.kit_features(kits[None], padded)
    kernels = net.kernels(part[None], torch.as_tensor(yaws, device=part.device)[None])
    scores = net.scores(features, kernels)[0]
    scores = scores.masked_fill(~torch.as_tensor(window, device=scores.device), -torch.inf)
    probability = scores.flatten().softmax(0).reshape(scores.shape).double().cpu().numpy()
    (layer, row, column), yaw, lattice = peak_of(probability, yaws, net.config.peak == "mean")
    first = torch.tensor([[row, column]])
    height, *tilt = net.height_and_tilt(features, kernels[:, layer : layer + 1], first, 1).flatten().tolist()
    near = probability[:, max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    xy = position_of(lattice, points, net.config.pixel)
    xyz = np.array([*xy, base[row, column] + height * UNITS[0]])
    return Found(xyz, np.array(tilt) * UNITS[1:], yaw, float(min(near.sum(), 1.0)))
