"""Sizes and choices of both networks: a preset for two CPU cores and one as in the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Cells = tuple[int, int, int]
Source = Literal["truth", "depth"]
"""Source of volumes: exact, from the true geometry, or from one depth image."""


@dataclass(frozen=True)
class PositionConfig:
    """The network that predicts the position of the part at its goal, by cross-correlation of features."""

    voxel: float
    """[m] of both volumes."""
    part_cells: Cells
    """Voxels of the part's volume."""
    kit_cells: Cells
    """Voxels of the kits' volume: the range of positions, and context around it."""
    window: Cells = (16, 16, 16)
    """Cells of the scores; features have half the resolution of the volumes, so a cell is two voxels wide."""
    channels: tuple[int, int, int, int, int] = (16, 32, 64, 128, 256)
    """Channels of the encoder, from full resolution to a sixteenth of it."""
    features: int = 6
    """Channels that are correlated."""
    target: Literal["cell", "spread"] = "spread"
    """cell: one-hot on the nearest cell, as in the release; spread: trilinear over the eight cells around."""
    peak: Literal["cell", "mean"] = "mean"
    """cell: the best cell, as in the paper; mean: the mean of the cells around it, weighted by probability."""


@dataclass(frozen=True)
class RotationConfig:
    """The network that scores candidate rotations of the part, from points."""

    voxel: float
    """[m] of the volumes that points are sampled from."""
    part_cells: Cells
    """Voxels of the part's volume."""
    kit_cells: Cells
    """Voxels of the kits' volume, around the predicted position."""
    points: Literal["inside", "surface"] = "inside"
    """inside: centres of solid voxels, as in the paper; surface: zero crossings of the distance, between voxels."""
    part_points: int = 2048
    kit_points: int = 4096
    width: float = 1.0
    """Width of all layers, as a multiple of the paper's."""
    centres: tuple[int, int] = (512, 128)
    """Points after the first and the second set abstraction."""
    neighbours: tuple[float, float] = (1.0, 1.0)
    """Points of a group at either level, as a multiple of the paper's."""
    kit_distance: bool = False
    """Whether the kits' signed distance at each rotated point of the part is an input feature; not in the paper."""
    training_candidates: int = 40
    """Candidates of a training step: the correct one and negatives."""
    hard_negatives: float = 0.0
    """Share of the negatives that is drawn among those nearest to the correct rotation; 0 in the paper."""
    target: Literal["candidate", "spread"] = "candidate"
    """candidate: one-hot on the nearest, as in the paper; spread: a Gaussian of the angle to the correct rotation."""
    jitter: float = 2.67e-3
    """[m] largest offset along an axis of the kits' volume in training: three voxels of the paper."""


POSITION = {
    "small": PositionConfig(1.78e-3, (48, 48, 48), (80, 80, 80), (17, 17, 17), (4, 8, 16, 32, 64)),
    "paper": PositionConfig(0.89e-3, (128, 128, 80), (256, 256, 192), (32, 32, 32), target="cell", peak="cell"),
}
ROTATION = {
    "small": RotationConfig(
        *(1.78e-3, (48, 48, 48), (64, 64, 64), "surface", 512, 1024, 0.5, (128, 32), (0.5, 0.5)),
        kit_distance=True,
        training_candidates=24,
        hard_negatives=0.5,
        target="spread",
    ),
    "paper": RotationConfig(0.89e-3, (128, 128, 80), (128, 128, 128)),
}
