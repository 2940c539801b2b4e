"""Changes of training examples: a fit moved in its plate, the plate seen from a little aside, left and right exchanged.

B batch, n cells of a side with a border, m of a patch. Moves are yaw times LEVER, then shifts along x and y [mm].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from kit1000.perception.placement import CELL, CELLS, Channel
from kit1000.perception.placement.network import LEVER, MIRRORED

SHIFT = 0.7  # [mm] standard deviation along each axis, by which a fit is moved
YAW = 0.03  # [rad] the same of its rotation
ASIDE = 0.12  # [rad] of the direction from which the plate is seen


class Changes(NamedTuple):
    """What changes examples."""

    shift: Tensor
    """(B, 2) [mm] of the fit."""
    yaw: Tensor
    """(B,) [rad] of the fit."""
    aside: Tensor
    """(B,) [rad] of the direction of view."""
    mirrored: Tensor
    """(B,) bool"""


def drawn_changes(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The changes of an example, by the names of `Changes`."""
    return {
        "shift": (SHIFT * rng.standard_normal(2)).astype(np.float32),
        "yaw": np.array(YAW * rng.standard_normal(), np.float32),
        "aside": np.array(ASIDE * rng.standard_normal(), np.float32),
        "mirrored": np.array(rng.random() < 0.5),
    }


def no_changes() -> dict[str, np.ndarray]:
    """The changes of a validation example."""
    return {name: np.zeros_like(value) for name, value in drawn_changes(np.random.default_rng(0)).items()}


def changed(patch: Tensor, move: Tensor, changes: Changes) -> tuple[Tensor, Tensor]:
    """Patches (B, Channel, m, m) and moves (B, 3) in their frames, of patches (B, Channel, n, n) and their moves."""
    signs = torch.where(changes.mirrored[:, None], move.new_tensor(MIRRORED), 1.0)
    patch = torch.where(changes.mirrored[:, None, None, None], patch.flip(3), patch)
    seen, fitted = patch[:, : Channel.CAVITY], patch[:, Channel.CAVITY :]
    back = -_rotated(changes.shift, -changes.yaw)
    there = [
        _sampled(seen, changes.aside, torch.zeros_like(back)),
        _sampled(fitted, changes.aside - changes.yaw, back),
    ]
    left = signs * move - torch.cat([LEVER * changes.yaw[:, None], changes.shift], 1)
    return torch.cat(there, 1), torch.cat([left[:, :1], _rotated(left[:, 1:], -changes.aside)], 1)


def _rotated(vectors: Tensor, angle: Tensor) -> Tensor:
    """Vectors (B, 2), rotated by angles (B,) [rad]."""
    cosine, sine = torch.cos(angle), torch.sin(angle)
    x, y = vectors.unbind(1)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], 1)


def _sampled(patch: Tensor, angle: Tensor, shift: Tensor) -> Tensor:
    """(B, C, m, m): at each place p of the smaller patch what (B, C, n, n) has at p, rotated by an angle, and shifted.

    angle: (B,) [rad]. shift: (B, 2) [mm].
    """
    half = (patch.shape[-1] - 1) / 2
    share = (CELLS - 1) / 2 / half
    cosine, sine = share * torch.cos(angle), share * torch.sin(angle)
    x, y = (shift * 1e-3 / CELL / half).unbind(1)
    # grid_sample's first coordinate is the last axis
    rows = torch.stack([torch.stack([cosine, sine, y], 1), torch.stack([-sine, cosine, x], 1)], 1)
    grid = F.affine_grid(rows, [len(patch), 1, CELLS, CELLS], align_corners=True)
    return F.grid_sample(patch, grid, align_corners=True)
