"""Sizes and choices of both networks: flat, one preset for two CPU cores and one as in the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Cells = tuple[int, int, int]
Kind = Literal["truth", "partial"]


@dataclass(frozen=True)
class PositionConfig:
    """The network that finds where the part goes, by cross-correlation of features."""

    voxel: float
    """[m] of both volumes."""
    part_cells: Cells
    """Voxels of the part's volume."""
    kit_cells: Cells
    """Voxels of the kits' volume: what the part may slide over, and context around it."""
    window: Cells = (16, 16, 16)
    """Cells of the scores; the features are half as fine as the volumes, so a cell is two voxels wide."""
    channels: tuple[int, int, int, int, int] = (16, 32, 64, 128, 256)
    """Of the encoder, from the full resolution to a sixteenth of it."""
    features: int = 6
    """That are correlated."""
    target: Literal["cell", "spread"] = "spread"
    """cell: all on the cell of the truth, as in the release; spread: over the eight cells around it, linearly."""
    weight: Literal["even", "distance"] = "even"
    """distance: the release's factor exp(miss / window) - 1, which is nothing where the best cell is right."""
    peak: Literal["cell", "mean"] = "mean"
    """cell: the best cell, as in the paper; mean: the mean of the cells around it, by their probability."""


@dataclass(frozen=True)
class RotationConfig:
    """The network that says which of some turned copies of the part fits, from points."""

    voxel: float
    """[m] of the volumes that points are taken from."""
    part_cells: Cells
    """Voxels of the part's volume."""
    kit_cells: Cells
    """Voxels of the kits' volume, around where the part goes."""
    points: Literal["inside", "surface"] = "inside"
    """inside: middles of solid voxels, as in the paper; surface: where the distance passes zero, between voxels."""
    part_points: int = 2048
    kit_points: int = 4096
    width: float = 1.0
    """Of all layers, over the paper's."""
    centres: tuple[int, int] = (512, 128)
    """Points that the first and the second level keep."""
    neighbours: tuple[float, float] = (1.0, 1.0)
    """Points of a group at either level, over the paper's."""
    distance: bool = False
    """Whether each point of the part is told the kits' signed distance where a candidate takes it; not in the paper."""
    candidates: Literal["ball", "tilt", "place", "place-paper"] = "ball"
    """Turns that are told apart: around a guess, or all that a part to be placed may need."""
    shown: int = 40
    """Candidates of a training step: the right one and others."""
    hard: float = 0.0
    """Share of the others that is drawn among the nearest to a right turn; the rest among all, as in the paper."""
    target: Literal["candidate", "spread"] = "candidate"
    """candidate: all on the right one, as in the paper; spread: less the farther a candidate is from a right turn."""
    jitter: float = 2.67e-3
    """[m] most along an axis, by which the kits' volume lies off in training: three voxels of the paper."""
    flag: Literal["paper", "release"] = "paper"
    """The fourth channel: +1 on the part and -1 on the kits, or the other way round."""
    weight: Literal["even", "distance"] = "even"
    """distance: the release's factor exp(miss / largest) - 1."""


POSITION = {
    "small": PositionConfig(1.78e-3, (48, 48, 48), (80, 80, 80), (17, 17, 17), (4, 8, 16, 32, 64)),
    "paper": PositionConfig(
        0.89e-3, (128, 128, 80), (256, 256, 192), (32, 32, 32), target="cell", weight="even", peak="cell"
    ),
}
ROTATION = {
    "small": RotationConfig(
        *(1.78e-3, (48, 48, 48), (64, 64, 64), "surface", 512, 1024, 0.5, (128, 32), (0.5, 0.5)),
        distance=True,
        shown=24,
        hard=0.5,
        target="spread",
    ),
    "paper": RotationConfig(0.89e-3, (128, 128, 80), (128, 128, 128)),
}
