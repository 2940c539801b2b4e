"""Sizes of KitNet: a preset for two CPU cores and one as in the paper."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class KitNetConfig:
    """The network that rotates a part into its slot, from one depth view of each."""

    pixels: int
    """Pixels along a side of both square views."""
    pixel: float
    """[m]"""
    width: int
    """Channels of the encoders; the trunk has four times as many."""
    strides: tuple[int, int, int] = (2, 2, 2)
    """Strides of the three stages of the trunk."""
    zeroed: float = 0.02
    """Share of the pixels of a view that are set to 0 in training."""
    shift: float = 3e-3
    """[m] most by which a view is shifted along an axis in training."""


KITNET = {
    "small": KitNetConfig(64, 1.25e-3, 24, (2, 2, 1)),
    "paper": KitNetConfig(128, 0.625e-3, 64),
}
