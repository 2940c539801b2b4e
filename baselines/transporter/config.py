"""Sizes of TransporterNet: a preset for two CPU cores and one as in the paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

YAWS = 36
YAW_STEP = 2 * np.pi / YAWS  # [rad] between the rotations of the part


@dataclass(frozen=True)
class TransporterConfig:
    """The two networks and the height maps that they read. All counts of pixels are even, networks' multiples of 8."""

    pixel: float
    """[m] of all height maps."""
    kits: int
    """Pixels across the map of the kits without a guess, about the middle of the kits."""
    near: int
    """Pixels across the map of the kits with a guess, about the guessed position."""
    part: int
    """Pixels across the map of the part, which is the kernel of the cross-correlation."""
    width: int
    """Channels of the first layer."""
    skips: bool = False
    """Whether features of the encoder are added to those of the decoder; not in the paper."""
    calm: bool = False
    """Whether the last layer of each block starts at zero, so that training begins with shallow networks."""
    slopes: bool = False
    """Whether the slopes of heights are inputs too; not in the paper."""
    yaws: int = YAWS
    """Yaws of the part in a training step without a guess: the correct ones and others at random."""
    spread: bool = False
    """Whether a goal is spread over the eight cells around it; otherwise it is the nearest cell, as in the paper."""
    margin: int = 7
    """Pixels around a goal in which height and tilt are trained."""
    peak: str = "cell"
    """cell: the best cell, as in the paper; mean: the mean of the 27 cells around it, weighted by probability."""


TRANSPORTER = {
    "small": TransporterConfig(3e-3, 120, 56, 24, 8, True, True, True, 8, True, 2, "mean"),
    "paper": TransporterConfig(1.094e-3, 640, 176, 96, 64),
}
